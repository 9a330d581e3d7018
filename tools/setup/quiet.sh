#!/usr/bin/env bash
# quiet.sh LOG COMMAND...: runs COMMAND with its output in LOG; shows the end of it only if COMMAND fails. One command at a
# time in the folder of LOG: two makes in one tree would build into each other's folders.
set -uo pipefail
log=$1
shift
mkdir -p "$(dirname "$log")"
exec 9>>"$(dirname "$log")/.lock"
flock --nonblock 9 || { echo "Another build runs in this tree; waiting for it" >&2; flock 9; }
"$@" >"$log" 2>&1 </dev/null 9>&- && exit 0
status=$?
tail -n 60 "$log" >&2
echo "Failed with status $status: $* (all of its output: $log)" >&2
exit "$status"
