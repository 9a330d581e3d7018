"""The compiled C runtime for Python programs that predict much: planners, simulators, optimisers.

    import aminn_rt

    model = aminn_rt.Model.load("build/export")
    found = model.predict(q=q, x_ht=x_ht, w_e=loads, contacts=contacts)  # one grasp, ten thousand loads, all cores
    found.holds, found.dx_ht

It needs neither PyTorch nor ONNX Runtime, and its numbers are bit by bit those of the hand's controller.
"""

from .model import Admissible, LimitedBy, Model, Note, Prediction

__all__ = ["Admissible", "LimitedBy", "Model", "Note", "Prediction"]
