"""What docs/security.md says is never done: nothing unpickled, no text run, no shell, no module that a file names."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "runpy", "code", "codeop"}
FUNCTIONS = {"eval", "exec", "compile", "__import__"}
METHODS = {"os.system", "os.popen", "torch.load", "yaml.load", "yaml.unsafe_load", "pd.read_pickle"}
KEYWORDS = {"shell": True, "allow_pickle": True, "weights_only": False}


def never(source: str) -> Iterator[str]:
    """What a source does that none may."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            own = [node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
            yield from (f"imports {name}" for name in own if name.partition(".")[0] in MODULES)
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in FUNCTIONS | METHODS:
                yield f"calls {name}"
            if name.endswith("import_module") and not (node.args and isinstance(node.args[0], ast.Constant)):
                yield "imports a module by a name that is not written there"
            for keyword in node.keywords:
                value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
                if keyword.arg in KEYWORDS and value is KEYWORDS[keyword.arg]:
                    yield f"says {keyword.arg}={value}"


def test_no_source_does_so() -> None:
    sources = [p for f in ("sim", "trainer", "tools", "runtime", "packaging") for p in ROOT.glob(f"{f}/**/*.py")]
    assert len(sources) > 100
    assert not [f"{p.relative_to(ROOT)}: {what}" for p in sources for what in never(p.read_text())]


@pytest.mark.parametrize(
    "planted",
    [
        "import pickle",
        "from joblib import load",
        "eval(text)",
        "exec(compile(text, 'x', 'exec'))",
        "torch.load(file)",
        "numpy.load(file, allow_pickle=True)",
        "subprocess.run(line, shell=True)",
        "os.system(line)",
        "importlib.import_module(name)",
        "yaml.load(text)",
    ],
)
def test_what_is_planted_is_found(planted: str) -> None:
    assert list(never(planted))
