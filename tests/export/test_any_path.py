"""Every public function takes a path as a text and as any os.PathLike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from aminn.data.dataset import load_dataset, read_manifest
from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.config import TrainConfig, load_config
from aminn.pages.explain import draw, explain_sample
from aminn.pages.report import ReportInputs, read_reports, write_report
from aminn.training.train import train
from aminn_base.files import write_json
from aminn_base.read import AnyPath
from aminn_export.export import export
from aminn_export.files.bin_model import read_bin_model, write_bin_model
from aminn_export.files.onnx_model import read_metadata
from aminn_export.judge.compare import compare_files
from aminn_export.judge.verify import load_samples, verify
from aminn_export.samples.golden import single_thread_session
from aminn_export.samples.vectors import read_vectors, write_vectors
from aminn_sim import SimulationConfig, simulate
from aminn_sim.card import data_card
from aminn_sim.open_hand import default_hand_file, open_hand
from aminn_sim.read import read_data


class OnlyFspath:
    """The least that is a path."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __fspath__(self) -> str:
        return str(self.path)


@pytest.mark.parametrize("form", [str, OnlyFspath])
def test_paths_in_any_form(
    form: Callable[[Path], AnyPath], checkpoint_dir: Path, data_dir: Path, build_dir: Path, tmp_path: Path
) -> None:
    def at(*parts: str) -> AnyPath:
        return form(tmp_path.joinpath(*parts))

    simulate(SimulationConfig(grasps=1, cases=1), at("sim"), progress=False, hand=form(default_hand_file()))
    open_hand(form(default_hand_file()))
    read_data(at("sim"))
    data_card(at("sim"))
    data, checkpoint = load_dataset(form(data_dir)), load_checkpoint(form(checkpoint_dir))
    read_manifest(form(data_dir))
    save_checkpoint(at("copy"), checkpoint.model, dict(checkpoint.meta))
    (tmp_path / "t.toml").write_text("epochs = 1\n")
    train(TrainConfig(epochs=1), data, at("run"), tensorboard=False)
    assert load_config(at("t.toml")).epochs == 1
    draw(explain_sample(checkpoint, data, 0), at("e.png"))
    write_json(at("reports", "a.json"), {"a": 1})
    assert read_reports(at("reports"), at("page.html")) == {"a": {"a": 1}}
    write_report(ReportInputs(), at("page.html"))
    export(form(checkpoint_dir), at("out"), data_dir=form(data_dir))
    model, blob = read_bin_model(at("out", "aminn_model.bin")), (tmp_path / "out" / "aminn_model.bin").read_bytes()
    assert single_thread_session(at("out", "aminn.onnx")) and read_metadata(at("out", "aminn.onnx"))["tau"]
    vectors = read_vectors(at("out", "golden.bin"))
    write_vectors(at("v.bin"), vectors.inputs, vectors.reference)
    assert len(load_samples(at("v.bin")).inputs["q"]) == len(vectors.inputs["q"])
    with pytest.raises(Exception, match="vector file"):
        compare_files([at("v.bin"), at("v.bin")])
    assert verify(at("out"), at("v.bin"), form(build_dir), echo=lambda _: None)["samples"]
    assert model.meta["tau"] and blob
    write_bin_model(model, at("again.bin"))
