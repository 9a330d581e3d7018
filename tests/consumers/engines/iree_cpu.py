"""IREE, compiled for this processor."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import iree.runtime
import numpy as np
import onnx
from common import Arrays, Inside, Run, main

SCRIPTS = Path(sys.executable).parent
SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}
TARGET = ["--iree-hal-target-device=local", "--iree-hal-local-target-device-backends=llvm-cpu"]


def benchmarked(module: bytes, function: str, sample: Arrays) -> float:
    """Least time (s) of a call from IREE's own benchmark, which is of C."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.vmfb"
        file.write_bytes(module)
        command = [SCRIPTS / "iree-benchmark-module", f"--module={file}", "--device=local-sync"]
        command += [f"--function={function}", "--benchmark_format=json", "--benchmark_repetitions=5"]
        for name, value in sample.items():
            np.save(Path(folder) / f"{name}.npy", value)
            command.append(f"--input=@{folder}/{name}.npy")
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    runs = [b for b in json.loads(said)["benchmarks"] if b["run_type"] == "iteration"]
    return min(b["real_time"] * SECONDS[b["time_unit"]] for b in runs)


def load(model: str) -> tuple[Run, Inside]:
    with tempfile.TemporaryDirectory() as folder:
        mlir, module = Path(folder) / "model.mlir", Path(folder) / "model.vmfb"
        subprocess.run([SCRIPTS / "iree-import-onnx", model, "-o", mlir], check=True)
        command = [SCRIPTS / "iree-compile", mlir, "-o", module, *TARGET, "--iree-llvmcpu-target-cpu=host"]
        subprocess.run(command, check=True)
        data = module.read_bytes()
    graph = onnx.load(model).graph
    constants = {t.name for t in graph.initializer}
    names = [i.name for i in graph.input if i.name not in constants]  # IREE drops inputs that have a default
    context = iree.runtime.SystemContext(config=iree.runtime.Config("local-sync"))
    context.add_vm_module(iree.runtime.VmModule.copy_buffer(context.instance, data))
    function = getattr(context.modules.module, graph.name)

    def run(values: Arrays) -> Arrays:
        found = function(*(values[name] for name in names))
        return {o.name: value.to_host() for o, value in zip(graph.output, found, strict=True)}

    def inside(samples: list[Arrays]) -> float:
        first = {name: samples[0][name] for name in names}
        return benchmarked(data, graph.name, first)

    return run, inside


if __name__ == "__main__":
    main(load)
