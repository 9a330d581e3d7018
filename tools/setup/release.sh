#!/usr/bin/env bash
# release.sh check        the tree can be released: nothing uncommitted, the version everywhere the same and dated in CHANGELOG.md
# release.sh build DIR    sdist, wheel and SHA256SUMS in DIR; nothing is uploaded
# `make release` runs the tests and builds every wheel in between. PYTHON: the environment's (.venv/bin/python).
set -euo pipefail
cd "$(dirname "$0")/../.."
python=${PYTHON:-.venv/bin/python}

fail() {
  echo "release: $*" >&2
  exit 1
}

case ${1:-} in
  check)
    changed=$(git status --porcelain)
    [[ -z $changed ]] || fail "uncommitted files: $(tr -s '\n ' ' ' <<<"$changed"); commit or remove them"
    "$python" -m pytest -q -o addopts= tests/base/test_one_version.py >/dev/null ||
      fail "the version is not the same in every file: pytest tests/base/test_one_version.py says where"
    version=$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
    grep -qE "^## $version, [0-9]{4}-[0-9]{2}-[0-9]{2}$" CHANGELOG.md ||
      fail "CHANGELOG.md has no line \"## $version, YEAR-MONTH-DAY\"; date what is released"
    ;;
  build)
    out=${2:?release.sh build DIR}
    rm -rf "$out"
    "$python" -m build --no-isolation --outdir "$out" --config-setting=cmake.define.AMINN_SIM=ON \
      --config-setting=cmake.define.AMINN_MUJOCO="$PWD/build/mujoco" >build/logs/release.log 2>&1 ||
      { tail -n 40 build/logs/release.log >&2; fail "build/logs/release.log says why it was not built"; }
    (cd "$out" && sha256sum -- * >SHA256SUMS && cat SHA256SUMS)
    echo "Not uploaded, not tagged: $out"
    ;;
  *)
    sed -n '2,4s/^# //p' "$0" >&2
    exit 2
    ;;
esac
