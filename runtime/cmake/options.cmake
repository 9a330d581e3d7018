# How the library is compiled, wherever it is: with CMake, in Zephyr (zephyr/), by tools/export (targets.py reads this file),
# with PlatformIO (library.json repeats it, which a test sees to).
set(AMINN_RT_ARITHMETIC # -fno-fast-math first: takes back what a parent project sets
  -fno-fast-math -fno-math-errno -fno-trapping-math -ffp-contract=off)
set(AMINN_RT_NO_ALLOCATOR # exceptions, run-time types and guards of statics would link one
  -fno-exceptions -fno-rtti -fno-threadsafe-statics)
set(AMINN_RT_EMBEDDED # six zeros are stored faster than memset of a small C library stores them
  -fno-tree-loop-distribute-patterns)
