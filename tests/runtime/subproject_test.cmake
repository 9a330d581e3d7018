# The example as a project that takes the library in by add_subdirectory and by FetchContent, from C and from C++, in a
# folder with a space, with the options that such projects set for all of their parts.
#   cmake -DSOURCE=tree -DWORK=dir -DGENERATOR=Ninja -P subproject_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")
set(HOLDS ": holds; notes 0\nthe tool moves by")

# EXPECTED is what both programs print; SETTINGS come before the library, USER_OPTIONS are of the programs.
function(try NAME EXPECTED SETTINGS TAKE_IN USER_OPTIONS)
  set(PARENT "${WORK}/${NAME} project")
  file(WRITE "${PARENT}/CMakeLists.txt" "cmake_minimum_required(VERSION 3.22)
project(user LANGUAGES C CXX)
${SETTINGS}
${TAKE_IN}
configure_file(\"${SOURCE}/runtime/examples/controller.c\" controller.cpp COPYONLY)
add_library(model OBJECT \"${SOURCE}/tests/golden/aminn_model.c\")
target_link_libraries(model PUBLIC aminn_rt::aminn_rt)
add_library(shared SHARED \"\${CMAKE_CURRENT_BINARY_DIR}/controller.cpp\")
target_compile_definitions(shared PRIVATE main=controller)
set_target_properties(shared PROPERTIES WINDOWS_EXPORT_ALL_SYMBOLS ON POSITION_INDEPENDENT_CODE ON)
set_target_properties(model PROPERTIES POSITION_INDEPENDENT_CODE ON)
file(WRITE \"\${CMAKE_CURRENT_BINARY_DIR}/main.cpp\" \"int controller();\\nint main() { return controller(); }\\n\")
add_executable(from_c \"${SOURCE}/runtime/examples/controller.c\")
add_executable(from_cpp \"\${CMAKE_CURRENT_BINARY_DIR}/main.cpp\")
foreach(T from_c shared)
  target_include_directories(\${T} PRIVATE \"${SOURCE}/tests/golden\")
  target_compile_options(\${T} PRIVATE ${USER_OPTIONS})
  target_link_libraries(\${T} PRIVATE model aminn_rt::aminn_rt m)
endforeach()
target_link_libraries(from_cpp PRIVATE shared)
")
  foreach(STEP
      "${CMAKE_COMMAND};-S;${PARENT};-B;${PARENT}/build;-G;${GENERATOR}" "${CMAKE_COMMAND};--build;${PARENT}/build"
      "${PARENT}/build/from_c" "${PARENT}/build/from_cpp")
    execute_process(COMMAND ${STEP} RESULT_VARIABLE RESULT OUTPUT_VARIABLE TEXT ERROR_VARIABLE TEXT)
    if(STEP MATCHES "/from_")
      if(NOT TEXT MATCHES "${EXPECTED}")
        message(FATAL_ERROR "${NAME}: ${STEP}: expected \"${EXPECTED}\", got ${RESULT}: ${TEXT}")
      endif()
    elseif(NOT RESULT EQUAL 0)
      message(FATAL_ERROR "${NAME}: ${STEP}: ${RESULT}\n${TEXT}")
    endif()
  endforeach()
endfunction()

set(SUBDIRECTORY "add_subdirectory(\"${SOURCE}/runtime\" aminn_rt)")
set(ALONE "set(AMINN_RT_TOOLS OFF)\nset(AMINN_RT_DISPATCH OFF)")

# in one translation unit a target, symbols hidden, all warnings, enums as short as they can be
try(unity "${HOLDS}" "set(CMAKE_UNITY_BUILD ON)
set(CMAKE_UNITY_BUILD_BATCH_SIZE 0)
set(CMAKE_C_VISIBILITY_PRESET hidden)
set(CMAKE_BUILD_TYPE Release)
add_compile_options(-Wall -Wextra -Werror)" "${SUBDIRECTORY}"
  "-fshort-enums -pedantic $<$<COMPILE_LANGUAGE:C>:-std=c11> $<$<COMPILE_LANGUAGE:CXX>:-std=c++20>")

# with a sanitizer and -Werror, all of the cores
try(sanitized "${HOLDS}" "set(AMINN_RT_TOOLS OFF)
set(CMAKE_BUILD_TYPE Release)
add_compile_options(-Wall -Wextra -Werror -fsanitize=undefined -fno-sanitize-recover=all)
add_link_options(-fsanitize=undefined)" "${SUBDIRECTORY}" "-O1")

# all of it with -ffast-math: the library takes it back, the start-up code that flushes subnormal numbers is found
try(fast "AMINN_E_FLUSH" "${ALONE}
add_compile_options(-O2 -ffast-math -fassociative-math)
add_link_options(-ffast-math)" "${SUBDIRECTORY}" "-O1")

try(fetch_content "${HOLDS}" "${ALONE}" "include(FetchContent)
FetchContent_Declare(aminn_rt SOURCE_DIR \"${SOURCE}\" SOURCE_SUBDIR runtime)
FetchContent_MakeAvailable(aminn_rt)" "-std=gnu2x")
