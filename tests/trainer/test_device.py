"""Training on a device: no GPU is needed to see that a step leaves nothing on the CPU, or what is said without one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from synthetic import HANDS, write_dataset
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten

from aminn.data.dataset import load_dataset
from aminn.data.sensors import draw
from aminn.model.checkpoint import Checkpoint, build_model
from aminn.model.config import ModelConfig, TrainConfig
from aminn.training.device import device_of
from aminn.training.train import _Loop, _select, _stages, as_seen, mirror_of, model_config, train
from aminn_app.cli import main
from aminn_app.study import main as study
from aminn_base.errors import AminnError

CONFIGS = {
    "aminn": TrainConfig(),
    "paper's layer": TrainConfig(model=ModelConfig(friction="none")),
    "inverse": TrainConfig(
        model=ModelConfig(mechanics=tuple(replace(m, dq0="inverse") for m in ModelConfig().mechanics))
    ),
    "soft fingers": TrainConfig(model=ModelConfig(soft_finger=True, heads_see_wrench=False)),
    "mlp": TrainConfig(kind="mlp"),
}


class OneDevice(TorchDispatchMode):
    """Refuses an operation on tensors of several devices, but for single numbers."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = tree_flatten((args, kwargs))[0]
        devices = {t.device.type for t in given if isinstance(t, torch.Tensor) and t.ndim}
        assert len(devices) <= 1, f"{func} on tensors of {sorted(devices)}"
        return func(*args, **(kwargs or {}))


def test_operations_across_devices_are_refused() -> None:
    with OneDevice(), pytest.raises(AssertionError, match=r"aten\.mul.*\['cpu', 'meta'\]"):
        torch.ones(3) * torch.ones(3, device="meta")


@pytest.mark.parametrize("hand, name", [*(("reference", name) for name in CONFIGS), ("asymmetric", "aminn")])
def test_a_step_stays_on_its_device(hand: str, name: str, tmp_path: Path) -> None:
    """On PyTorch's meta device, which stands for a GPU: it has every operation and computes nothing."""
    write_dataset(tmp_path / "data", grasps=20, cases=4, of=HANDS[hand], vary=0.3)
    data, config = load_dataset(tmp_path / "data"), CONFIGS[name]
    model = build_model(config.kind, model_config(config.model, data), data.hand)
    seen = as_seen(data, model.config)
    for stage in _stages(model, config, seen, seen):
        loop = _Loop(stage.on(torch.device("meta")), config, mirror_of(config, data.hand))
        x, y = loop.samples
        index = torch.arange(8, device=y.device)
        with OneDevice():
            terms = loop.stage.terms(draw(_select(x, index), config.sensing, loop.rng), y[index])
            torch.stack(list(terms.values())).sum().backward()
            checked = loop.stage.terms(*loop.stage.validation)
        gradients = {k: p.grad for k, p in stage.module.named_parameters()}
        assert all(g is not None and g.is_meta for g in gradients.values()), gradients.keys()
        assert all(v.is_meta for v in (*checked.values(), *loop.best.values()))


@pytest.mark.parametrize("name, reason", [("gpu", "expected cpu, cuda"), ("cuda:x", "expected"), ("cpu:0", "expected")])
def test_a_device_that_is_none(name: str, reason: str) -> None:
    with pytest.raises(AminnError, match=f"device {name}: {reason}"):
        device_of(name)


def test_what_is_said_without_a_gpu(data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    args = ["--data", str(data_dir), "--device", "cuda"]
    for command, more in (
        (main, ["train", "--out", str(tmp_path / "run")]),
        (study, ["paper", "--build", str(tmp_path)]),
    ):
        result = CliRunner().invoke(command, [*more, *args])
        assert result.exit_code == 1 and "device cuda: PyTorch" in result.stderr and "take cpu" in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("device", ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"])
def test_each_device_here_trains_what_the_cpu_trains(
    device: str, data_dir: Path, runs: dict[str, Checkpoint], tmp_path: Path
) -> None:
    found = train(TrainConfig(epochs=15), load_dataset(data_dir), tmp_path / "run", device=device)
    assert found.meta["device"].startswith("cuda (" if device == "cuda" else "cpu")
    for stage, curves in runs["aminn"].meta["history"].items():
        other = found.meta["history"][stage]
        np.testing.assert_allclose(other["train"][0], curves["train"][0], rtol=1e-2)
        assert min(other["validation"]) < 1.2 * min(curves["validation"])


def test_a_checkpoint_says_where_it_was_trained(runs: dict[str, Checkpoint]) -> None:
    assert {run.meta["device"] for run in runs.values()} == {"cpu"}
    assert "device" not in runs["aminn"].meta["identity"]["config"]
