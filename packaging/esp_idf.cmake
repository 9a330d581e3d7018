# The runtime as an ESP-IDF component; the root CMakeLists.txt includes this file in such a build, and idf_component.yml names it.
file(GLOB AMINN_RT_SOURCES ${CMAKE_CURRENT_LIST_DIR}/../runtime/src/*.cpp)
idf_component_register(SRCS ${AMINN_RT_SOURCES} INCLUDE_DIRS ${CMAKE_CURRENT_LIST_DIR}/../runtime/include)
include(${CMAKE_CURRENT_LIST_DIR}/../runtime/cmake/options.cmake)
target_compile_features(${COMPONENT_LIB} PRIVATE cxx_std_17)
target_compile_options(${COMPONENT_LIB} PRIVATE ${AMINN_RT_ARITHMETIC} ${AMINN_RT_NO_ALLOCATOR} ${AMINN_RT_EMBEDDED})
