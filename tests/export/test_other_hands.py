"""Models of hands other than the reference hand, in all their files: the runtime is compiled for each."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from hands import HANDS, random_model

from aminn.data.dataset import Dataset
from aminn_base.errors import AminnError
from aminn_export.export import write_model_files
from aminn_export.files.bin_model import bin_model_bytes, read_bin_model
from aminn_export.files.hand_header import HAND_HEADER, header_beside, name_in, same_build
from aminn_export.files.tables import branch_joints, dims_of
from aminn_export.judge.identity import check_model_hand, misfits
from aminn_export.replay.runtime_place import find_in
from aminn_hand.theta import Theta
from aminn_rt import compiled, sources
from aminn_rt.compiled import runtime, runtime_for

RUNTIME = Path(__file__).resolve().parents[2] / "runtime"


@pytest.fixture(scope="module", params=["gripper", "allegro_like"])
def other_dir(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Model files of a hand with gates and soft fingertips, and of one without either."""
    folder = tmp_path_factory.mktemp(request.param)
    write_model_files(random_model(HANDS[request.param]()), folder, "aminn_model")
    return folder


@pytest.fixture(scope="module")
def gripper_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gripper")
    write_model_files(random_model(HANDS["gripper"]()), folder, "aminn_model")
    return folder


@pytest.fixture(scope="module")
def point_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The gripper's, but for fingertips that are points."""
    folder = tmp_path_factory.mktemp("points")
    write_model_files(random_model(HANDS["point_gripper"]()), folder, "aminn_model")
    return folder


def compiled_model(folder: Path, prefix: str, *hand: str) -> subprocess.CompletedProcess:
    command = ["cc", "-std=c99", f"-I{RUNTIME / 'include'}", *hand, "-c", str(folder / f"{prefix}.c")]
    return subprocess.run([*command, "-o", str(folder / "model.o")], capture_output=True, text=True)


def test_a_model_of_another_hand_has_all_files(other_dir: Path) -> None:
    blob, model = (other_dir / "aminn_model.bin").read_bytes(), read_bin_model(other_dir / "aminn_model.bin")
    assert bin_model_bytes(model) == blob
    dims = dims_of(model)
    assert runtime_for(dims).self_test(blob) == 0
    assert runtime().status_name(runtime().self_test(blob)) == "AMINN_E_DIMS"  # by the reference hand's library
    header = header_beside(other_dir)
    assert header is not None and name_in(header) in other_dir.name
    hand = HANDS[name_in(header)]()
    soft, stiff = hand.contact.kind == "soft_finger", Theta(hand).stiff
    assert dims == replace(hand.dims, tendons=dims.gates, twist=soft, stiff=stiff)
    assert branch_joints(model.tensors) == [list(row) for row in hand.coordinate_joints]
    assert all(f'"{joint}"' in header.read_text() for joint in hand.joints)
    assert not misfits(other_dir, "aminn_model", model)


def test_the_runtime_of_a_hand_is_compiled_once(other_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dims = dims_of(read_bin_model(other_dir / "aminn_model.bin"))
    compiled._built.cache_clear()
    monkeypatch.setattr(compiled, "run_program", lambda *args, **kwargs: pytest.fail("compiled again"))
    assert runtime_for(dims).self_test((other_dir / "aminn_model.bin").read_bytes()) == 0


def test_without_a_compiler_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled._built.cache_clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(AminnError, match=r"needs the C runtime for a hand .* no-such-compiler.* apt-get install"):
        write_model_files(random_model(HANDS["gripper"]()), tmp_path, "aminn_model")
    monkeypatch.setattr(sources, "__file__", str(tmp_path / "site-packages" / "aminn_rt" / "sources.py"))
    with pytest.raises(AminnError, match=r"sources are in none of .*aminn_rt/source, .*install the package again"):
        write_model_files(random_model(HANDS["gripper"]()), tmp_path, "aminn_model")
    assert not list(tmp_path.glob("*"))


def test_a_cache_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled._built.cache_clear()
    (tmp_path / "aminn").write_text("a file where the folder would be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(AminnError, match=r"runtime: cannot be written"):
        runtime_for(HANDS["gripper"]().dims)


def test_a_header_of_another_hand_is_a_misfit(gripper_dir: Path, tmp_path: Path) -> None:
    for file in gripper_dir.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    model = read_bin_model(tmp_path / "aminn_model.bin")
    (tmp_path / HAND_HEADER).write_text((RUNTIME / "include" / HAND_HEADER).read_text())
    (line,) = misfits(tmp_path, "aminn_model", model)
    assert line == "aminn_hand.h is not of aminn_model.bin's hand, but of three_finger_hand"


def test_a_program_with_the_wrong_hand_does_not_compile_or_link(gripper_dir: Path, build_dir: Path) -> None:
    """The header names the hand; the linker names the library that would be needed."""
    wrong = compiled_model(gripper_dir, "aminn_model")
    assert wrong.returncode and "this model is for another hand (gripper" in wrong.stderr
    right = compiled_model(gripper_dir, "aminn_model", f'-DAMINN_HAND_HEADER="{gripper_dir / HAND_HEADER}"')
    assert right.returncode == 0, right.stderr
    main = gripper_dir / "main.c"
    main.write_text(
        '#include "aminn_model.h"\nstatic aminn_t ctx;\n'
        "int main(void) { return aminn_init(&ctx, &aminn_model, 0) != AMINN_OK; }\n"
    )
    command = ["cc", f'-DAMINN_HAND_HEADER="{gripper_dir / HAND_HEADER}"', f"-I{RUNTIME / 'include'}", str(main)]
    command += [str(gripper_dir / "model.o"), str(find_in(build_dir, "libaminn_rt.a")), "-lm", "-o", "/dev/null"]
    linked = subprocess.run(command, capture_output=True, text=True)
    assert linked.returncode
    assert "aminn_library_of_2_branches_2_coordinates_4_joints_2_gated_2_twisted_" in linked.stderr


def test_soft_fingertips_are_told_from_points(gripper_dir: Path, point_dir: Path) -> None:
    """By the library, by the C model's header and by the files of a folder, in both directions."""
    for folder, other in ((gripper_dir, point_dir), (point_dir, gripper_dir)):
        model, blob = read_bin_model(folder / "aminn_model.bin"), (folder / "aminn_model.bin").read_bytes()
        assert runtime_for(dims_of(model)).self_test(blob) == 0
        library = runtime_for(dims_of(read_bin_model(other / "aminn_model.bin")))
        assert runtime().status_name(library.self_test(blob)) == "AMINN_E_DIMS"
        wrong = compiled_model(folder, "aminn_model", f'-DAMINN_HAND_HEADER="{other / HAND_HEADER}"')
        assert wrong.returncode and "this model is for another hand" in wrong.stderr
        assert not same_build(folder / HAND_HEADER, other / HAND_HEADER)


def test_data_of_a_hand_of_other_counts_are_refused_by_name() -> None:
    model = read_bin_model(RUNTIME.parent / "tests" / "golden" / "aminn_model.bin")
    for hand in (HANDS["gripper"](), HANDS["allegro_like"]()):
        with pytest.raises(AminnError, match="of another hand than the model"):
            check_model_hand(model, Dataset({"hand": hand.as_dict()}, {}, {}, {}), Path("data"))
