"""The C blocks of docs/runtime.md, one after another in a program, run to its end without an error."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from followed import ROOT, blocks

PAGE = (ROOT / "docs" / "runtime.md").read_text()
HOST = ROOT / "build" / "host" / "runtime"
BEFORE = """
#include <stdio.h>
#include <string.h>
#include "aminn_batch.h"
#include "aminn_model.h"
static float loads[10000 * 6], commanded[6] = {0, 0, -1}, measured_dx_ht[6] = {0, 0, -1e-4F};
static aminn_state_t before;
static aminn_t ctx;
static aminn_state_t state;
static aminn_output_t out;
static aminn_status_t status;
static aminn_state_t sensors(void) { return before; }
static void apply(float load) { (void)load; }
static void push(const float load[6]) { (void)load; }
static void wait_for_rest(void) {}
int main(void)
{
    before = state = aminn_model.known_answer->state;
"""
INCLUDED = '#include "calibration.h"'
MENDED = {
    "{ ... }": "{ (void)0; }",
    "apply(before.w_e)": "push(before.w_e)",
    INCLUDED: "",
    "aminn_status_t status =": "status =",
}
"""What the page leaves out or says twice."""


def test_the_c_blocks_run_in_one_program(tmp_path: Path, people: dict[str, object]) -> None:
    found = [block for block in blocks(PAGE) if re.search(r"\baminn_\w+\(&", block)]
    assert len(found) == 8
    program = BEFORE
    for block in found:
        for old, new in MENDED.items():
            block = block.replace(old, new)
        shared = re.sub(r"^static aminn_(t ctx|state_t state|output_t out);", "", block, flags=re.MULTILINE)
        program += f"    {{\n{shared}    if (status != AMINN_OK) {{ puts(aminn_status_name(status)); return 1; }}\n"
    program += "    }" * len(found) + "\n    return 0;\n}\n"
    (tmp_path / "calibration.h").write_text("static const float aminn_calibration_theta[AMINN_N_THETA] = {0};\n")
    (tmp_path / "page.c").write_text(program.replace('"aminn_model.h"\n', f'"aminn_model.h"\n{INCLUDED}\n', 1))
    golden, include = ROOT / "tests" / "golden", ROOT / "runtime" / "include"
    sources = ["page.c", golden / "aminn_model.c", HOST / "libaminn_rt_host.a", HOST / "libaminn_rt.a"]
    flags = ["-std=c99", "-Wall", "-Werror", f"-I{tmp_path}", f"-I{golden}", f"-I{include}", "-pthread"]
    subprocess.run(["gcc", *flags, *sources, "-lm", "-o", "page"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "page"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    people["snippets_in_runtime"] = len(found)
