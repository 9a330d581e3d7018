# Sourced by the scripts here: environments of public packages in a temporary folder, which goes when the script ends.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# in_environment PACKAGE...: runs the Python program on standard input in a new environment with these packages.
in_environment() {
  local folder
  folder=$(mktemp -d "$work/XXXXXX")
  python3.11 -m venv "$folder/env"
  "$folder/env/bin/python" -m pip install --quiet --disable-pip-version-check "$@" 2>"$folder/pip.log" ||
    { cat "$folder/pip.log" >&2; exit 2; }
  (cd "$folder" && "$folder/env/bin/python" -)
}
