#!/usr/bin/env bash
# quiet.sh LOG COMMAND...: runs COMMAND with its output in LOG; shows the end of it only if COMMAND fails.
set -uo pipefail
log=$1
shift
mkdir -p "$(dirname "$log")"
"$@" >"$log" 2>&1 </dev/null && exit 0
status=$?
tail -n 60 "$log" >&2
echo "Failed with status $status: $* (all of its output: $log)" >&2
exit "$status"
