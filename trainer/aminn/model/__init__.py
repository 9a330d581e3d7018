"""The networks: mechanics layer, AMINN, the MLP to compare with, their settings, losses, checkpoints and tables."""
