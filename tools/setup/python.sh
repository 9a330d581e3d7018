#!/usr/bin/env bash
# The project's Python environment.
#   python.sh DIR [PIP-ARGUMENT...]   makes or completes the virtual environment DIR at the versions of constraints.txt
#   python.sh --usable                exits 0 if this machine has a Python 3.11 that can do that
set -euo pipefail
cd "$(dirname "$0")/../.."

# Prints every Python 3.11 of this machine, the system's first.
candidates() {
  local python
  for python in /usr/bin/python3.11 "$(command -v python3.11 || true)" "$(command -v python3 || true)"; do
    [[ -x $python ]] && "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo "$python"
  done
  true
}

# Prints the first Python 3.11 that can make an environment and has the headers to compile a module.
pick() {
  local python
  while read -r python; do
    "$python" -c 'import ensurepip, os, sys, sysconfig, venv
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' 2>/dev/null &&
      echo "$python" && return
  done < <(candidates)
  return 1
}

if [[ ${1:-} == --usable ]]; then
  pick >/dev/null
  exit
fi

venv=$1
shift
if ! "$venv/bin/python" -c 'import pip, sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
  python=$(pick) || { echo "No Python 3.11 with venv and headers: install python3.11-venv, python3.11-dev." >&2; exit 1; }
  echo "Making $venv with $python"
  rm -rf "$venv"
  "$python" -m venv "$venv"
fi

# The requirements of the build, of the program and of all its extras, from the one place that states them.
mapfile -t requirements < <("$venv/bin/python" - <<'PY'
import tomllib

with open("pyproject.toml", "rb") as file:
    project = tomllib.load(file)
names = project["build-system"]["requires"] + project["project"]["dependencies"]
for extra in project["project"]["optional-dependencies"].values():
    names += extra
print(*names, sep="\n")
PY
)
echo "Installing Python packages at the versions of constraints.txt (the first time a few minutes)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c constraints.txt "$@" "${requirements[@]}"
"$venv/bin/python" -m pip check --quiet 2>/dev/null || "$venv/bin/python" -m pip check
