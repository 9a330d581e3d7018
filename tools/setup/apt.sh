#!/usr/bin/env bash
# Debian packages by group: apt.sh GROUP...
# Installs what is missing (as root, or through sudo that asks for no password); where it may not, lists what to
# install and exits 1. A program that is on the PATH already counts, whoever put it there.
set -euo pipefail

# One line a package: its name, then (optionally) a test that makes it unnecessary.
packages() {
  case $1 in
    make) echo "make" ;;
    host) # C runtime on this machine; CMake and Ninja from Debian, so that no Python is needed for it
      echo "build-essential have gcc && have g++ && have make"
      echo "cmake have cmake"
      echo "ninja-build have ninja"
      echo "libeigen3-dev"
      echo "python3 have python3" ;; # the size report and the generators of the build: standard library only
    sim) # the simulation's engine where mujoco.sh cannot fetch it, and to compare it with
      echo "libmujoco-dev"
      echo "libqhull-dev" ;; # its headers are named by MuJoCo's CMake package, which does not depend on them
    view) # pictures without a display
      echo "libosmesa6" ;;
    python) # interpreter of the .venv, with headers for the module
      echo "python3.11 have python3.11"
      echo "python3.11-venv tools/setup/python.sh --usable"
      echo "python3.11-dev tools/setup/python.sh --usable" ;;
    arm) # Cortex-M cross compiler and the emulated board
      echo "gcc-arm-none-eabi have arm-none-eabi-g++"
      echo "libnewlib-arm-none-eabi have_arm_header stdio.h"
      echo "libstdc++-arm-none-eabi-newlib have_arm_header cmath"
      echo "qemu-system-arm have qemu-system-arm" ;;
    test) # sources of the C test framework, and what the install test tries
      echo "ca-certificates"
      echo "pkg-config have pkg-config"
      echo "git have git"
      echo "xz-utils have xz" ;;
    fuzz) # the compiler that brings libFuzzer, and the sanitizers' libraries
      echo "clang-14 have clang-14 && have clang++-14"
      echo "libclang-rt-14-dev" ;;
    realtime) # the compiler whose sanitizer watches what may not block
      echo "clang-22 have clang-22 && have clang++-22"
      echo "libclang-rt-22-dev" ;;
    bench) # the other program that multiplies matrices with vectors, and the one whose views are offered
      echo "libopenblas-dev"
      echo "libeigen3-dev" ;;
    cross) # other processors, emulated
      echo "qemu-user have qemu-aarch64"
      echo "g++-aarch64-linux-gnu have aarch64-linux-gnu-g++"
      echo "g++-arm-linux-gnueabihf have arm-linux-gnueabihf-g++"
      echo "g++-riscv64-linux-gnu have riscv64-linux-gnu-g++"
      echo "g++-powerpc-linux-gnu have powerpc-linux-gnu-g++"
      echo "g++-s390x-linux-gnu have s390x-linux-gnu-g++"
      echo "gcc-riscv64-unknown-elf have riscv64-unknown-elf-g++"
      echo "picolibc-riscv64-unknown-elf"
      echo "qemu-system-misc have qemu-system-riscv32" ;;
    docs) # what reads the header for the site of the documentation
      echo "doxygen have doxygen" ;;
    wasm) # the runtime for browsers and Node
      echo "clang-14 have clang-14"
      echo "lld-14 have wasm-ld-14"
      echo "wasi-libc"
      echo "libclang-rt-14-dev-wasm32"
      echo "nodejs have node" ;;
    browser) # what tries pages
      echo "chromium have chromium" ;;
    check) # what reads the code and watches it run
      echo "gcovr have gcovr"
      echo "valgrind have valgrind"
      echo "cppcheck have cppcheck"
      echo "clang-tidy have clang-tidy" ;;
    *)
      echo "apt.sh: no group '$1' (make host sim view python arm test fuzz realtime bench cross docs wasm browser check)" >&2
      exit 2 ;;
  esac
}

have() { command -v "$1" >/dev/null; }
have_arm_header() { echo "#include <$1>" | arm-none-eabi-g++ -E -x c++ - >/dev/null 2>&1; }
installed() { dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }

missing_packages() {
  local group package probe
  for group in "$@"; do
    packages "$group" >/dev/null
    while read -r package probe; do
      [[ -n $probe ]] && eval "$probe" </dev/null && continue
      installed "$package" || echo "$package"
    done < <(packages "$group")
  done
}

cd "$(dirname "$0")/../.."
exec 9<tools/setup/apt.sh && flock 9 # make -j runs this script for several groups at once
missing=$(missing_packages "$@" | sort -u | tr '\n' ' ')
[[ -z $missing ]] && exit 0

run=()
if [[ $(id -u) -ne 0 ]]; then
  run=(sudo -n)
  have sudo && sudo -n true 2>/dev/null || run=(false)
fi
if [[ ${run[0]:-} == false ]] || ! have apt-get; then
  echo "Missing packages, and no right to install them here. Please run, then repeat the command:" >&2
  echo "    sudo apt-get update && sudo apt-get install --no-install-recommends $missing" >&2
  exit 1
fi

echo "Installing Debian packages: $missing"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
apt=("${run[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=600)
if ! { "${apt[@]}" update && "${apt[@]}" install -y --no-install-recommends $missing; } >"$log" 2>&1 </dev/null; then
  cat "$log" >&2
  echo "apt-get could not install: $missing(messages above)" >&2
  exit 1
fi
