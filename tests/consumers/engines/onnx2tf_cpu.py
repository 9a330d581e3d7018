"""onnx2tf, which goes on from ONNX to TensorFlow; here only as far as converting, which it does not pass."""

import subprocess
import sys
import tempfile
from pathlib import Path

from common import Run, main


def load(model: str) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        program = Path(sys.executable).parent / "onnx2tf"
        said = subprocess.run([program, "-i", model, "-o", folder], capture_output=True, text=True)
        if said.returncode:
            lines = (said.stdout + said.stderr).splitlines()
            reasons = [line for line in lines if line.startswith(("Dimensions must be equal", "ValueError"))]
            raise RuntimeError(f"conversion fails: {(reasons or lines)[-1]}")
    raise NotImplementedError("onnx2tf converts the model now: run it here and compare")


if __name__ == "__main__":
    main(load)
