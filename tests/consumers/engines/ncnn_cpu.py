"""ncnn, from what pnnx converts; here only as far as loading, which it does not pass."""

import importlib.util
import subprocess
import tempfile
from pathlib import Path

import ncnn
from common import Run, main


def load(model: str) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.onnx"
        file.write_bytes(Path(model).read_bytes())
        package = importlib.util.find_spec("pnnx")  # to import it takes PyTorch, its converter does not
        assert package is not None and package.origin is not None
        pnnx = Path(package.origin).parent / "pnnx"
        said = subprocess.run([pnnx, file.name, "fp16=0"], cwd=folder, capture_output=True, text=True, check=True)
        ignored = sum(line.startswith("ignore ") for line in said.stdout.splitlines() + said.stderr.splitlines())
        if ncnn.Net().load_param(str(file.with_suffix(".ncnn.param"))) != 0:
            raise RuntimeError(f"pnnx succeeds and ignores {ignored} parameters; ncnn cannot load what it wrote")
    raise NotImplementedError("ncnn loads the model now: run it here and compare")


if __name__ == "__main__":
    main(load)
