# The linked image holds no allocator, no exceptions, no thread-safe statics.
#   cmake -DNM=nm -DIMAGE=aminn_firmware.elf -P no_allocator.cmake
cmake_minimum_required(VERSION 3.22)
execute_process(COMMAND ${NM} -f posix ${IMAGE} OUTPUT_VARIABLE SYMBOLS RESULT_VARIABLE RESULT)
if(NOT RESULT EQUAL 0)
  message(FATAL_ERROR "${NM} ${IMAGE}: ${RESULT}")
endif()
string(REGEX MATCHALL "(^|\n)_*(malloc|free|calloc|realloc|sbrk|malloc_r|free_r|sbrk_r|cxa_[a-z_]+|gxx_personality_v0|Zn[wa][a-z]+|Zd[la]Pv[a-z]*|Unwind_[A-Za-z]+)( |_)"
  FOUND "${SYMBOLS}")
if(FOUND)
  message(FATAL_ERROR "${IMAGE} holds what it must not: ${FOUND}")
endif()
