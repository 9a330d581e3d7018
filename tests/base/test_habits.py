"""What a public forge and a release read: valid by its schema, true of the tree."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = {
    "github-workflows": [".github/workflows/ci.yml"],
    "github-issue-forms": [".github/ISSUE_TEMPLATE/fault.yml", ".github/ISSUE_TEMPLATE/wish.yml"],
    "github-issue-config": [".github/ISSUE_TEMPLATE/config.yml"],
    "citation-file-format": ["CITATION.cff"],
}


@pytest.mark.parametrize("schema", SCHEMAS)
def test_files_keep_to_their_schema(schema: str) -> None:
    """At the package's own copies: nothing is fetched."""
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}", *SCHEMAS[schema]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"])
def test_links_and_targets_of_the_pages_are_there(page: str) -> None:
    text = (ROOT / page).read_text()
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        assert (ROOT / target).exists(), target
    listed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    targets = set(re.findall(r"^  make (\S+)", listed, re.MULTILINE)) | {"setup-host-tests"}
    assert {name for names in re.findall(r"`make ([a-z -]+)`", text) for name in names.split()} <= targets
    assert set(re.findall(r"^    make ([a-z-]+)", text, re.MULTILINE)) <= targets


def test_the_forge_tries_every_python_that_the_package_names() -> None:
    named = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', (ROOT / "pyproject.toml").read_text())
    (tried,) = re.findall(r"python: \[(.*)\]", (ROOT / ".github/workflows/ci.yml").read_text())
    assert re.findall(r"3\.\d+", tried) == named


def release_check(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [folder / "tools/setup/release.sh", "check"]
    return subprocess.run(
        command, capture_output=True, text=True, env={"PYTHON": sys.executable, "PATH": "/usr/bin:/bin"}
    )


def test_a_tree_is_released_when_all_is_committed_and_dated(tmp_path: Path) -> None:
    """On a repository of the files that the check reads."""

    def git(*words: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@localhost"]
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    from test_one_version import PLACES

    for file in (*PLACES, "tools/setup/release.sh", "tests/base/test_one_version.py", "constraints.txt"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    shutil.copy(ROOT / ".pre-commit-config.yaml", tmp_path)
    (tmp_path / ".gitignore").write_text("__pycache__/\n.pytest_cache/\n")
    changelog = tmp_path / "CHANGELOG.md"
    heading = re.compile(r"^(## \d\S*), .*$", re.MULTILINE)
    changelog.write_text(heading.sub(r"\1, not released yet", changelog.read_text(), count=1))
    git("init", "--quiet")
    assert "uncommitted files: ?? " in release_check(tmp_path).stderr
    git("add", "--all")
    git("commit", "--quiet", "--message=all")
    assert "CHANGELOG.md has no line" in release_check(tmp_path).stderr
    changelog.write_text(heading.sub(r"\1, 2026-12-24", changelog.read_text(), count=1))
    git("commit", "--quiet", "--all", "--message=date")
    assert release_check(tmp_path).returncode == 0
    (tmp_path / "library.json").write_text('{\n  "version": "9.0.0",\n}\n')
    git("commit", "--quiet", "--all", "--message=other")
    assert "the version is not the same" in release_check(tmp_path).stderr
