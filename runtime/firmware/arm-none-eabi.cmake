# Toolchain file: bare-metal Cortex-M with an FPU, newlib-nano, no operating system. BOARD is one of qemu's MPS2 boards:
#   mps2-an386 Cortex-M4F, mps2-an500 Cortex-M7 (the default), mps2-an505 Cortex-M33
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR arm)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_CXX_COMPILER arm-none-eabi-g++)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY) # nothing can be linked or run before our startup code exists
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES BOARD)
set(BOARD mps2-an500 CACHE STRING "mps2-an386, mps2-an500 or mps2-an505")
set(CPU_mps2-an386 "-mcpu=cortex-m4 -mfpu=fpv4-sp-d16")
set(CPU_mps2-an500 "-mcpu=cortex-m7 -mfpu=fpv5-d16")
set(CPU_mps2-an505 "-mcpu=cortex-m33 -mfpu=fpv5-sp-d16")
if(NOT DEFINED CPU_${BOARD})
  message(FATAL_ERROR "BOARD=${BOARD}: expected mps2-an386, mps2-an500 or mps2-an505")
endif()
set(CPU "${CPU_${BOARD}} -mthumb -mfloat-abi=hard")
set(CMAKE_C_FLAGS_INIT "${CPU} -ffunction-sections -fdata-sections")
set(CMAKE_CXX_FLAGS_INIT "${CPU} -ffunction-sections -fdata-sections")
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
