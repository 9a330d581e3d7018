"""Where training steps are computed: on the CPU, or on a GPU where PyTorch has one."""

from __future__ import annotations

import torch

from aminn_base.errors import AminnError

CPU = "cpu"


def device_of(name: str) -> torch.device:
    """The device of a name like cpu, cuda or cuda:1. Raises AminnError where it is not to be had here."""
    kind, _, number = name.partition(":")
    if kind not in (CPU, "cuda") or (number and not number.isdecimal()) or name.startswith(CPU + ":"):
        raise AminnError(f"device {name}: expected cpu, cuda, or cuda:N for the GPU of number N")
    if kind == CPU:
        return torch.device(CPU)
    if not torch.backends.cuda.is_built():
        raise AminnError(
            f"device {name}: PyTorch {torch.__version__} is a build without CUDA; install one that has it, or take cpu"
        )
    if not torch.cuda.is_available():
        raise AminnError(f"device {name}: PyTorch finds no GPU or no driver for it; take cpu")
    if int(number or 0) >= torch.cuda.device_count():
        raise AminnError(f"device {name}: this machine has {torch.cuda.device_count()} GPU, numbered from 0")
    return torch.device(name if number else "cuda:0")


def described(device: torch.device) -> str:
    """What a checkpoint says of it."""
    return CPU if device.type == CPU else f"cuda ({torch.cuda.get_device_name(device)})"
