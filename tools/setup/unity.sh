#!/usr/bin/env bash
# Unity, the C test framework of ThrowTheSwitch: unity.sh DIR puts it into DIR (DIR/src/unity.c, .h, _internals.h).
# Uses an installed CMake package or UNITY_ROOT if there is one; else the upstream release; else the copy inside Debian's source package ntpsec,
# which a machine behind a Debian mirror can reach. Nothing of it is part of this repository.
set -euo pipefail

upstream=https://github.com/ThrowTheSwitch/Unity.git
upstream_commit=cbcd08fa7de711053a3deec6339ee89cad5d2697 # v2.6.1; git checks what it receives against this hash
debian_version=1.2.2+dfsg1                               # ntpsec, with Unity 2.5.1 in tests/unity
debian_sha256=53e527e3d04d551d41af2d359c2715c2de5f5bfa2a695d4ec1a811b3e9137f63

files=(unity.c unity.h unity_internals.h)
target=$1
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Moves the three files found in $1 into place, together; $2 says where they are from.
deliver() {
  mkdir -p "$scratch/ready/src"
  (cd "$1" && cp "${files[@]}" "$scratch/ready/src/")
  echo "$2" >"$scratch/ready/ORIGIN"
  rm -rf "$target"
  mkdir -p "$(dirname "$target")"
  mv "$scratch/ready" "$target"
  echo "Unity test framework: $2"
}

from_upstream() {
  local clone=$scratch/upstream
  git init -q "$clone" &&
    GIT_TERMINAL_PROMPT=0 timeout 30 git -C "$clone" -c http.lowSpeedLimit=1000 -c http.lowSpeedTime=10 \
      fetch -q --depth 1 "$upstream" "$upstream_commit" &&
    git -C "$clone" checkout -q --detach "$upstream_commit" &&
    [[ $(git -C "$clone" rev-parse HEAD) == "$upstream_commit" ]]
} >/dev/null 2>&1 </dev/null

# Prints a "deb-src" line for each Debian archive that this machine takes its binary packages from.
source_lines() {
  apt-get indextargets --format 'deb-src $(REPO_URI) $(RELEASE) $(COMPONENT)' \
    'Created-By: Packages' 'Origin: Debian' | sort -u | grep . && return
  # No package lists on this machine yet: the same from the configuration, in its two formats.
  sed -nE 's/^deb (\[[^]]*\] )?/deb-src /p' /etc/apt/sources.list /etc/apt/sources.list.d/*.list 2>/dev/null || true
  { cat /etc/apt/sources.list.d/*.sources 2>/dev/null || true; } | awk '
    function flush(  i) { for (i = 1; i <= n; i++) print "deb-src", uri, suite[i], component; n = 0 }
    /^URIs:/ { uri = $2 } /^Suites:/ { $1 = ""; n = split($0, suite) } /^Components:/ { $1 = ""; component = $0 }
    /^$/ { flush() } END { flush() }'
}

# Tries one archive after the other, with package lists of its own: the system's configuration stays as it is, and root
# is not needed.
from_debian() {
  local line tarball=ntpsec_$debian_version.orig.tar.xz
  while read -r line; do
    local work=$scratch/debian
    rm -rf "$work" && mkdir -p "$work"/{parts,lists/partial,cache/archives/partial} && cd "$work"
    echo "$line" >sources.list
    local apt=(apt-get -qq -o "Dir::Etc::SourceList=$work/sources.list" -o "Dir::Etc::SourceParts=$work/parts"
      -o "Dir::State::lists=$work/lists" -o "Dir::Cache=$work/cache" -o APT::Sandbox::User=)
    "${apt[@]}" update && "${apt[@]}" source --download-only ntpsec || continue
    echo "$debian_sha256  $tarball" | sha256sum --check || continue
    tar -xf "$tarball" --wildcards '*/tests/unity' && return
  done < <(source_lines)
  echo "ntpsec $debian_version is in none of these archives:" $(source_lines)
  return 1
} >"$scratch/log" 2>&1

if [[ -n ${UNITY_ROOT:-} ]]; then
  [[ -e $UNITY_ROOT/src/unity.c ]] || { echo "UNITY_ROOT=$UNITY_ROOT has no src/unity.c." >&2; exit 1; }
  deliver "$UNITY_ROOT/src" "UNITY_ROOT=$UNITY_ROOT"
elif (cd "$scratch" && cmake --find-package -DNAME=unity -DCOMPILER_ID=GNU -DLANGUAGE=C -DMODE=EXIST) &>/dev/null; then
  echo "Unity test framework: the installed CMake package" # CMakeLists.txt finds it as well
elif from_upstream; then
  deliver "$scratch/upstream/src" "upstream release 2.6.1, commit $upstream_commit"
elif (from_debian </dev/null); then
  deliver "$(dirname "$scratch"/debian/*/tests/unity/unity.c)" \
    "2.5.1, from Debian's source package ntpsec $debian_version"
else
  cat "$scratch/log" >&2
  echo "No Unity test framework: neither upstream nor Debian's source package ntpsec can be had (messages above)." >&2
  echo "Put a copy of Unity somewhere and give UNITY_ROOT=DIR, where DIR/src/unity.c is." >&2
  exit 1
fi
