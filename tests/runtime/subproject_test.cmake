# The example as a project that takes the library in by add_subdirectory and by FetchContent, from C and from C++.
#   cmake -DSOURCE=tree -DWORK=dir -DGENERATOR=Ninja -P subproject_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")

function(try NAME TAKE_IN)
  file(WRITE "${WORK}/${NAME}/CMakeLists.txt" "cmake_minimum_required(VERSION 3.22)
project(user LANGUAGES C CXX)
${TAKE_IN}
configure_file(${SOURCE}/runtime/examples/controller.c controller.cpp COPYONLY)
add_executable(from_c ${SOURCE}/runtime/examples/controller.c ${SOURCE}/tests/golden/aminn_model.c)
add_executable(from_cpp \${CMAKE_CURRENT_BINARY_DIR}/controller.cpp ${SOURCE}/tests/golden/aminn_model.c)
foreach(T from_c from_cpp)
  target_include_directories(\${T} PRIVATE ${SOURCE}/tests/golden)
  target_link_libraries(\${T} PRIVATE aminn_rt::aminn_rt m)
endforeach()
")
  foreach(STEP
      "${CMAKE_COMMAND};-S;${WORK}/${NAME};-B;${WORK}/${NAME}/build;-G;${GENERATOR};-DAMINN_RT_TOOLS=OFF;-DAMINN_RT_DISPATCH=OFF"
      "${CMAKE_COMMAND};--build;${WORK}/${NAME}/build" "${WORK}/${NAME}/build/from_c" "${WORK}/${NAME}/build/from_cpp")
    execute_process(COMMAND ${STEP} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
    if(NOT RESULT EQUAL 0)
      message(FATAL_ERROR "${NAME}: ${STEP}: ${RESULT}\n${TEXT}")
    endif()
    if(STEP MATCHES "/from_" AND NOT TEXT MATCHES ": holds; notes 0\nthe tool moves by")
      message(FATAL_ERROR "${NAME}: ${STEP}: ${TEXT}")
    endif()
  endforeach()
endfunction()

try(subdirectory "add_subdirectory(${SOURCE}/runtime aminn_rt)")
try(fetch_content "include(FetchContent)
FetchContent_Declare(aminn_rt SOURCE_DIR ${SOURCE} SOURCE_SUBDIR runtime)
FetchContent_MakeAvailable(aminn_rt)")
