"""A trained model as a program uses it, whatever evaluates it."""
