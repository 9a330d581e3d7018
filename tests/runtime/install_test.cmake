# Install the library into an empty folder, build examples/ against it with CMake and with pkg-config, run them, and
# see a wrong version refused.
#   cmake -DBUILD=build/host -DSOURCE=tree -DWORK=dir -DGENERATOR=Ninja -DC_COMPILER=cc -P install_test.cmake
cmake_minimum_required(VERSION 3.22)
set(PREFIX "${WORK}/prefix")
file(REMOVE_RECURSE "${WORK}")
file(MAKE_DIRECTORY "${WORK}")

function(run EXPECTED)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE RESULT OUTPUT_VARIABLE OUT ERROR_VARIABLE OUT)
  set(OUTPUT "${OUT}" PARENT_SCOPE)
  if((EXPECTED STREQUAL "ok" AND NOT RESULT EQUAL 0) OR (EXPECTED STREQUAL "fail" AND RESULT EQUAL 0))
    message(FATAL_ERROR "expected ${EXPECTED}, got ${RESULT}: ${ARGN}\n${OUT}")
  endif()
endfunction()

run(ok ${CMAKE_COMMAND} --install "${BUILD}" --prefix "${PREFIX}")
set(CONFIGURE ${CMAKE_COMMAND} -S "${SOURCE}/runtime/examples" -G ${GENERATOR} -DCMAKE_PREFIX_PATH=${PREFIX}
  -DCMAKE_C_COMPILER=${C_COMPILER} -DMODEL_DIR=${SOURCE}/tests/golden)
run(ok ${CONFIGURE} -B "${WORK}/cmake")
run(ok ${CMAKE_COMMAND} --build "${WORK}/cmake")
run(ok "${WORK}/cmake/controller")
message(STATUS "${OUTPUT}")
if(NOT OUTPUT MATCHES "p_stable")
  message(FATAL_ERROR "the example printed no prediction: ${OUTPUT}")
endif()

run(fail ${CONFIGURE} -B "${WORK}/wrong" -DAMINN_RT_WANTED=9.0)
if(NOT OUTPUT MATCHES "9\\.0")
  message(FATAL_ERROR "the wrong version was refused for another reason:\n${OUTPUT}")
endif()

# any other minor version is another interface, older or newer; the same one, exactly asked for, is found
foreach(WANTED 0.2 1.0 0.1.1)
  run(fail ${CONFIGURE} -B "${WORK}/wrong-${WANTED}" -DAMINN_RT_WANTED=${WANTED})
endforeach()
run(ok ${CONFIGURE} -B "${WORK}/exact" "-DAMINN_RT_WANTED=0.1.0\;EXACT")

# the installed package from C++
file(WRITE "${WORK}/cpp/main.cpp" "#include <aminn_model.h>\n#include <cstdio>\nint main() { std::puts(aminn_version()); static aminn_t ctx; return aminn_init(&ctx, &aminn_model, 0); }\n")
file(WRITE "${WORK}/cpp/CMakeLists.txt" "cmake_minimum_required(VERSION 3.22)
project(user LANGUAGES C CXX)
find_package(aminn_rt 0.1 REQUIRED)
add_executable(user main.cpp ${SOURCE}/tests/golden/aminn_model.c)
target_include_directories(user PRIVATE ${SOURCE}/tests/golden)
target_link_libraries(user PRIVATE aminn_rt::aminn_rt)
")
run(ok ${CMAKE_COMMAND} -S "${WORK}/cpp" -B "${WORK}/cpp/build" -G ${GENERATOR} -DCMAKE_PREFIX_PATH=${PREFIX})
run(ok ${CMAKE_COMMAND} --build "${WORK}/cpp/build")
run(ok "${WORK}/cpp/build/user")

find_program(PKG_CONFIG NAMES pkg-config pkgconf)
if(NOT PKG_CONFIG)
  message(STATUS "no pkg-config here: aminn_rt.pc was not tried")
  return()
endif()
file(GLOB_RECURSE PC "${PREFIX}/aminn_rt.pc")
get_filename_component(PC_DIR "${PC}" DIRECTORY)
set(ENV{PKG_CONFIG_PATH} "${PC_DIR}")
run(ok ${PKG_CONFIG} --cflags --libs "aminn_rt = 0.1.0")
separate_arguments(FLAGS UNIX_COMMAND "${OUTPUT}")
run(fail ${PKG_CONFIG} --exists "aminn_rt >= 9")
set(GOLDEN "${SOURCE}/tests/golden")
run(ok ${C_COMPILER} -std=c99 -I${GOLDEN} "${SOURCE}/runtime/examples/controller.c" "${GOLDEN}/aminn_model.c"
  -o "${WORK}/controller-pc" ${FLAGS})
run(ok "${WORK}/controller-pc")
