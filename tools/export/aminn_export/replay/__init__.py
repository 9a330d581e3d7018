"""Programs that repeat predictions: host builds, emulated targets, boards on a serial line, other ONNX engines."""
