"""Dimensions and layouts that stand in the C header and in Python are the same."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from aminn_export.files import layout
from aminn_hand.hand import N_CONTACT_FEATURE, N_WRENCH
from aminn_hand.sensors import FRICTION_CLASSES
from aminn_hand.theta import Theta
from aminn_rt import blob
from aminn_rt.hand_header import hand_header
from aminn_sim.open_hand import default_hand_file
from aminn_sim.understand import understand

INCLUDE = Path(__file__).resolve().parents[2] / "runtime" / "include"
HEADER = (INCLUDE / "aminn_rt.h").read_text()
HAND = (INCLUDE / "aminn_hand.h").read_text()
REFERENCE_HAND = understand(default_hand_file()).hand
DIMS = replace(REFERENCE_HAND.dims, slides="#define AMINN_N_SLIDE 1" in HAND)
THETA = Theta(REFERENCE_HAND)


def macro(name: str) -> int:
    """Value of a macro of the headers, with the macros in it replaced."""
    lines = (HAND + HEADER).replace("\\\n", "")
    text = re.search(rf"#define {name} (.+?)(?: */\*.*)?$", lines, re.MULTILINE).group(1)
    text = re.sub(r"AMINN_\w+", lambda m: str(macro(m.group(0))), text)
    return int(eval(text.rstrip("u").replace("/", "//"), {"__builtins__": {}}))


def test_dimensions() -> None:
    assert macro("AMINN_N_BRANCH") == DIMS.branches
    assert macro("AMINN_N_COORD") == DIMS.coordinates
    assert macro("AMINN_N_JOINT") == DIMS.joints
    assert macro("AMINN_N_CONTACT_FEATURE") == N_CONTACT_FEATURE
    assert macro("AMINN_N_WRENCH") == N_WRENCH
    assert macro("AMINN_N_GATED") == DIMS.gates
    assert macro("AMINN_N_STIFF") == THETA.stiff
    assert macro("AMINN_N_FACTOR") == THETA.factors
    assert macro("AMINN_N_THETA") == len(THETA)
    assert f'#define AMINN_HAND_NAME "{REFERENCE_HAND.name}"' in HAND


def test_the_hand_is_as_the_exporter_writes_it() -> None:
    def macros(text: str) -> list[str]:
        return re.sub(r"/\*.*?\*/|\\\n", " ", text, flags=re.DOTALL).split()

    written = hand_header(REFERENCE_HAND.name, replace(DIMS, stiff=THETA.stiff), REFERENCE_HAND.joints, THETA.names)
    assert macros(written) == macros(HAND)


def test_network_dimensions() -> None:
    assert macro("AMINN_N_CONTACT_INPUT") == DIMS.contact_input
    assert macro("AMINN_N_GLOBAL_INPUT") == DIMS.global_input
    assert macro("AMINN_N_HEAD") == DIMS.head
    assert macro("AMINN_N_HEAD_STORED") == layout.head_stored(DIMS)
    assert macro("AMINN_N_AUX") == DIMS.aux
    assert macro("AMINN_N_CHOLESKY") == DIMS.cholesky
    assert macro("AMINN_N_BRANCH_HEAD") == DIMS.branch_head
    assert macro("AMINN_N_STATE") == DIMS.state
    assert macro("AMINN_N_INPUT") == DIMS.input
    assert macro("AMINN_N_OUTPUT") == DIMS.output
    assert macro("AMINN_FORMAT_VERSION") == blob.FORMAT_VERSION


def test_dq0_codes() -> None:
    assert {name: macro(f"AMINN_DQ0_{name.upper()}") for name in layout.DQ0_CODES} == layout.DQ0_CODES


def test_input_struct_is_the_vector_row() -> None:
    body = HEADER[HEADER.index("typedef struct aminn_input") : HEADER.index("} aminn_input_t;")]
    assert re.findall(r"float (\w+)\[", body) == list(DIMS.inputs)


def test_debug_struct_has_the_debug_models_names() -> None:
    body = HEADER[HEADER.index("typedef struct aminn_stage_debug") : HEADER.index("} aminn_stage_debug_t;")]
    assert re.findall(r"float (\w+)\[", body) == list(DIMS.debug)


def test_output_struct_begins_with_the_outputs() -> None:
    body = HEADER[HEADER.index("typedef struct aminn_output") : HEADER.index("} aminn_output_t;")]
    assert re.findall(r"float (\w+)[\[;]", body) == [*DIMS.outputs, "condition"]


def test_sensors_struct_and_classes_are_those_of_python() -> None:
    body = HEADER[HEADER.index("typedef struct aminn_sensors") : HEADER.index("} aminn_sensors_t;")]
    assert re.findall(r"float (\w+)\[", body) == list(DIMS.sensors)
    assert macro("AMINN_N_SENSOR") == sum(size for (size,) in DIMS.sensors.values())
    assert macro("AMINN_N_SENSED") == DIMS.sensed
    for name, values in FRICTION_CLASSES.items():
        stated = re.search(rf"AMINN_FRICTION_{name.upper()} +{{(.*)}}", HEADER)
        assert stated and [np.float32(v.strip("F ")) for v in stated[1].split(",")] == [np.float32(v) for v in values]


def test_the_headers_example_is_the_one_that_is_tested() -> None:
    example = HEADER[HEADER.index("EXAMPLE") : HEADER.index("#ifndef AMINN_RT_H")]
    tested = (Path(__file__).parent / "test_example.c").read_text()
    statements = [line.strip() for line in re.findall(r"^ \*     (.*)$", example, re.MULTILINE)]
    statements = [re.sub(r"\s*//.*", "", s) for s in statements if not s.startswith("//")]
    normal = re.sub(r"\s+", " ", re.sub(r"/\*.*?\*/", "", tested))
    for statement in statements:
        for part in filter(None, (p.strip() for p in re.split(r"[{}]", statement))):
            assert re.sub(r"\s+", " ", part) in normal, part


COMMENT = re.compile(r"/\*\n((?: \*.*\n)+?) \*/\n(?:static inline )?aminn_status_t (aminn_\w+)\(")
# Comments refer to other functions for codes of theirs in these words.
REFERENCE = re.compile(r"what (aminn_\w+)\(\) returns|as for (aminn_\w+)\(\)|What (aminn_\w+)\(\) calls")
FUNCTION = re.compile(
    r"^(?:static )?(?:inline )?(?:AMINN_FUNCTION )?aminn_status_t (\w+)\([^;{]*?\)\n\{\n(.*?)^\}",
    re.MULTILINE | re.DOTALL,
)


def documented_codes() -> dict[str, set[str]]:
    """The errors that the comment of each public function lists, and those of the functions that it refers to."""
    comments = {name: re.sub(r"\s+\*?\s*", " ", text) for text, name in COMMENT.findall(HEADER)}

    def codes(name: str) -> set[str]:
        found = set(re.findall(r"AMINN_E_\w+", comments[name]))
        return found.union(*(codes(next(filter(None, groups))) for groups in REFERENCE.findall(comments[name])))

    return {name: codes(name) for name in comments}


def returned_codes() -> dict[str, set[str]]:
    """The errors that stand in each function of the library that returns a status, and in those that it calls."""
    sources = sorted((Path(__file__).resolve().parents[2] / "runtime" / "src").glob("*.?pp"))
    bodies = dict(FUNCTION.findall(HEADER))
    for source in sources:
        bodies |= dict(FUNCTION.findall(source.read_text()))
    bodies = {name: re.sub(r"[=!]= AMINN_\w+|//.*", "", body) for name, body in bodies.items()}  # only compared with

    def codes(name: str) -> set[str]:
        found = set(re.findall(r"AMINN_E_\w+", bodies[name]))
        return found.union(*(codes(called) for called in re.findall(r"(\w+)\(", bodies[name]) if called in bodies))

    return {name: codes(name) for name in bodies if name.startswith("aminn_")}


def test_comments_list_the_codes_that_functions_return() -> None:
    documented, returned = documented_codes(), returned_codes()
    assert len(documented) >= 8
    assert documented == returned


def test_every_code_is_returned_by_a_function() -> None:
    listed = set(re.findall(r"X\((AMINN_E_\w+),", HEADER))
    assert listed == set().union(*returned_codes().values())
