"""`aminn calibrate`: what it writes, and that it writes nothing where it refuses."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from made_up import Draw
from synthetic import write_dataset

from aminn.calibration.calibrate import calibrate, refusals
from aminn.calibration.fit import Errors
from aminn.calibration.mistakes import mistakes_of
from aminn.calibration.pushes import FIELDS, Predict, Pushes
from aminn.calibration.store import KEPT, calibrated, errors_of, read_calibration, write_errors
from aminn.data.dataset import load_dataset
from aminn.model.checkpoint import load_checkpoint, save_checkpoint
from aminn.model.network import Aminn
from aminn_app.cli import main
from aminn_base.errors import AminnError
from aminn_base.seal import JSON_KEY
from aminn_hand import Hand
from aminn_hand.theta import Theta
from aminn_table import write_table


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory, model: Aminn) -> Path:
    folder = tmp_path_factory.mktemp("run")
    save_checkpoint(folder, model, {"tau": 0.5, "data_config_sha256": ""})
    write_errors(load_checkpoint(folder), Errors(0.01, 0.02, 3.0, {"spring": 0.1}))
    return folder


def table(pushes: Pushes, file: Path) -> Path:
    """The pushes as a lab tells them. Small loads, so that no column is out of its range."""
    arrays = {name: np.array(getattr(pushes, name)) for name in FIELDS} | {"grasp_id": pushes.grasp_id}
    small = 0.05
    write_table(file, pushes.hand, arrays | {"w_e": small * arrays["w_e"], "dx_ht": small * arrays["dx_ht"]})
    return file


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["calibrate", *map(str, arguments)])


@pytest.fixture(scope="session")
def run_hand(run: Path) -> Hand:
    return load_checkpoint(run).model.hand


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory, run: Path, draw: Draw) -> Path:
    """A calibration with everything beside it."""
    folder = tmp_path_factory.mktemp("calibration")
    data = table(draw(1, 16, 4)[0], folder / "pushes.csv")
    out = folder / "calibration.json"
    result = call("--run", run, "--data", data, "--out", out, "--page", folder / "page.html")
    assert result.exit_code == 0, result.output
    assert "left out in turn" in result.output and "not determined" in result.output
    assert KEPT in result.output and "left out\n" not in result.output, result.output
    return out


def test_json_says_everything(written: Path, run_hand: Hand, run: Path) -> None:
    found, names = json.loads(written.read_text()), Theta(run_hand).names
    for key in ("theta", "mean", "sd", "prior_sd", "units"):
        assert set(found[key]) == set(names)
    assert found["after"]["relative_error_median"] < found["before"]["relative_error_median"]
    assert found["hand_sha256"] == run_hand.sha256 and found["run_sha256"] == load_checkpoint(run).sha256
    assert found["mistakes"] == [] and (found["pushes"], found["grasps"]) == (16, 4)
    assert set(found["undetermined"]) < set(names)


def test_c_table_is_that_of_the_json(written: Path, tmp_path: Path, run_hand: Hand) -> None:
    program = tmp_path / "table.c"
    program.write_text(
        f'#include <stdio.h>\n#include "{written.with_suffix(".h")}"\n'
        "int main(void)\n{\n    for (unsigned i = 0; i < sizeof aminn_calibration_theta / sizeof(float); i++)\n"
        '        printf("%a\\n", (double)aminn_calibration_theta[i]);\n    return 0;\n}\n'
    )
    compiler = shutil.which("cc") or pytest.skip("no C compiler: apt-get install gcc")
    subprocess.run([compiler, "-std=c99", "-Werror", "-Wall", "-o", tmp_path / "table", program], check=True)
    lines = subprocess.run([tmp_path / "table"], capture_output=True, text=True, check=True).stdout.split()
    wrong = subprocess.run([compiler, "-fsyntax-only", "-DAMINN_N_THETA=3", program], capture_output=True, text=True)
    assert wrong.returncode and "AMINN_N_THETA says another" in wrong.stderr
    theta = read_calibration(written, run_hand)
    assert np.array_equal([float.fromhex(line) for line in lines], theta.astype(np.float32))


def test_page_has_plots_and_every_parameter(written: Path, lab_hand: Hand) -> None:
    page = (written.parent / "page.html").read_text()
    assert page.count("data:image/png;base64,") == 5  # factors, joint zeros, tip radius; errors, weights
    assert all(name in page for name in Theta(lab_hand).names)


def test_mistakes_are_named_and_nothing_is_written(run: Path, draw: Draw, tmp_path: Path) -> None:
    (point,) = (m for m in mistakes_of(draw(1)[0].hand) if (m.name, m.variant) == ("moment_point", "contacts"))
    data, out = table(point.made(draw(1, 16, 4)[0]), tmp_path / "pushes.csv"), tmp_path / "calibration.json"
    result = call("--run", run, "--data", data, "--out", out, "--page", tmp_path / "page.html")
    assert result.exit_code == 1 and "moments are about the middle" in result.output and "--as-told" in result.output
    assert result.output.count("\n") == 1
    assert [f.name for f in tmp_path.iterdir()] == ["pushes.csv"]


def test_what_makes_things_worse_is_refused(run: Path, draw: Draw, tmp_path: Path) -> None:
    pushes = draw(1, 16, 4, error=0.002, vary=0.0)[0]
    factor = np.where(pushes.grasp_id % 2 == 0, 1.25, 0.8)[:, None]
    data = table(pushes.told(dx_ht=pushes.dx_ht * factor), tmp_path / "pushes.csv")
    result = call("--run", run, "--data", data, "--out", tmp_path / "calibration.json", "--as-told")
    assert result.exit_code == 1 and "makes the others worse" in result.output
    assert [f.name for f in tmp_path.iterdir()] == ["pushes.csv"]


def test_pushes_that_count_for_nothing_are_told(run: Path, draw: Draw, tmp_path: Path) -> None:
    """Those that the table says did not hold are left out; those that slipped unnoticed are counted, by grasp."""
    pushes = draw(1, 20, 4, vary=0.2)[0]
    dx = np.array(pushes.dx_ht)
    dx[5] *= -6.0
    arrays = {name: np.array(getattr(pushes, name)) for name in FIELDS} | {"grasp_id": pushes.grasp_id}
    arrays |= {"w_e": 0.01 * arrays["w_e"], "dx_ht": 0.01 * dx, "stable": (np.arange(20) > 1).astype(np.uint8)}
    data = tmp_path / "pushes.csv"
    write_table(data, pushes.hand, arrays)
    out, page = tmp_path / "calibration.json", tmp_path / "page.html"
    result = call("--run", run, "--data", data, "--out", out, "--page", page)
    assert result.exit_code == 0, result.output
    assert "18 of 20 pushes held; the others are left out" in result.output
    found = json.loads(out.read_text())
    line = re.search(r"(\d+) of 18 pushes slipped .*: of grasps ([\d, ]+); the error of the others goes", result.output)
    assert line and int(line[1]) == found["slips"] > 0 and "1" in line[2].split(", ")
    assert f"<td>{line[1]}</td>" in page.read_text() and found["pushes"] == 18


def test_every_fault_of_a_table_is_named(run: Path, draw: Draw, tmp_path: Path) -> None:
    pushes = draw(1, 8, 2)[0]
    data = table(pushes.told(q=np.rad2deg(pushes.q) + 700.0), tmp_path / "pushes.csv")
    result = call("--run", run, "--data", data, "--out", tmp_path / "calibration.json")
    assert result.exit_code == 1
    assert result.output.count("are these degrees?") == pushes.q.shape[1]


def test_a_map_gives_a_table_its_names(written: Path, run: Path, tmp_path: Path) -> None:
    data, by, out = tmp_path / "pushes.csv", tmp_path / "map.toml", tmp_path / "calibration.json"
    data.write_text((written.parent / "pushes.csv").read_text().replace("w_e_fx", "Fx"))
    by.write_text('[columns]\nw_e_fx = "Fx"\n')
    assert call("--run", run, "--data", data, "--out", out).exit_code == 1
    result = call("--run", run, "--data", data, "--map", by, "--out", out)
    assert result.exit_code == 0, result.output
    assert out.read_bytes() == written.read_bytes()
    write_dataset(tmp_path / "data", grasps=8)
    refused = call("--run", run, "--data", tmp_path / "data", "--map", by, "--out", tmp_path / "no.json")
    assert refused.exit_code == 1 and "a data set takes no map" in refused.output


def test_pushes_that_all_slipped_are_refused(run: Path, draw: Draw, tmp_path: Path) -> None:
    pushes = draw(1, 16, 4)[0]
    slipped = pushes.dx_ht * np.random.default_rng(0).uniform(5.0, 50.0, (len(pushes), 1))
    data = table(pushes.told(dx_ht=slipped), tmp_path / "pushes.csv")
    result = call("--run", run, "--data", data, "--out", tmp_path / "calibration.json", "--as-told")
    assert result.exit_code == 1 and "most pushes slipped" in result.output
    assert [f.name for f in tmp_path.iterdir()] == ["pushes.csv"]


def test_inputs_are_not_overwritten(run: Path, draw: Draw, tmp_path: Path) -> None:
    data = table(draw(1, 8, 2)[0], tmp_path / "pushes.csv")
    result = call("--run", run, "--data", data, "--out", data)
    assert result.exit_code == 1 and "choose another name" in result.output


def test_calibrations_of_another_hand_or_damaged(written: Path, run_hand: Hand, tmp_path: Path) -> None:
    content, file = json.loads(written.read_text()), tmp_path / "calibration.json"
    file.write_text(json.dumps(content | {"noise": 1.0}))
    with pytest.raises(AminnError, match=r"calibration\.json: damaged, or changed by hand"):
        read_calibration(file, run_hand)
    del content[JSON_KEY]
    changes = {
        "format_version": (9, "format_version is 9, this program reads 1"),
        "hand_sha256": ("0", "not of synthetic"),
        "theta": ({"spring_x": 0.0}, "is not in both"),
    }
    for key, (value, text) in changes.items():
        file.write_text(json.dumps(content | {key: value}))
        with pytest.raises(AminnError, match=text):
            read_calibration(file, run_hand)
    file.write_text(json.dumps(content | {"theta": {name: "a" for name in content["theta"]}}))
    with pytest.raises(AminnError, match="is no number"):
        read_calibration(file, run_hand)
    names = Theta(run_hand).names
    for name, value in ((names[0], -3.01), (names[1], float("nan")), (names[-2], 1.01), (names[-1], 10**400)):
        file.write_text(json.dumps(content | {"theta": content["theta"] | {name: value}}))
        with pytest.raises(AminnError, match=rf"theta.{name} is not within \+-"):
            read_calibration(file, run_hand)


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("--prior nan 1 0.01", "prior: log is nan, expected more than 0 and at most 3"),
        ("--prior 0.3 2 0.01", "prior: zero_rad is 2, expected more than 0 and at most 1"),
        ("--prior 0.3 0.02 inf", "prior: radius_m is inf, expected more than 0 and at most 0.05"),
        ("--noise nan", "noise is nan, expected 0 to 100"),
        ("--noise 1e30", "noise is 1e+30, expected 0 to 100"),
    ],
)
def test_priors_and_noise_that_nothing_has(option: str, text: str, run: Path, draw: Draw, tmp_path: Path) -> None:
    data = table(draw(1, 8, 2)[0], tmp_path / "pushes.csv")
    result = call("--run", run, "--data", data, "--out", tmp_path / "c.json", *option.split())
    assert (result.exit_code, result.output) == (1, f"Error: {text}\n")
    assert [f.name for f in tmp_path.iterdir()] == ["pushes.csv"]


def test_theta_that_no_model_takes_is_refused(draw: Draw, predict: Predict) -> None:
    found = calibrate(predict, draw(1, 8, 2)[0], look_for_mistakes=False)
    assert not found.beyond and not list(refusals(found))
    soft = replace(found, theta=np.where(np.arange(len(found.space)) == 1, -3.5, found.theta))
    assert soft.beyond == [found.space.names[1]]
    (text,) = refusals(soft)
    assert f"beyond what any prediction takes ({found.space.names[1]})" in text


def test_errors_beside_a_checkpoint_are_those_of_its_weights(run: Path, tmp_path: Path, model: Aminn) -> None:
    assert errors_of(load_checkpoint(run)) == Errors(0.01, 0.02, 3.0, {"spring": 0.1})
    other = tmp_path / "other"
    save_checkpoint(other, model, {"tau": 0.4})
    assert errors_of(load_checkpoint(other)) == Errors()
    shutil.copy(run / "errors.json", other)
    assert errors_of(load_checkpoint(other)) == Errors()


def test_evaluate_and_explain_take_a_calibration(
    written: Path, run: Path, run_hand: Hand, tmp_path: Path, model: Aminn
) -> None:
    write_dataset(tmp_path / "data", grasps=30)
    data = load_dataset(tmp_path / "data")
    theta = read_calibration(written, run_hand)
    seen = calibrated(data, theta)
    assert np.array_equal(seen.samples["theta"][3], theta)
    assert np.allclose(seen.samples["q"] - data.samples["q"], theta[Theta(run_hand).zeros])
    command = ["explain", "--run", str(run), "--data", str(tmp_path / "data"), "--sample", "3"]
    plain = CliRunner().invoke(main, command)
    result = CliRunner().invoke(main, [*command, "--calibration", str(written)])
    assert result.exit_code == plain.exit_code == 0, result.output + plain.output
    assert result.output != plain.output
    assert "(times nominal)" in plain.output and "(times this hand's springs, by theta)" in result.output
