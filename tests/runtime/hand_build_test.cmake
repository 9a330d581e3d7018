# The library built for another hand by -DAMINN_HAND, in a folder with a space: installed and found by find_package and by
# pkg-config, taken in by add_subdirectory; with the library of the reference hand beside it the program does not link.
#   cmake -DSOURCE=tree -DHAND=header -DREFERENCE=libaminn_rt.a -DWORK=dir -DGENERATOR=Ninja -DC_COMPILER=cc -P hand_build_test.cmake
cmake_minimum_required(VERSION 3.22)
file(REMOVE_RECURSE "${WORK}")
set(FOLDER "${WORK}/another hand")
configure_file("${HAND}" "${FOLDER}/aminn_hand.h" COPYONLY)
set(FAST -G ${GENERATOR} -DCMAKE_BUILD_TYPE=Debug -DAMINN_RT_TOOLS=OFF -DAMINN_RT_DISPATCH=OFF)

function(run EXPECTED)
  execute_process(COMMAND ${ARGN} WORKING_DIRECTORY "${FOLDER}" RESULT_VARIABLE RESULT OUTPUT_VARIABLE OUT ERROR_VARIABLE OUT)
  set(OUTPUT "${OUT}" PARENT_SCOPE)
  if((EXPECTED STREQUAL "ok" AND NOT RESULT EQUAL 0) OR (EXPECTED STREQUAL "fail" AND RESULT EQUAL 0))
    message(FATAL_ERROR "expected ${EXPECTED}, got ${RESULT}: ${ARGN}\n${OUT}")
  endif()
endfunction()
function(expect TEXT)
  if(NOT OUTPUT MATCHES "${TEXT}")
    message(FATAL_ERROR "expected \"${TEXT}\" in:\n${OUTPUT}")
  endif()
endfunction()

# ends with 0 if it was compiled with the counts of the library that it is linked with
file(WRITE "${FOLDER}/user.c" "#include \"aminn_rt.h\"
typedef char for_the_other_hand[AMINN_N_BRANCH == 2 && AMINN_N_COORD == 2 ? 1 : -1];
static aminn_t ctx;
static aminn_model_t model = {.format_version = AMINN_FORMAT_VERSION, .n_branch = 3, .library = AMINN_LIBRARY};
int main(void)
{
    return aminn_init(&ctx, &model, 0) != AMINN_E_DIMS || aminn_field_name(0)[0] != 'q';
}
")
set(TARGET "add_executable(user user.c)\ntarget_link_libraries(user PRIVATE aminn_rt::aminn_rt)\n")
set(PROJECT "cmake_minimum_required(VERSION 3.22)\nproject(user LANGUAGES C CXX)\n")

# a relative path begins where cmake is called
run(ok ${CMAKE_COMMAND} -S "${SOURCE}/runtime" -B build ${FAST} -DAMINN_HAND=aminn_hand.h)
run(ok ${CMAKE_COMMAND} --build build)
run(ok ${CMAKE_COMMAND} --install build --prefix "${FOLDER}/prefix")
run(fail ${CMAKE_COMMAND} -S "${SOURCE}/runtime" -B wrong ${FAST} -DAMINN_HAND=no_such_hand.h)
expect("AMINN_HAND: no file")
expect("no_such_hand.h; `aminn export` writes")

file(WRITE "${FOLDER}/found/CMakeLists.txt" "${PROJECT}find_package(aminn_rt 0.1 REQUIRED)\n${TARGET}")
file(COPY "${FOLDER}/user.c" DESTINATION "${FOLDER}/found")
run(ok ${CMAKE_COMMAND} -S found -B found/build -G ${GENERATOR} "-DCMAKE_PREFIX_PATH=${FOLDER}/prefix")
run(ok ${CMAKE_COMMAND} --build found/build)
run(ok "${FOLDER}/found/build/user")

file(WRITE "${FOLDER}/inside/CMakeLists.txt" "${PROJECT}set(AMINN_HAND \"${FOLDER}/aminn_hand.h\")
add_subdirectory(\"${SOURCE}/runtime\" aminn_rt)\n${TARGET}")
file(COPY "${FOLDER}/user.c" DESTINATION "${FOLDER}/inside")
run(ok ${CMAKE_COMMAND} -S inside -B inside/build ${FAST})
run(ok ${CMAKE_COMMAND} --build inside/build)
run(ok "${FOLDER}/inside/build/user")

# the wrong library, and both in one program
file(GLOB_RECURSE OWN "${FOLDER}/prefix/libaminn_rt.a")
set(COMPILE ${C_COMPILER} -std=c99 "-I${FOLDER}/prefix/include" user.c)
run(fail ${COMPILE} "${REFERENCE}" -lm -o user)
expect("undefined reference to .aminn_library_of_2_branches_2_coordinates_4_joints_2_gated_0_twisted_4_stiff_2_tendons_0_slide")
run(ok ${COMPILE} "${OWN}" -lm -o user)
file(WRITE "${FOLDER}/other.c" "extern const char aminn_library_of_3_branches_3_coordinates_8_joints_3_gated_0_twisted_10_stiff_6_tendons_1_slide[];
const char *other(void) { return aminn_library_of_3_branches_3_coordinates_8_joints_3_gated_0_twisted_10_stiff_6_tendons_1_slide; }\n")
run(fail ${COMPILE} other.c "${OWN}" "${REFERENCE}" -lm -o user)
expect("multiple definition of .aminn_init_sized")

find_program(PKG_CONFIG NAMES pkg-config pkgconf)
if(PKG_CONFIG)
  file(GLOB_RECURSE PC "${FOLDER}/prefix/aminn_rt.pc")
  get_filename_component(PC_DIR "${PC}" DIRECTORY)
  set(ENV{PKG_CONFIG_PATH} "${PC_DIR}")
  run(ok ${PKG_CONFIG} --cflags --libs aminn_rt)
  separate_arguments(FLAGS UNIX_COMMAND "${OUTPUT}")
  run(ok ${C_COMPILER} -std=c99 user.c -o user-pc ${FLAGS})
  run(ok "${FOLDER}/user-pc")
endif()
