"""AMINN trainer: the analytical-model-informed network, its baseline, training and evaluation.

Rooms, each above those before it: `hand` (what a model needs of a hand), `model` (mechanics layer and networks),
`data`, `evaluation`, `training`, `calibration` (theta of a hand from pushes), `pages`. Data comes in through
`data.dataset`; a trained model goes out through `model.checkpoint`.
"""

__version__ = "0.1.0"
