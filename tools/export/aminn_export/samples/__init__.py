"""Inputs and the outputs that they must give: reference model, vector files, golden and adversarial samples."""
