"""Training: it learns, it repeats itself to the byte, it resumes, and what it writes reads back."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import HANDS, write_dataset

import aminn.training.train as train_module
from aminn.data.dataset import Dataset, load_dataset
from aminn.evaluation.evaluate import evaluate, flat_report, format_table
from aminn.model.checkpoint import META, WEIGHTS, Checkpoint, load_checkpoint
from aminn.model.config import LossWeights, ModelConfig, TrainConfig
from aminn.model.export_tables import export_tables
from aminn.training.card import CARD
from aminn.training.run_state import FILE, load_run
from aminn.training.train import train
from aminn_app.pipeline import anew_if_outdated
from aminn_base.errors import AminnError, InUseError
from aminn_base.files import write_json
from aminn_base.lock import NAME, locked_folder

SHORT = TrainConfig(epochs=2)


def checkpoint_bytes(folder: Path) -> tuple[bytes, bytes]:
    return (folder / WEIGHTS).read_bytes(), (folder / META).read_bytes()


def test_aminn_beats_no_motion_and_the_analytical_model(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    sizes = np.linalg.norm(dataset.samples["dx_ht"].reshape(-1, 2, 3), axis=2)
    held = np.flatnonzero((sizes < runs["aminn"].model.config.motion_limits).all(1))  # made-up hands never let go
    within = evaluate(list(runs.values()), dataset.take(held)).table
    assert within["aminn"]["rmse_pose_all"] < 0.5 * within["no_motion"]["rmse_pose_all"]
    result = evaluate(list(runs.values()), dataset)
    table = result.table
    assert table["aminn"]["relative_error_median_all"] < table["analytical"]["relative_error_median_all"]
    assert table["aminn"]["f1"] > table["no_motion"]["f1"]
    assert table["aminn"]["passivity_violation_full"] == 0
    assert "aminn" in format_table(result)
    write_json(tmp_path / "report.json", flat_report(result))
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["aminn_f1"] == table["aminn"]["f1"] and report["mlp_auroc"] == table["mlp"]["auroc"]


def test_same_seed_same_bytes_whatever_the_threads(dataset: Dataset, tmp_path: Path) -> None:
    torch.set_num_threads(2)
    train(SHORT, dataset, tmp_path / "a")
    train(SHORT, dataset, tmp_path / "b")
    assert checkpoint_bytes(tmp_path / "a") == checkpoint_bytes(tmp_path / "b")
    train(replace(SHORT, seed=1), dataset, tmp_path / "c")
    assert checkpoint_bytes(tmp_path / "a") != checkpoint_bytes(tmp_path / "c")


@pytest.mark.parametrize("after", [1, 2, 3])
def test_interrupted_run_ends_in_the_same_bytes(dataset: Dataset, tmp_path: Path, monkeypatch, after: int) -> None:
    """Cut after an epoch of stage 1, between the stages, and in stage 2."""
    train(SHORT, dataset, tmp_path / "whole")
    save, calls = train_module.save_run, []

    def cut(*args) -> None:
        save(*args)
        calls.append(1)
        if len(calls) == after:
            raise KeyboardInterrupt

    monkeypatch.setattr(train_module, "save_run", cut)
    with pytest.raises(KeyboardInterrupt):
        train(SHORT, dataset, tmp_path / "cut")
    assert not (tmp_path / "cut" / META).exists()
    monkeypatch.undo()
    train(SHORT, dataset, tmp_path / "cut")
    assert checkpoint_bytes(tmp_path / "whole") == checkpoint_bytes(tmp_path / "cut")
    assert sorted(os.listdir(tmp_path / "cut")) == sorted([META, WEIGHTS, CARD])


def test_finished_run_is_not_repeated_nor_overwritten(dataset: Dataset, tmp_path: Path) -> None:
    train(SHORT, dataset, tmp_path)
    stamp = (tmp_path / WEIGHTS).stat().st_mtime_ns
    train(SHORT, dataset, tmp_path)
    assert (tmp_path / WEIGHTS).stat().st_mtime_ns == stamp
    with pytest.raises(AminnError, match="another configuration"):
        train(replace(SHORT, seed=5), dataset, tmp_path)


def test_one_outcome_only_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    held = dataset.take(dataset.samples["stable"] > 0)
    with pytest.raises(AminnError, match="needs both outcomes"):
        train(SHORT, held, tmp_path)


def test_checkpoint_reads_back(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    run = runs["aminn"]
    again = load_checkpoint(run.path)
    x = dataset.inputs()
    with torch.no_grad():
        a, b = run.model(**x), again.model(**x)
    assert all(torch.equal(a[k], b[k]) for k in a)
    assert again.sha256 == run.sha256


@pytest.mark.parametrize("name", [META, WEIGHTS])
def test_damaged_checkpoint_gives_a_clear_error(runs: dict[str, Checkpoint], tmp_path: Path, name: str) -> None:
    for file in (META, WEIGHTS):
        (tmp_path / file).write_bytes((runs["aminn"].path / file).read_bytes())
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-200])
    with pytest.raises(AminnError, match="not a usable checkpoint"):
        load_checkpoint(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(AminnError, match="missing"):
        load_checkpoint(tmp_path)


def test_exported_tables(runs: dict[str, Checkpoint]) -> None:
    exported = export_tables(runs["aminn"])
    assert all(t.dtype == np.float32 and np.isfinite(t).all() for t in exported.tensors.values())
    assert exported.meta["checkpoint_sha256"] == runs["aminn"].sha256
    assert exported.tensors["s2.head_w"].shape == (3 * (13 + 4), exported.meta["width"][1])  # springs, tendon; friction
    with pytest.raises(AminnError, match="no mechanics layer"):
        export_tables(runs["mlp"])


def test_damaged_unfinished_run_gives_a_clear_error(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"")
    with pytest.raises(AminnError, match="damaged"):
        train(SHORT, dataset, tmp_path)


def interrupted(
    config: TrainConfig,
    dataset: Dataset,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    finetune: Checkpoint | None = None,
) -> None:
    """Leave an unfinished run in `folder`, cut after its first epoch."""
    save = train_module.save_run

    def cut(*args) -> None:
        save(*args)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(train_module, "save_run", cut)
        train(config, dataset, folder, finetune=finetune)


def test_unfinished_run_of_another_configuration_is_named(dataset: Dataset, tmp_path: Path, monkeypatch) -> None:
    interrupted(SHORT, dataset, tmp_path, monkeypatch)
    with pytest.raises(AminnError, match=r"differs in config\.learning_rate, config\.loss\.gate"):
        train(replace(SHORT, learning_rate=1e-3, loss=LossWeights(gate=0.0)), dataset, tmp_path)


def test_state_of_a_run_holds_optimiser_schedule_and_generator(dataset: Dataset, tmp_path: Path, monkeypatch) -> None:
    interrupted(SHORT, dataset, tmp_path, monkeypatch)
    state = load_run(tmp_path, train_module.identity_of(SHORT, dataset.sha256))
    assert state.progress["epoch"] == 1 and state.progress["schedule"]["last_epoch"] > 0
    assert {"exp_avg", "exp_avg_sq", "step"} == {key.split(".")[1] for key in state.part("adam")}
    assert state.tensors["rng"].dtype == torch.uint8


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """More grasps of the same hand."""
    folder = tmp_path_factory.mktemp("other") / "data"
    write_dataset(folder, grasps=60, cases=8, seed=5)
    return load_dataset(folder)


TUNE = TrainConfig(epochs=2, learning_rate=1e-3)


@pytest.mark.parametrize("kind", ["aminn", "mlp"])
def test_fine_tuning_starts_from_weights_and_normalisers(
    runs: dict[str, Checkpoint], other: Dataset, tmp_path: Path, kind: str
) -> None:
    start = runs[kind]
    tuned = train(replace(TUNE, kind=kind), other, tmp_path / "tuned", finetune=start)
    anew = train(replace(TUNE, kind=kind), other, tmp_path / "anew")
    norms = [k for k in start.model.state_dict() if "norm" in k or k.endswith("out_scale")]
    states = [c.model.state_dict() for c in (start, tuned, anew)]
    assert norms and all(torch.equal(states[0][k], states[1][k]) for k in norms)
    assert not all(torch.equal(states[0][k], states[2][k]) for k in norms)
    for stage in ("stage1", "stage2"):
        least = [min(c.meta["history"][stage]["validation"]) for c in (tuned, anew)]
        assert min(least[0], tuned.meta["finetuned"]["validation"][stage]) < least[1]
    assert tuned.meta["finetuned"]["sha256"] == start.sha256
    assert f"fine-tuned from | checkpoint {start.sha256}" in (tuned.path / CARD).read_text()
    assert "fine-tuned" not in (anew.path / CARD).read_text() and "finetuned" not in anew.meta


def test_fine_tuning_that_makes_worse_leaves_the_weights(
    runs: dict[str, Checkpoint], other: Dataset, tmp_path: Path
) -> None:
    wild = replace(TUNE, learning_rate=0.3, epochs=1, divergence=1e9)
    tuned = train(wild, other, tmp_path, finetune=runs["aminn"])
    state = tuned.model.state_dict()
    kept = {k: v for k, v in runs["aminn"].model.state_dict().items() if not k.startswith("sure.")}  # how sure: anew
    assert kept and all(torch.equal(value, state[k]) for k, value in kept.items())
    assert "| best epoch of stage2 | 0 of 1 |" in (tmp_path / CARD).read_text()


def test_interrupted_fine_tuning_goes_on_to_the_same_bytes(
    runs: dict[str, Checkpoint], other: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = runs["aminn"]
    whole = train(TUNE, other, tmp_path / "whole", finetune=start)
    interrupted(TUNE, other, tmp_path / "cut", monkeypatch, finetune=start)
    with pytest.raises(AminnError, match="differs in finetune"):
        train(replace(TUNE, model=start.model.config), other, tmp_path / "cut")
    resumed = train(TUNE, other, tmp_path / "cut", finetune=start)
    assert resumed.sha256 == whole.sha256
    assert train(TUNE, other, tmp_path / "cut", finetune=start).sha256 == whole.sha256


def test_fine_tuning_refuses_another_hand_kind_or_shape(
    runs: dict[str, Checkpoint], other: Dataset, tmp_path: Path
) -> None:
    write_dataset(tmp_path / "five", grasps=20, of=HANDS["5x5"])
    five = load_dataset(tmp_path / "five")
    wide = replace(TUNE, model=ModelConfig(width=(96, 96)))
    for config, data, message in (
        (replace(TUNE, kind="mlp"), other, r"is an aminn, and cannot be fine-tuned as an mlp; give --model aminn"),
        (wide, other, r"was trained with another model\.width; leave the settings"),
        (replace(TUNE, model=ModelConfig(told=True)), other, r"was trained with another model\.told"),
        (TUNE, five, r"trained for another hand than that of the data set"),
    ):
        with pytest.raises(AminnError, match=message):
            train(config, data, tmp_path / "out", finetune=runs["aminn"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["aminn", "mlp"])
def test_diverging_loss_stops_and_names_step_and_term(dataset: Dataset, tmp_path: Path, kind: str) -> None:
    wild = TrainConfig(kind=kind, epochs=3, learning_rate=1e4, gradient_clip=1e9, weight_decay=0.0)
    with pytest.raises(AminnError, match=r"stage\d, epoch \d, (step \d+|validation): the loss diverges, .*lower"):
        train(wild, dataset, tmp_path)
    assert not (tmp_path / META).exists()


def test_diverging_run_keeps_the_last_good_state(dataset: Dataset, tmp_path: Path, monkeypatch) -> None:
    """A target that turns to NaN after the first epoch: the run ends, and the state before is there."""
    epoch, calls = train_module._Loop.epoch, []

    def poisoned(self) -> None:
        calls.append(1)
        if len(calls) == 2:
            self.samples[1][:] = float("nan")
        epoch(self)

    monkeypatch.setattr(train_module._Loop, "epoch", poisoned)
    with pytest.raises(AminnError, match=r"epoch 2, step .*cross-entropy is nan.*before this epoch is kept"):
        train(SHORT, dataset, tmp_path)
    monkeypatch.undo()
    train(SHORT, dataset, tmp_path)
    train(SHORT, dataset, tmp_path.with_name("whole"))
    assert checkpoint_bytes(tmp_path) == checkpoint_bytes(tmp_path.with_name("whole"))


def test_too_few_grasps_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(AminnError, match="the train split has 1 grasps, training needs 5"):
        train(replace(SHORT, train_fraction=0.01), dataset, tmp_path)
    assert not any(tmp_path.iterdir())


def test_weights_of_another_architecture_are_refused(runs: dict[str, Checkpoint], tmp_path: Path) -> None:
    (tmp_path / WEIGHTS).write_bytes((runs["aminn"].path / WEIGHTS).read_bytes())
    meta = json.loads((runs["aminn"].path / META).read_text())
    meta["model"]["width"] = 48
    write_json(tmp_path / META, meta)
    with pytest.raises(AminnError, match=r"has shape \(16, 55\), the configuration asks for \(48, 55\)"):
        load_checkpoint(tmp_path)


def test_another_hand_is_refused(runs: dict[str, Checkpoint], dataset: Dataset) -> None:
    hand = HANDS["asymmetric"].as_dict()
    with pytest.raises(AminnError, match=r"another hand .*differ in springs, .*compliance of contacts, .*anchors"):
        evaluate([runs["aminn"]], replace(dataset, manifest=dataset.manifest | {"hand": hand}))


def test_card_states_figures_and_configuration(runs: dict[str, Checkpoint]) -> None:
    card, meta = (runs["aminn"].path / CARD).read_text(), runs["aminn"].meta
    assert f"| F1 of stable | {meta['validation']['f1']:.3f} |" in card
    assert f"{meta['tau']:.4f}" in card and "learning_rate = 0.00" in card and "## Limits" in card


def test_operating_curve_contains_what_tau_was_chosen_from(runs: dict[str, Checkpoint]) -> None:
    curve, meta = runs["aminn"].meta["operating_curve"], runs["aminn"].meta
    assert curve["tau"] == sorted(curve["tau"]) and curve["passed"] == sorted(curve["passed"], reverse=True)
    assert max(curve["f1"]) >= meta["validation"]["f1"] - 0.01


def test_tensorboard_curves(dataset: Dataset, tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

    run = train(SHORT, dataset, tmp_path, tensorboard=True)
    events = EventAccumulator(str(tmp_path / train_module.BOARD)).Reload()
    for stage in ("stage1", "stage2"):
        values = [event.value for event in events.Scalars(f"{stage}/validation")]
        np.testing.assert_allclose(values, run.meta["history"][stage]["validation"], rtol=1e-6)
    best = int(np.argmin(run.meta["history"]["stage2"]["validation"]))  # whose weights were kept
    errors = [event.value for event in events.Scalars("stage2/rmse_pose")]
    assert errors[best] == pytest.approx(run.meta["validation"]["rmse_pose_all"], rel=1e-4)
    assert len(events.Scalars("stage1/f1")) == SHORT.epochs
    assert events.Scalars("validation/f1")[0].value == pytest.approx(run.meta["validation"]["f1"])
    start = HParamsPluginData.FromString(events.PluginTagToContent("hparams")["_hparams_/session_start_info"])
    assert start.session_start_info.hparams["epochs"].number_value == SHORT.epochs


def test_two_runs_of_a_kind_have_rows_of_their_own(
    runs: dict[str, Checkpoint], dataset: Dataset, tmp_path: Path
) -> None:
    other = train(replace(SHORT, seed=7), dataset, tmp_path / "other")
    assert list(evaluate([runs["aminn"], other, runs["mlp"]], dataset).table)[:3] == ["aminn", "other", "mlp"]
    with pytest.raises(AminnError, match="given twice"):
        evaluate([other, other], dataset)


def test_checkpoint_is_as_readable_as_other_files(dataset: Dataset, tmp_path: Path) -> None:
    train(SHORT, dataset, tmp_path)
    (tmp_path / "plain").touch()
    assert (tmp_path / WEIGHTS).stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_two_runs_in_one_folder(dataset: Dataset, tmp_path: Path) -> None:
    """The second is told who is there; nothing of the first is touched, nor removed as outdated."""
    out = tmp_path / "run"
    with locked_folder(out):
        (out / "kept").touch()
        with pytest.raises(InUseError, match=f"run: in use by process {os.getpid()} on"):
            train(SHORT, dataset, out)
        with pytest.raises(InUseError):
            anew_if_outdated(out, lambda: train(replace(SHORT, seed=2), dataset, out))
        assert sorted(p.name for p in out.iterdir()) == [NAME, "kept"]
    (out / "kept").unlink()
    train(SHORT, dataset, out)
    assert NAME not in [p.name for p in out.iterdir()]
    with locked_folder(out):  # what is finished can be had while somebody else holds the folder
        train(SHORT, dataset, out)
