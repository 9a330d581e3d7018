"""Data sets: reading and splitting them, where they come from, sensor regimes."""
