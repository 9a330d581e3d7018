"""A big-endian processor: it names the byte order of a binary model, and tests itself with the C model."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

TREE = Path(__file__).resolve().parents[2]
RUNTIME, GOLDEN = TREE / "runtime", TREE / "tests" / "golden"
COMPILER, EMULATOR = "powerpc-linux-gnu-g++", "qemu-ppc"
PROGRAM = """
#include <stdio.h>
#include "byte_model.h"
#include "half_model.h"
#include "tiny_model.h"
static union { unsigned char bytes[200000]; float aligned; } blob;
int main(int argc, char **argv)
{
    static aminn_t ctx;
    aminn_model_t model;
    FILE *file = fopen(argv[argc - 1], "rb");
    const size_t size = file ? fread(blob.bytes, 1, sizeof blob.bytes, file) : 0;
    puts(aminn_status_name(aminn_model_from_blob(&blob, size, &model)));
    const aminn_model_t *const models[] = {&tiny_model, &half_model, &byte_model};
    for (int i = 0; i < 3; ++i) {
        const aminn_status_t status = aminn_init(&ctx, models[i], 0);
        puts(aminn_status_name(status == AMINN_OK ? aminn_self_test(&ctx) : status));
    }
    return 0;
}
"""


@pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None, reason="no big-endian machine (apt.sh cross)"
)
def test_a_big_endian_processor_names_the_byte_order(tmp_path: Path) -> None:
    (tmp_path / "program.c").write_text(PROGRAM)
    include = [f"-I{RUNTIME / 'include'}", f"-I{GOLDEN}"]
    objects = []
    models = (GOLDEN / f"{name}_model.c" for name in ("tiny", "half", "byte"))
    for source in (*sorted((RUNTIME / "src").glob("*.cpp")), tmp_path / "program.c", *models):
        objects.append(str(tmp_path / f"{source.stem}.o"))
        language = ["-std=c++17"] if source.suffix == ".cpp" else ["-x", "c", "-std=c99"]
        command = [COMPILER, *language, "-O1", "-ffp-contract=off", "-fno-exceptions", *include, "-c", str(source)]
        subprocess.run([*command, "-o", objects[-1]], check=True)
    program = str(tmp_path / "program")
    subprocess.run([COMPILER, "-static", *objects, "-lm", "-o", program], check=True)
    said = subprocess.run(
        [EMULATOR, program, str(GOLDEN / "aminn_model.bin")], capture_output=True, text=True, check=True
    ).stdout.split()
    assert said == ["AMINN_E_BYTE_ORDER", "AMINN_OK", "AMINN_OK", "AMINN_OK"]
