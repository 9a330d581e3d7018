"""Turns a trained AMINN into what other programs run: ONNX, C source, a binary for a flash partition, test vectors."""
