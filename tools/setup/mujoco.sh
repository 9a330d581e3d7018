#!/usr/bin/env bash
# MuJoCo 2.2.2, the simulation's engine: mujoco.sh DIR PYTHON [PIP-ARGUMENT...]
# Puts library, headers and licences from the wheel of the Python package registry into DIR (PYTHON is one that has pip).
# Where the wheel cannot be had, or does not run here, installs Debian's package, which is slower, and removes DIR. Says
# which.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=$1 python=$2
shift 2
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Why the wheel's library cannot be taken, or nothing.
take_wheel() {
  local machine library=$scratch/ready/lib/libmujoco.so.2.2.2
  machine=$(uname -m)
  if [[ $machine == x86_64 ]] && ! grep -qw avx /proc/cpuinfo; then
    echo "this processor has no AVX"
    return
  fi
  if ! "$python" -m pip download --quiet --disable-pip-version-check --retries 2 --no-deps --only-binary=:all: \
    --require-hashes --python-version 3.10 --implementation cp --abi cp310 --platform "manylinux_2_17_$machine" \
    --dest "$scratch" -r tools/setup/mujoco.txt "$@" >"$scratch/log" 2>&1; then
    echo "the registry gives none for $machine: $(tail -n 1 "$scratch/log")"
    return
  fi
  mkdir -p "$scratch/ready/lib"
  if ! {
    "$python" -m zipfile -e "$scratch"/mujoco-*.whl "$scratch/wheel" &&
      mv "$scratch/wheel/mujoco/libmujoco.so.2.2.2" "$library" &&
      mv "$scratch/wheel/mujoco/include" "$scratch"/wheel/*.dist-info/LICENSE* "$scratch/ready" &&
      "$python" -c 'import ctypes, sys; sys.exit(ctypes.CDLL(sys.argv[1]).mj_version() != 222)' "$library"
  } >"$scratch/log" 2>&1; then
    echo "the wheel's library does not run here: $(tail -n 1 "$scratch/log")"
  fi
}

why_not=$(take_wheel "$@")
rm -rf "$target"
if [[ -z $why_not ]]; then
  mkdir -p "$(dirname "$target")"
  mv "$scratch/ready" "$target"
  echo "MuJoCo 2.2.2: the build of the Python package registry"
else
  tools/setup/apt.sh sim
  echo "MuJoCo 2.2.2: Debian's build, which is slower ($why_not)"
fi
