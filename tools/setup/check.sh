#!/usr/bin/env bash
# check.sh BUILD REPORTS: the runtime under sanitizers, valgrind, clang-tidy, cppcheck and gcc's analyzer. Writes
# REPORTS/check.json with the number of findings of each; fails on any. Logs are in BUILD.
set -uo pipefail
cd "$(dirname "$0")/../.."
build=$1 reports=$2
mkdir -p "$build" "$reports"
declare -A findings
sources=(runtime/src/*.cpp runtime/host/*.cpp)
core=(-std=c++17 -Iruntime/include -Iruntime/src -fno-exceptions -fno-rtti)

# Builds the Unity tests with some flags and runs each program, under $2 if given; counts the programs that fail. Of one test
# alone, if it is given as $4.
run_tests() {
  local name=$1 wrapper=$2 flags=$3 only=${4:-} failed=0 program
  tools/setup/quiet.sh "$build/$name-configure.log" cmake -S . -B "$build/$name" -G Ninja -DCMAKE_BUILD_TYPE=Debug \
    -DAMINN_BUILD_TESTING=ON -DAMINN_RT_DISPATCH=OFF "-DCMAKE_C_FLAGS=$flags" "-DCMAKE_CXX_FLAGS=$flags" &&
    tools/setup/quiet.sh "$build/$name-build.log" cmake --build "$build/$name" --parallel "$(nproc)" \
      --target "${only:-all}" || return 1
  : >"$build/$name.log"
  for program in "$build/$name"/tests/runtime/${only:-test_*}; do
    [[ -f $program && -x $program ]] || continue
    $wrapper "$program" >>"$build/$name.log" 2>&1 || failed=$((failed + 1))
  done
  findings[$name]=$failed
}

run_tests asan_ubsan "" "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all"
run_tests asan_ubsan_scalar "" "-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all -DAMINN_RT_SCALAR"
run_tests tsan "" "-O1 -g -fsanitize=thread" test_batch
run_tests valgrind "valgrind --quiet --error-exitcode=9 --leak-check=full --errors-for-leak-kinds=definite" "-O1 -g"

clang-tidy --quiet --warnings-as-errors='' "${sources[@]}" -- "${core[@]}" >"$build/clang-tidy.log" 2>"$build/clang-tidy.err"
findings[clang_tidy]=$(grep -cE '(warning|error):' "$build/clang-tidy.log")
cppcheck --quiet --enable=warning,performance,portability --std=c++17 --language=c++ --inline-suppr -UAMINN_HAND_HEADER -Iruntime/include -Iruntime/src \
  --suppress=missingIncludeSystem "${sources[@]}" 2>"$build/cppcheck.log"
findings[cppcheck]=$(grep -cE '(error|warning|performance|portability):' "$build/cppcheck.log")
: >"$build/analyzer.log"
for source in runtime/tools/*.c runtime/firmware/limiter.c tests/golden/aminn_model.c; do
  gcc -std=gnu99 -O1 -fanalyzer -Iruntime/include -Iruntime/tools -Itests/golden -c "$source" -o /dev/null 2>>"$build/analyzer.log"
done
for source in "${sources[@]}"; do
  g++ -O1 -fanalyzer -Wno-psabi "${core[@]}" -c "$source" -o /dev/null 2>>"$build/analyzer.log"
done
findings[gcc_analyzer]=$(grep -cE '(warning|error):' "$build/analyzer.log")

status=0
{
  echo "{"
  separator=""
  for name in $(printf '%s\n' "${!findings[@]}" | sort); do
    printf '%s  "%s_findings": %s' "$separator" "$name" "${findings[$name]}"
    separator=$',\n'
    [[ ${findings[$name]} -eq 0 ]] || status=1
  done
  printf '\n}\n'
} >"$reports/check.json"
cat "$reports/check.json"
[[ ${#findings[@]} -eq 7 ]] || { echo "A check could not run; logs: $build" >&2; status=1; }
[[ $status -eq 0 ]] || echo "Findings: $build/*.log" >&2
exit $status
