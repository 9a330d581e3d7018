"""IREE, compiled for this processor."""

import subprocess
import sys
import tempfile
from pathlib import Path

import iree.runtime
import onnx
from common import Arrays, Run, main

SCRIPTS = Path(sys.executable).parent
TARGET = ["--iree-hal-target-device=local", "--iree-hal-local-target-device-backends=llvm-cpu"]


def load(model: str) -> Run:
    with tempfile.TemporaryDirectory() as folder:
        mlir, module = Path(folder) / "model.mlir", Path(folder) / "model.vmfb"
        subprocess.run([SCRIPTS / "iree-import-onnx", model, "-o", mlir], check=True)
        command = [SCRIPTS / "iree-compile", mlir, "-o", module, *TARGET, "--iree-llvmcpu-target-cpu=host"]
        subprocess.run(command, check=True)
        data = module.read_bytes()
    graph = onnx.load(model).graph
    context = iree.runtime.SystemContext(config=iree.runtime.Config("local-sync"))
    context.add_vm_module(iree.runtime.VmModule.copy_buffer(context.instance, data))
    function = getattr(context.modules.module, graph.name)

    def run(values: Arrays) -> Arrays:
        found = function(*(values[i.name] for i in graph.input))
        return {o.name: value.to_host() for o, value in zip(graph.output, found, strict=True)}

    return run


if __name__ == "__main__":
    main(load)
