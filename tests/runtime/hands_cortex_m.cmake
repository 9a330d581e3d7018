# The numerical core for another hand on qemu's Cortex-M7: the bits of the host's plain core.
#   cmake -DSOURCE=tree -DHAND=header -DTEST=test_hands_3x3 -DWORK=dir -P hands_cortex_m.cmake
cmake_minimum_required(VERSION 3.22)
find_program(CXX arm-none-eabi-g++)
find_program(CC arm-none-eabi-gcc)
find_program(QEMU qemu-system-arm)
if(NOT CXX OR NOT CC OR NOT QEMU)
  message("skipped: it needs arm-none-eabi-g++ and qemu-system-arm; make setup-arm installs them")
  return()
endif()
include(${SOURCE}/runtime/cmake/options.cmake)
set(FIRMWARE ${SOURCE}/runtime/firmware)
set(FLASH_ORIGIN 0x00000000)
set(RAM_ORIGIN 0x20000000)
set(RAM_LENGTH 128K)
file(MAKE_DIRECTORY ${WORK})
configure_file(${FIRMWARE}/mps2.ld.in ${WORK}/mps2.ld @ONLY)

function(run OUTPUT)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL 0)
    message(FATAL_ERROR "${ARGN}: ${RESULT}\n${TEXT}")
  endif()
  string(STRIP "${TEXT}" TEXT)
  set(${OUTPUT} "${TEXT}" PARENT_SCOPE)
endfunction()

set(CPU -mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard -Os -ffunction-sections -fdata-sections)
set(WARNINGS -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Werror)
run(IGNORED ${CXX} ${CPU} ${WARNINGS} -std=c++17 ${AMINN_RT_ARITHMETIC} ${AMINN_RT_NO_ALLOCATOR} ${AMINN_RT_EMBEDDED}
  -DAMINN_HAND_HEADER="${HAND}" -I${SOURCE}/runtime/include -I${SOURCE}/runtime/src -I${SOURCE}/runtime/tools -I${FIRMWARE}
  -I${CMAKE_CURRENT_LIST_DIR} -r -nostdlib ${CMAKE_CURRENT_LIST_DIR}/hand_probe.cpp ${SOURCE}/runtime/src/cascade.cpp -o ${WORK}/probe.o)
run(IGNORED ${CC} ${CPU} -std=gnu99 -T${WORK}/mps2.ld -nostartfiles --specs=nano.specs -Wl,--gc-sections ${FIRMWARE}/startup.c
  ${FIRMWARE}/machine_cortex_m.c ${FIRMWARE}/semihosting.c ${WORK}/probe.o -o ${WORK}/probe.elf -lm)
run(GOT ${QEMU} -M mps2-an500 -nographic -monitor none -serial none -semihosting-config enable=on,target=native
  -kernel ${WORK}/probe.elf)
run(WANTED ${TEST} --digest)
message("Cortex-M7 ${GOT}, this machine ${WANTED}")
if(NOT GOT STREQUAL WANTED)
  message(FATAL_ERROR "the bits differ")
endif()
