"""The hand as the model needs it: nominal springs and tendons, closure, mirror symmetry."""
