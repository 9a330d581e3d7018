# The library with AMINN_MAX_WIDTH=16: smaller context, larger models refused, a caller compiled with another value found.
#   cmake -DSOURCE=tree -DGENERATOR=Ninja -DC_COMPILER=cc -DWORK=dir -P max_width_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")
file(MAKE_DIRECTORY "${WORK}")

function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
  if(NOT RESULT EQUAL 0)
    message(FATAL_ERROR "${ARGN}: ${RESULT}\n${TEXT}")
  endif()
endfunction()

run(${CMAKE_COMMAND} -S ${SOURCE}/runtime -B ${WORK}/lib -G ${GENERATOR} -DCMAKE_C_COMPILER=${C_COMPILER}
  -DAMINN_MAX_WIDTH=16 -DAMINN_RT_TOOLS=OFF -DCMAKE_BUILD_TYPE=Debug)
run(${CMAKE_COMMAND} --build ${WORK}/lib)
file(WRITE ${WORK}/use.c [[
#include <stdio.h>
#include "tiny_model.h"
int main(void)
{
    static aminn_t ctx;
    aminn_model_t wide = tiny_model;
    wide.width[0] = AMINN_MAX_WIDTH + 1;
    printf("%zu %s", sizeof ctx, aminn_status_name(aminn_init(&ctx, &tiny_model, 0)));
    printf(" %s\n", aminn_status_name(aminn_init(&ctx, &wide, 0)));
    return 0;
}
]])
set(COMPILE ${C_COMPILER} -std=c99 -I${SOURCE}/runtime/include -I${SOURCE}/tests/golden ${WORK}/use.c
  ${SOURCE}/tests/golden/tiny_model.c)
run(${COMPILE} -DAMINN_MAX_WIDTH=16 -o ${WORK}/same ${WORK}/lib/libaminn_rt.a -lm)
run(${COMPILE} -o ${WORK}/other ${WORK}/lib/libaminn_rt.a -lm)
execute_process(COMMAND ${WORK}/same OUTPUT_VARIABLE SAME)
execute_process(COMMAND ${WORK}/other OUTPUT_VARIABLE OTHER)
message(STATUS "same width: ${SAME}, other width: ${OTHER}")
if(NOT SAME MATCHES "^[0-9]+ AMINN_OK AMINN_E_DIMS")
  message(FATAL_ERROR "AMINN_MAX_WIDTH=16: ${SAME}")
endif()
if(NOT OTHER MATCHES "AMINN_E_CONTEXT_SIZE")
  message(FATAL_ERROR "a caller compiled with another AMINN_MAX_WIDTH was not found: ${OTHER}")
endif()
string(REGEX MATCH "^[0-9]+" SMALL "${SAME}")
string(REGEX MATCH "^[0-9]+" LARGE "${OTHER}")
math(EXPR SAVED "${LARGE} - ${SMALL}")
if(NOT SAVED EQUAL 648) # 12 bytes for each of 25, 4 for each of 87, as the header says
  message(FATAL_ERROR "the context shrank by ${SAVED} bytes")
endif()
