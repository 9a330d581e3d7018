#!/usr/bin/env bash
# coverage.sh BUILD REPORTS: builds the runtime with gcov in both of its forms (vector registers, and one number after the
# other), runs the Unity tests, and writes what of runtime/src and runtime/host they reach: REPORTS/coverage.json and pages
# beside it. Fails below 100 % of lines or branches.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$1 reports=$2
mkdir -p "$reports"
for form in lanes scalar; do
  count="--coverage -fprofile-update=atomic" # some tests have threads
  flags="$count -O0 -fno-inline -DAMINN_INLINE=inline"
  [[ $form == scalar ]] && flags+=" -DAMINN_RT_SCALAR"
  tools/setup/quiet.sh "$build/$form-configure.log" cmake -S . -B "$build/$form" -G Ninja -DCMAKE_BUILD_TYPE=Debug \
    -DAMINN_BUILD_TESTING=ON -DAMINN_TEST_HANDS=OFF -DAMINN_RT_DISPATCH=OFF "-DCMAKE_C_FLAGS=$count" "-DCMAKE_CXX_FLAGS=$flags"
  tools/setup/quiet.sh "$build/$form-build.log" cmake --build "$build/$form" --parallel "$(nproc)"
  find "$build/$form" -name '*.gcda' -delete
  # those that replay files run into a limit of the size of files, which cuts what gcov counts as well
  tools/setup/quiet.sh "$build/$form-tests.log" ctest --test-dir "$build/$form" --output-on-failure \
    --exclude-regex 'install|max_width|no_heap|subproject|hand_build|replay|compare' --parallel "$(nproc)"
  # the calls that intrinsics become without optimisation have branches of their own
  gcovr --root . --filter 'runtime/(src|host)/' --exclude-throw-branches --exclude-unreachable-branches \
    --exclude-branches-by-pattern '.*\b_mm[0-9]*_.*' \
    --json "$build/$form.json" --json-summary "$build/$form-summary.json" --html-details "$reports/coverage-$form.html" \
    "$build/$form" >/dev/null
done
python3 - "$build" "$reports/coverage.json" <<'PY'
import json
import sys

keys = ("line_total", "line_covered", "branch_total", "branch_covered")
figures, missed = {}, []
for form in ("lanes", "scalar"):
    summary = json.load(open(f"{sys.argv[1]}/{form}-summary.json"))
    figures |= {f"{form}_{key}": summary[key] for key in keys}
    for file in summary["files"]:
        if file["line_covered"] < file["line_total"] or file["branch_covered"] < file["branch_total"]:
            missed.append(
                f"{form}: {file['filename']}: lines {file['line_covered']}/{file['line_total']}, "
                f"branches {file['branch_covered']}/{file['branch_total']}"
            )
with open(sys.argv[2], "w") as out:
    json.dump(figures, out, indent=2, sort_keys=True)
    out.write("\n")
print("\n".join([*(f"{key} {value}" for key, value in figures.items()), *missed]))
sys.exit(bool(missed))
PY
echo "Coverage: $reports/coverage.json, line by line: $reports/coverage-lanes.html, $reports/coverage-scalar.html"
