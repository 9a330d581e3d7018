"""AMINN trainer: the analytical-model-informed network, its baseline, training and evaluation.

Read in this order: `dims` (sizes and names), `mechanics` (the two-pass statics layer), `model` (the network around it),
`train`, `evaluate`. Data comes in through `dataset`; a trained model goes out through `checkpoint`.
"""

__version__ = "0.1.0"
