"""Only `aminn_base.files` writes files: everything else would have to know of links, devices and full disks too."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WRITERS = {"write_text", "write_bytes", "tofile", "savefig", "rename", "replace", "move", "save_file", "copy"}
ALLOWED = {
    "aminn_base/files.py": "the one place",
    "aminn_sim/gallery.py": "a folder, made whole beside and renamed",
    "aminn_export/export.py": "finished files of a folder of its own, moved into place",
    "judge/bench.py": "a temporary folder",
    "aminn_rt/compiled.py": "a temporary folder",
}


def writes(call: ast.Call) -> bool:
    """Whether a call may write to a path by itself."""
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name == "open":
        modes = [a.value for a in (*call.args, *(k.value for k in call.keywords)) if isinstance(a, ast.Constant)]
        return any(isinstance(m, str) and set(m) <= set("rwaxbt+") and set(m) & set("wax+") for m in modes)
    if name not in WRITERS or not isinstance(function, ast.Attribute):
        return False
    if name == "savefig":  # into memory
        return not (isinstance(call.args[0], ast.Name) and call.args[0].id in ("buffer", "out", "picture"))
    # of a text, of a dataclass, of an array
    if name in ("replace", "copy", "move"):
        owner = function.value.id if isinstance(function.value, ast.Name) else ""
        return owner in ("os", "shutil") or (name == "replace" and len(call.args) == 1 and not call.keywords)
    return True


def test_nobody_else_writes_files() -> None:
    packages = ("sim/aminn_sim", "trainer/aminn", "tools/*/aminn_*")
    sources = [p for f in packages for p in ROOT.glob(f"{f}/**/*.py")]
    assert len(sources) > 50
    found = set()
    for source in sources:
        if any(isinstance(n, ast.Call) and writes(n) for n in ast.walk(ast.parse(source.read_text()))):
            found.add("/".join(source.parts[-2:]))
    assert found <= set(ALLOWED), found
