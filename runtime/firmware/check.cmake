# Runs the firmware on the golden vectors, compares the results on the host, tries the fault handler and bad files, and
# writes a report with flat keys.
#   cmake -DQEMU=qemu-system-arm -DBOARD=mps2-an500 -DIMAGE=aminn_firmware.elf -DMODEL=aminn_model.bin -DVECTORS=golden.bin -DWORK=dir
#         -DPUSHES=pushes.bin -DCOMPARE=aminn_compare -DREPORT=firmware.json -P check.cmake
# Paths of QEMU's semihosting command line must not hold spaces: it runs in WORK on short names.
cmake_minimum_required(VERSION 3.22)
file(MAKE_DIRECTORY "${WORK}")
file(REMOVE "${WORK}/results.bin" "${REPORT}")
configure_file("${VECTORS}" "${WORK}/vectors.bin" COPYONLY)

# runs the image with arguments; expects exit status CODE and MESSAGE in its output; sets OUTPUT
function(firmware CODE MESSAGE)
  set(CONFIG "enable=on,target=native,arg=firmware")
  foreach(ARG IN LISTS ARGN)
    string(APPEND CONFIG ",arg=${ARG}")
  endforeach()
  execute_process(
    COMMAND ${QEMU} -M ${BOARD} -icount shift=0 -nographic -monitor none -serial none
            -semihosting-config ${CONFIG} -kernel ${IMAGE}
    WORKING_DIRECTORY "${WORK}" TIMEOUT 300 RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL CODE OR NOT TEXT MATCHES "${MESSAGE}")
    message(FATAL_ERROR "firmware ${ARGN}: expected status ${CODE} and \"${MESSAGE}\", got ${RESULT}:\n${TEXT}")
  endif()
  set(OUTPUT "${TEXT}" PARENT_SCOPE)
endfunction()

# bad input first: each ends with a message and a status that is not zero
firmware(70 "fault 6 .* PC 0x" --fault)
firmware(1 "usage" vectors.bin)
firmware(1 "cannot open" none.bin results.bin)
execute_process(COMMAND head -c 5000 vectors.bin WORKING_DIRECTORY "${WORK}" OUTPUT_FILE "${WORK}/short.bin")
firmware(1 "truncated" short.bin results.bin)
execute_process(COMMAND sh -c "{ head -c 5000 vectors.bin; printf ZZZZ; tail -c +5005 vectors.bin; } >damaged.bin"
  WORKING_DIRECTORY "${WORK}")
firmware(1 "CRC-32" damaged.bin results.bin)
if(EXISTS "${WORK}/results.bin")
  message(FATAL_ERROR "a refused vector file left results")
endif()

firmware(0 "self_test_modes" --self-test)
set(SELF_TEST "${OUTPUT}")
firmware(1 "cannot open" --control none.bin)
firmware(1 "not a whole" --control short.bin)
firmware(0 "control_ticks" --control vectors.bin)
set(CONTROL "${OUTPUT}")
if(EXISTS "${PUSHES}") # of the reference hand
  configure_file("${PUSHES}" "${WORK}/pushes.bin" COPYONLY)
  firmware(1 "cannot open" --calibrate none.bin)
  firmware(1 "not a whole" --calibrate short.bin)
  firmware(0 "calibrate_loads" --calibrate pushes.bin)
  string(APPEND CONTROL "${OUTPUT}")
endif()
firmware(0 "samples" vectors.bin results.bin)
string(REGEX REPLACE "firmware: " "" FIGURES "${SELF_TEST}\n${CONTROL}\n${OUTPUT}")
# the bits that the host's library predicts, then the reference of the vector file
set(DIFFERENCES "")
foreach(HOW --exact "--show;10")
  execute_process(COMMAND ${COMPARE} ${HOW} ${MODEL} ${VECTORS} ${WORK}/results.bin
    RESULT_VARIABLE RESULT OUTPUT_VARIABLE FOUND ERROR_VARIABLE COMPLAINT)
  if(NOT RESULT EQUAL 0)
    message(FATAL_ERROR "${BOARD} against the host (aminn_compare ${HOW}):\n${FOUND}${COMPLAINT}")
  endif()
  string(APPEND DIFFERENCES "${FOUND}")
endforeach()

set(LINES "")
string(REGEX MATCHALL "[a-z_0-9]+ [-+.e0-9]+" PAIRS "${FIGURES}\n${DIFFERENCES}")
list(REMOVE_DUPLICATES PAIRS)
list(SORT PAIRS)
foreach(PAIR IN LISTS PAIRS)
  string(REPLACE " " ";" PAIR "${PAIR}")
  list(GET PAIR 0 NAME)
  list(GET PAIR 1 VALUE)
  list(APPEND LINES "  \"${NAME}\": ${VALUE}")
  message("  ${NAME} ${VALUE}")
endforeach()
list(JOIN LINES ",\n" JSON)
get_filename_component(REPORT_DIR "${REPORT}" DIRECTORY)
file(MAKE_DIRECTORY "${REPORT_DIR}")
file(WRITE "${REPORT}" "{\n${JSON}\n}\n")
message("${BOARD} agrees with the reference; report: ${REPORT}")
