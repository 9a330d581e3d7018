# aminn_replay on the blob and on the compiled model, judged by aminn_compare.
#   cmake -DREPLAY= -DREPLAY_MODEL= -DCOMPARE= -DGOLDEN=tests/golden -DWORK=dir -P compare_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")
file(MAKE_DIRECTORY "${WORK}")
set(MODEL "${GOLDEN}/aminn_model.bin")

function(run CODE MESSAGE)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL CODE OR NOT TEXT MATCHES "${MESSAGE}")
    message(FATAL_ERROR "expected exit ${CODE} and \"${MESSAGE}\", got ${RESULT}: ${ARGN}\n${TEXT}")
  endif()
  set(OUTPUT "${TEXT}" PARENT_SCOPE)
endfunction()

run(0 samples ${REPLAY} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/blob.bin)
run(0 samples ${REPLAY_MODEL} ${GOLDEN}/golden.bin ${WORK}/compiled.bin)
run(0 "different_words 0" ${COMPARE} ${WORK}/blob.bin ${WORK}/compiled.bin)
run(0 "different_words 0" ${COMPARE} --exact ${MODEL} ${GOLDEN}/golden.bin ${WORK}/blob.bin)
run(0 "decisions_different 0" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/blob.bin)
message(STATUS "${OUTPUT}")
run(0 "decisions_different 0" ${COMPARE} ${WORK}/blob.bin ${MODEL} ${GOLDEN}/golden.bin) # in any order

# differences: 1, and all of them are told
run(0 samples ${REPLAY} ${MODEL} ${GOLDEN}/tiny_golden.bin ${WORK}/other.bin)
run(1 "of sample [0-9]+: got [^,]+, want [^,]+, limit .* numbers differ; the worst 10 stand above"
  ${COMPARE} ${MODEL} ${GOLDEN}/tiny_golden.bin ${WORK}/other.bin)
run(1 "samples: got 48, want 200" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/other.bin)
run(1 "samples: got 48, want 200" ${COMPARE} ${WORK}/blob.bin ${WORK}/other.bin)
run(1 "the reference is of content_crc" ${COMPARE} --json ${WORK}/report.json --junit ${WORK}/report.xml
  ${MODEL} ${GOLDEN}/tiny_golden.bin ${WORK}/other.bin)
file(READ ${WORK}/report.json REPORT)
string(JSON COUNT GET "${REPORT}" numbers_beyond_limit)
string(JSON LISTED LENGTH "${REPORT}" failures)
if(NOT COUNT EQUAL LISTED OR COUNT LESS 100)
  message(FATAL_ERROR "${COUNT} numbers differ, ${LISTED} are listed")
endif()
file(READ ${WORK}/report.xml REPORT)
if(NOT REPORT MATCHES "<testsuite name=\"aminn_compare\" tests=\"11\" failures=\"9\"")
  message(FATAL_ERROR "not the JUnit file that was expected:\n${REPORT}")
endif()

# reports go where they are asked to, and nowhere else
run(0 "\"ok\": true" ${COMPARE} --json /dev/stdout ${WORK}/blob.bin ${WORK}/compiled.bin)
run(3 "is the input" ${COMPARE} --json ${WORK}/blob.bin ${WORK}/blob.bin ${WORK}/compiled.bin)

# files that cannot be judged: 3; arguments: 2
run(3 "No such file" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/none.bin)
run(3 "neither a model" ${COMPARE} ${WORK}/report.xml ${WORK}/blob.bin)
execute_process(COMMAND head -c 5000 ${WORK}/blob.bin OUTPUT_FILE ${WORK}/short.bin)
run(3 "truncated" ${COMPARE} ${WORK}/blob.bin ${WORK}/short.bin)
run(3 "cannot write" ${COMPARE} --json ${WORK}/no/folder.json ${WORK}/blob.bin ${WORK}/blob.bin)
run(2 "usage" ${COMPARE})
run(2 "needed" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin)
run(2 "unknown option" ${COMPARE} --fast ${WORK}/blob.bin ${WORK}/blob.bin)
run(2 "one kind" ${COMPARE} ${WORK}/blob.bin ${WORK}/blob.bin ${WORK}/blob.bin)

# a report over an input is refused, and one to standard output is written there
file(COPY_FILE ${WORK}/blob.bin ${WORK}/kept.bin)
foreach(OPTION IN ITEMS --json --junit)
  run(3 "blob.bin: is the input " ${COMPARE} ${OPTION} ${WORK}/blob.bin ${WORK}/blob.bin ${WORK}/compiled.bin)
  run(0 "different_words 0" ${COMPARE} ${OPTION} /dev/stdout ${WORK}/blob.bin ${WORK}/kept.bin)
endforeach()
