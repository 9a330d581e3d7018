"""The files of an exported model: tables, layout, binary, C and ONNX."""
