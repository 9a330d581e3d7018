"""Training that can be interrupted, and the card of what came out."""
