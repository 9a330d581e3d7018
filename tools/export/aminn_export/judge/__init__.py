"""What is right: tolerances, verdicts, verification, fidelity, speed."""
