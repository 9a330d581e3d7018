# aminn_replay: a good run, and every kind of bad file: non-zero exit, a message that says what is wrong, no output left.
#   cmake -DREPLAY=aminn_replay -DGOLDEN=tests/golden -DWORK=dir -P replay_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")
file(MAKE_DIRECTORY "${WORK}")
set(OUT "${WORK}/out.bin")

function(replay CODE MESSAGE)
  file(REMOVE "${OUT}")
  execute_process(COMMAND "${REPLAY}" ${ARGN} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL CODE OR NOT TEXT MATCHES "${MESSAGE}")
    message(FATAL_ERROR "expected exit ${CODE} and \"${MESSAGE}\", got ${RESULT}: ${TEXT}")
  endif()
  file(GLOB LEFT "${OUT}*")
  if(CODE EQUAL 0 AND NOT LEFT STREQUAL OUT OR NOT CODE EQUAL 0 AND LEFT)
    message(FATAL_ERROR "exit ${CODE} left ${LEFT}")
  endif()
endfunction()

# the first COUNT bytes of FROM
function(truncate FROM TO COUNT)
  execute_process(COMMAND head -c ${COUNT} "${FROM}" OUTPUT_FILE "${TO}")
endfunction()

set(MODEL "${GOLDEN}/aminn_model.bin")
set(VECTORS "${GOLDEN}/golden.bin")
replay(0 "samples [1-9][0-9]*, refused 0" "${MODEL}" "${VECTORS}" "${OUT}")
replay(0 "model aminn_model, hand three_finger_hand [0-9a-f]+, made by aminn [0-9.]+, checkpoint [0-9a-f]+, data [0-9a-f]+, tau 0.[0-9]+; self-test AMINN_OK"
  "${MODEL}" "${VECTORS}" "${OUT}")
replay(0 "model half_model, hand unknown, .* data none, .*; self-test AMINN_OK" "${GOLDEN}/half_blob.bin" "${VECTORS}" "${OUT}")
replay(2 "usage" "${MODEL}")
replay(1 "No such file" "${WORK}/none.bin" "${VECTORS}" "${OUT}")
replay(1 "No such file" "${MODEL}" "${WORK}/none.bin" "${OUT}")
replay(1 "AMINN_E_MAGIC" "${VECTORS}" "${VECTORS}" "${OUT}")
replay(1 "wrong magic" "${MODEL}" "${MODEL}" "${OUT}")
truncate("${MODEL}" "${WORK}/short.bin" 5000)
replay(1 "AMINN_E_SIZE" "${WORK}/short.bin" "${VECTORS}" "${OUT}")
truncate("${VECTORS}" "${WORK}/short.bin" 5000)
replay(1 "truncated" "${MODEL}" "${WORK}/short.bin" "${OUT}")
truncate("${VECTORS}" "${WORK}/short.bin" 10)
replay(1 "truncated" "${MODEL}" "${WORK}/short.bin" "${OUT}")
file(WRITE "${WORK}/empty.bin" "")
replay(1 "AMINN_E_SIZE" "${WORK}/empty.bin" "${VECTORS}" "${OUT}")
replay(1 "No such file" "${MODEL}" "${VECTORS}" "${WORK}/none/out.bin")

# damaged in the middle: same length, other bytes
foreach(FILE IN ITEMS "${MODEL}" "${VECTORS}")
  file(SIZE "${FILE}" SIZE)
  math(EXPR REST "${SIZE} - 5004")
  execute_process(
    COMMAND sh -c "head -c 5000 '${FILE}'; printf 'ZZZZ'; tail -c ${REST} '${FILE}'" OUTPUT_FILE "${WORK}/damaged.bin")
  if(FILE STREQUAL MODEL)
    replay(1 "AMINN_E_CRC" "${WORK}/damaged.bin" "${VECTORS}" "${OUT}")
  else()
    replay(1 "CRC-32" "${MODEL}" "${WORK}/damaged.bin" "${OUT}")
  endif()
endforeach()

# --- where OUT leads: what is no regular file is written into, links are followed, inputs are refused ---------------
replay(0 "samples" "${MODEL}" "${VECTORS}" "${OUT}")
file(RENAME "${OUT}" "${WORK}/good.bin")

# runs SCRIPT in the scratch folder, with $replay, $model, $vectors and `good` (compares a file with a good result)
function(shell NAME SCRIPT)
  execute_process(
    COMMAND sh -euc "fails() { if \"$@\"; then echo \"no failure: $*\"; exit 8; fi; }; good() { cmp \"$1\" ../good.bin; }; only() { test \"$(ls -A | tr '\\n' ' ')\" = \"$*\" || { ls -A; exit 9; }; }
      cd \"${WORK}\"; rm -rf scratch; mkdir scratch; cd scratch; ${SCRIPT}"
    RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL 0)
    message(FATAL_ERROR "${NAME}: ${RESULT}: ${TEXT}")
  endif()
endfunction()
set(ENV{replay} "${REPLAY}")
set(ENV{model} "${MODEL}")
set(ENV{vectors} "${VECTORS}")

shell("a FIFO" "mkfifo pipe; timeout 20 cat pipe >got & \"$replay\" \"$model\" \"$vectors\" pipe; wait; test -p pipe; good got; only got pipe ''")
shell("/dev/stdout to a pipe" "\"$replay\" \"$model\" \"$vectors\" /dev/stdout 2>figures | cat >got; good got; grep -q samples figures")
shell("/dev/stdout to a file" "\"$replay\" \"$model\" \"$vectors\" /dev/stdout >got 2>figures; good got; grep -q samples figures; only figures got ''")
shell("a link to /dev/stdout" "ln -s /dev/stdout out; \"$replay\" \"$model\" \"$vectors\" out 2>figures >got; good got; test -h out")
shell("another descriptor" "\"$replay\" \"$model\" \"$vectors\" /dev/fd/7 7>got; good got; only got ''")
shell("a link" "mkdir there; ln -s there/file out; \"$replay\" \"$model\" \"$vectors\" out; good there/file; test -h out
  ln -s \"$PWD/out\" chain; echo old >there/file; chmod 604 there/file; \"$replay\" \"$model\" \"$vectors\" chain; good there/file
  test -h chain; test $(stat -c %a there/file) = 604; only chain out there ''; test $(ls -A there) = file")
shell("links in a circle" "ln -s a b; ln -s b a; fails \"$replay\" \"$model\" \"$vectors\" a; only a b ''")
shell("the umask" "umask 027; \"$replay\" \"$model\" \"$vectors\" out; test $(stat -c %a out) = 640")
shell("a folder" "mkdir out; fails \"$replay\" \"$model\" \"$vectors\" out 2>said; grep -q 'Is a directory' said; only out said ''")
shell("a file that may not grow" "echo old >out; (ulimit -f 1; trap '' XFSZ; fails \"$replay\" \"$model\" \"$vectors\" out 2>said)
  grep -q 'out: cannot write: File too large' said; test $(cat out) = old; only out said ''")
shell("devices, for root alone" "test $(id -u) = 0 || exit 0; mknod null c 1 3 && mknod full c 1 7 && : >null || exit 0
  \"$replay\" \"$model\" \"$vectors\" null; fails \"$replay\" \"$model\" \"$vectors\" full 2>../said; grep -q 'No space' ../said
  test -c null; test -c full; only full null ''")
shell("a file that is a mount" "unshare --mount true 2>/dev/null || exit 0; echo old >outer; : >inner
  unshare --mount sh -euc 'mount --bind outer inner; \"$replay\" \"$model\" \"$vectors\" inner'; good outer; only inner outer ''")

foreach(KIND IN ITEMS "cp" "ln" "ln -s")
  foreach(INPUT IN ITEMS model vectors)
    set(LINK "cp \"$${INPUT}\" input; ${KIND} input out")
    if(KIND STREQUAL "cp")
      set(LINK "cp \"$${INPUT}\" input; mkdir d; cd d; cd ..")
    endif()
    set(NAME out)
    if(KIND STREQUAL "cp")
      set(NAME d/../input)
    endif()
    shell("OUT is the ${INPUT} (${KIND})" "${LINK}; before=$(cksum <input); ${INPUT}=input
      fails \"$replay\" \"$model\" \"$vectors\" ${NAME} 2>said; grep -q '${NAME}: is the input input' said; test \"$(cksum <input)\" = \"$before\"")
  endforeach()
endforeach()
