"""A real hand's mechanics from a few measured pushes, and what was misread of them."""
