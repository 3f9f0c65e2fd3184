#!/usr/bin/env bash
# Builds the Python package's wheels for other platforms in target/packages. `./run wheels [musl] [arm64] [windows]`
# calls it.
#
# zig compiles and links for any Linux with musl (musllinux_1_2) and for ARM64 with the glibc of 2018 (manylinux_2_28);
# MinGW for Windows. The ARM64 wheel is installed together with NumPy and fits a surface in Debian's Python, run by
# qemu. No Python for musl or Windows is available here, so for their wheels only the required libraries are checked.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/target/packages
python=$PWD/target/python/bin
. packaging/common.sh

wheel() {
  local platform=$1 zig=(--zig) compatible
  case $platform in
    musl) compatible=musllinux_1_2 ;;
    arm64) compatible=manylinux_2_28 ;;
    windows) zig=() compatible=off ;;
  esac
  compilers "$platform"
  say "$platform: wheel"
  # Otherwise the cross compiler's linker would be used in place of zig.
  unset CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER
  PATH="$python:$PATH" maturin build --release --target "$(triple "$platform")" "${zig[@]}" --compatibility "$compatible" \
    --no-default-features --compression-level 9 -o "$out"
}

# Prints the path of a platform's wheel.
path() {
  case $1 in
    musl) ls "$out"/spharm_rs-"$version"-*-musllinux_*_x86_64.whl ;;
    arm64) ls "$out"/spharm_rs-"$version"-*-manylinux_*_aarch64.whl ;;
    windows) ls "$out"/spharm_rs-"$version"-*-win_amd64.whl ;;
  esac
}

# Unpacks Debian 12's Python for ARM64, with the libraries that it needs, into a separate folder. The system's list of
# packages isn't touched.
python_for_arm64() {
  root=$PWD/target/platforms/python-arm64
  [ -x "$root/usr/bin/python3.11" ] && return
  local lists=$PWD/target/platforms/apt-arm64 options packages
  say "arm64: Debian's Python"
  mkdir -p "$root" "$lists"/{lists/partial,cache/archives/partial}
  : > "$lists/status"
  options=(-o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State="$lists" -o Dir::State::status="$lists/status"
    -o Dir::Cache="$lists/cache" -o APT::Sandbox::User=root)
  apt-get "${options[@]}" update -qq
  packages=(libc6 libgcc-s1 libstdc++6 libexpat1 zlib1g libssl3 libffi8 libbz2-1.0 liblzma5 libcrypt1 libuuid1 libsqlite3-0
    libpython3.11-minimal libpython3.11-stdlib python3.11-minimal python3.11)
  (cd "$lists" && apt-get "${options[@]}" download -qq "${packages[@]}" && for file in ./*.deb; do dpkg-deb -x "$file" "$root"; done)
}

try() {
  local file folder libraries
  file=$(path "$1")
  folder=$(mktemp -d)
  case $1 in
    arm64)
      python_for_arm64
      say "arm64: a fit in Debian's Python, by qemu"
      "$python/pip" install -q --target "$folder" --platform manylinux_2_28_aarch64 --platform manylinux2014_aarch64 \
        --only-binary=:all: --python-version 3.11 --implementation cp "$file" numpy
      (cd "$folder" && PYTHONPATH=$folder PYTHONHOME=$root/usr qemu-aarch64 -L "$root" "$root/usr/bin/python3.11" -c '
import platform, spharm_rs as sp
print(platform.machine(), sp.fit(sp.example_surface(3)[0], max_degree=8))') ;;
    musl)
      say "musl: needed libraries"
      "$python/python" -m zipfile -e "$file" "$folder"
      libraries=$(readelf -d "$folder"/spharm_rs/_core*.so | sed -n 's/.*NEEDED.*\[\(.*\)\]/\1/p')
      needed "$libraries" 'libc\.so|libgcc_s\.so\.1' ;;
    windows)
      say "windows: needed libraries"
      "$python/python" -m zipfile -e "$file" "$folder"
      libraries=$(x86_64-w64-mingw32-objdump -p "$folder"/spharm_rs/_core*.pyd | sed -n 's/.*DLL Name: //p')
      needed "$libraries" \
        'python3\.dll|KERNEL32\.dll|ntdll\.dll|msvcrt\.dll|USERENV\.dll|WS2_32\.dll|ADVAPI32\.dll|api-ms-win-.*|bcryptprimitives\.dll|bcrypt\.dll|POWRPROF\.dll|powrprof\.dll|pdh\.dll|PSAPI\.DLL|RPCRT4\.dll|SHELL32\.dll|ole32\.dll|OLEAUT32\.dll|NETAPI32\.dll|s[e]cur32\.dll|USER32\.dll|combase\.dll' ;;
  esac
  rm -r "$folder"
}

# Prints the libraries that a wheel needs. Fails if one of them isn't part of the system or of Python.
needed() {
  local others
  [ -n "$1" ] || { echo "error: the wheel's module names no library" >&2; exit 1; }
  tr '\n' ' ' <<<"$1"; echo
  others=$(grep -viEx "$2" <<<"$1" || true)
  [ -z "$others" ] || { echo "error: the wheel needs $others" >&2; exit 1; }
}

platforms=("$@")
[ ${#platforms[@]} = 0 ] && platforms=(musl arm64 windows)
for platform in "${platforms[@]}"; do
  [ -n "$(triple "$platform")" ] || { echo "error: $platform: expected musl, arm64 or windows" >&2; exit 2; }
done
mkdir -p "$out"
for platform in "${platforms[@]}"; do wheel "$platform"; done
for platform in "${platforms[@]}"; do try "$platform"; done
say "wheels"
for platform in "${platforms[@]}"; do stat -c '%s %n' "$(path "$platform")" | awk '{ sub(".*/", "", $2); printf "%6.1f MB  %s\n", $1 / 1e6, $2 }'; done
