"""The hand as a value: what simulation, training, export and runtime must know of it. Needs NumPy alone."""

from .hand import Branch, Coordinate, Coupling, Dims, Hand, Tendon

__all__ = ["Branch", "Coordinate", "Coupling", "Dims", "Hand", "Tendon"]
