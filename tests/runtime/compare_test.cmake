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
file(SHA256 ${WORK}/blob.bin BLOB)
file(SHA256 ${WORK}/compiled.bin COMPILED)
if(NOT BLOB STREQUAL COMPILED)
  message(FATAL_ERROR "the compiled model and the blob give different results")
endif()
run(0 "decisions_different 0" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/blob.bin)
message(STATUS "${OUTPUT}")

# differences and unusable files are told apart from agreement
run(0 samples ${REPLAY} ${MODEL} ${GOLDEN}/tiny_golden.bin ${WORK}/other.bin)
run(1 "dx_ht of sample [0-9]+" ${COMPARE} ${MODEL} ${GOLDEN}/tiny_golden.bin ${WORK}/other.bin)
run(1 "has [0-9]+ samples" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/other.bin)
run(1 "not a result file" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${GOLDEN}/golden.bin)
run(1 "No such file" ${COMPARE} ${MODEL} ${GOLDEN}/golden.bin ${WORK}/none.bin)
run(2 "usage" ${COMPARE})
