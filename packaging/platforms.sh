#!/usr/bin/env bash
# Builds the program for other platforms, and runs the README's commands there: the musl program directly, the ARM
# program by qemu's user emulation, the Windows program by Wine. `./run platforms [musl] [arm64] [windows] [macos]`
# calls it. For macOS, whose libraries aren't available here, the compiler only checks the program.
#
# Checks that coefficients differ from those of the musl program by rounding only, and that each platform can read the
# stores and models of musl, and the reverse. Also runs the unit tests of the crates that call the system or choose
# kernels by the processor, and packs the programs into target/packages.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/target/platforms

. packaging/common.sh

# Prints the path of the program for a platform.
binary() {
  local suffix=
  [ "$1" != windows ] || suffix=.exe
  echo "target/$(triple "$1")/release/spharm$suffix"
}

# Compiles the program for macOS without linking it; zig compiles the parts in C.
check_macos() {
  say "macos: checking"
  target/venv/bin/pip install -q ziglang cargo-zigbuild
  rustup target add aarch64-apple-darwin
  PATH="$PWD/target/venv/bin:$PATH" cargo-zigbuild check --target aarch64-apple-darwin --bin spharm --no-default-features \
    --features tables
}

build() {
  compilers "$1"
  if [ "$1" = windows ]; then need wine wine wine64; random_numbers_for_wine; fi
  say "$1: building"
  # For Windows (MinGW), rustc writes all functions of a compilation unit into one section, so the linker can't drop
  # unused functions. Thin LTO drops them, and compiles everything at the level of the last crate.
  local settings=()
  [ "$1" != windows ] || settings=(--config 'profile.release.lto="thin"' --config 'profile.release.package.spharm-tools.opt-level=3')
  cargo build --release --target "$(triple "$1")" --bin spharm --no-default-features --features tables "${settings[@]}"
}

# Makes a bcryptprimitives.dll for Wine before 8.10, which lacks it. Rust's standard library takes random numbers from
# this library, which Windows has had since version 7. The replacement calls a function that older versions of Wine
# have.
random_numbers_for_wine() {
  mkdir -p "$out/wine-libraries"
  x86_64-w64-mingw32-gcc -shared -O2 -o "$out/wine-libraries/bcryptprimitives.dll" -x c - -ladvapi32 <<'END'
__declspec(dllimport) unsigned char __stdcall SystemFunction036(void *bytes, unsigned long count);
__declspec(dllexport) int __stdcall ProcessPrng(unsigned char *bytes, unsigned long long count) {
    while (count > 0) {
        unsigned long some = count < 65536 ? (unsigned long)count : 65536;
        if (!SystemFunction036(bytes, some)) return 0;
        bytes += some;
        count -= some;
    }
    return 1;
}
END
}

# Runs the program of a platform, in the current folder, with Wine too.
on() {
  local platform=$1 program; shift
  program=$PWD_OF_REPOSITORY/$(binary "$platform")
  case $platform in
    musl) "$program" "$@" ;;
    arm64) qemu-aarch64 -L /usr/aarch64-linux-gnu "$program" "$@" ;;
    windows) wine "$program" "$@" ;;
  esac
}
PWD_OF_REPOSITORY=$PWD

# Runs the README's commands in a folder of the platform.
commands() {
  local platform=$1 folder=$out/$1
  rm -rf "$folder"; mkdir -p "$folder/Größe µ"; cd "$folder"
  say "$platform: the README's commands"
  on "$platform" --version
  on "$platform" generate --subdivisions 4 --surface cortex.surf.gii --sphere sphere.surf.gii -q
  on "$platform" basis-build --sphere sphere.surf.gii --max-degree 20 --store store -q
  on "$platform" fit --store store --sphere sphere.surf.gii --max-degree 20 --passes 2 --granularity 1 \
    --surface cortex.surf.gii -o irf.spharm.npz -q
  on "$platform" fit --sphere sphere.surf.gii --max-degree 20 --surface cortex.surf.gii -o lsq.spharm.npz -q
  on "$platform" fit --surface cortex.surf.gii --max-degree 20 -o "Größe µ/bare.spharm.npz" -q
  on "$platform" reconstruct --model "Größe µ/bare.spharm.npz" -o bare.ply --double -q
  on "$platform" compare cortex.surf.gii bare.ply -o error.ply
  on "$platform" picture cortex.surf.gii bare.ply -o picture.png -q
  on "$platform" store verify store
  cd "$PWD_OF_REPOSITORY"
}

# Runs the static program in a system that has nothing else: no C library, no /proc, no /tmp.
in_an_empty_system() {
  local root=$out/empty
  if [ "$(id -u)" != 0 ]; then echo "musl: not tried in an empty system, which needs root" >&2; return; fi
  say "musl: a fit in an empty system"
  rm -rf "$root"; mkdir -p "$root/data"; cp "$(binary musl)" "$root/spharm"
  chroot "$root" /spharm generate --subdivisions 4 --surface /data/s.ply -q
  chroot "$root" /spharm fit --surface /data/s.ply --max-degree 10 -o /data/s.spharm.npz
  chroot "$root" /spharm reconstruct --model /data/s.spharm.npz -o /data/r.ply
}

# Reads the store and the model of one platform on another.
across() {
  local writer=$1 reader=$2
  say "the store and the models of $writer on $reader"
  cd "$out/$writer"
  on "$reader" store verify store -q
  on "$reader" reconstruct --model irf.spharm.npz -o "read-by-$reader.ply" -q --force
  on "$reader" fit --store store --sphere sphere.surf.gii --max-degree 20 --passes 2 --granularity 1 \
    --surface cortex.surf.gii -o "fit-by-$reader.spharm.npz" -q --force
  cd "$PWD_OF_REPOSITORY"
}

# Runs the unit tests of the crates that call the system or choose kernels by the processor.
unit_tests() {
  local crates=(-p spharm-files -p spharm-store -p spharm-harmonics -p spharm-transform)
  case $1 in
    musl) return ;;
    arm64) export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu" ;;
    windows) export CARGO_TARGET_X86_64_PC_WINDOWS_GNU_RUNNER=wine ;;
  esac
  say "$1: unit tests"
  # Property tests run fewer cases under qemu, because they take twenty times as long there.
  local cases=256
  [ "$1" != arm64 ] || cases=8
  PROPTEST_CASES=$cases cargo test -q --lib "${crates[@]}" --target "$(triple "$1")"
}

# Packs a release archive with the program, manual pages, completions and documents, in target/packages.
pack() {
  local platform=$1 name
  case $platform in
    musl) name=spharm-$version-x86_64-linux-musl ;;
    arm64) name=spharm-$version-aarch64-linux ;;
    windows) name=spharm-$version-x86_64-windows ;;
  esac
  say "$platform: $name"
  mkdir -p "$out/pack" target/packages
  stage "$out/pack/$name" "$(binary "$platform")" on "$platform"
  if [ "$platform" = windows ]; then
    (cd "$out/pack" && "$PWD_OF_REPOSITORY/target/venv/bin/python" -m zipfile -c "$PWD_OF_REPOSITORY/target/packages/$name.zip" "$name")
  else
    tar -C "$out/pack" --owner=0 --group=0 -czf "target/packages/$name.tar.gz" "$name"
  fi
}

# Prints the largest difference of the models' coefficients, relative to the largest coefficient. Fails above 1e-12, or
# above 1e-6 for the bare mesh, because rounding changes where the iterations of its map to the sphere end.
differences() {
  "$PWD_OF_REPOSITORY/target/venv/bin/python" - "$out" "$@" <<'END'
import sys, pathlib, numpy as np
out, failed = pathlib.Path(sys.argv[1]), False
print(f"{'platform':<10}{'model':<24}{'difference from musl':>22}  same bytes")
for platform in sys.argv[2:]:
    names = [("irf", 1e-12), ("lsq", 1e-12), ("Größe µ/bare", 1e-6)]
    # The fit over this platform's store by the musl program.
    for name, most in names + [("fit-by-musl", 1e-12)] * (platform != "musl"):
        ours = "irf" if name == "fit-by-musl" else name
        files = [out / "musl" / f"{ours}.spharm.npz", out / platform / f"{name}.spharm.npz"]
        here, there = (np.load(f)["coefficients"] for f in files)
        off = abs(here - there).max() / abs(here).max()
        failed |= not off <= most
        print(f"{platform:<10}{name:<24}{off:>22.1e}  {'yes' if np.array_equal(here, there) else 'no'}")
sys.exit(failed)
END
}

platforms=("$@")
[ ${#platforms[@]} = 0 ] && platforms=(musl arm64 windows macos)
if [[ " ${platforms[*]} " == *" macos "* ]]; then
  check_macos
  others=()
  for platform in "${platforms[@]}"; do [ "$platform" = macos ] || others+=("$platform"); done
  [ ${#others[@]} = 0 ] && exit
  platforms=("${others[@]}")
fi
for platform in "${platforms[@]}"; do
  [ -n "$(triple "$platform")" ] || { echo "error: $platform: expected musl, arm64, windows or macos" >&2; exit 2; }
done
target/venv/bin/python -c 'import numpy' || { echo "error: target/venv has no NumPy; run it as ./run platforms" >&2; exit 1; }
[[ " ${platforms[*]} " == *" musl "* ]] || platforms=(musl "${platforms[@]}")
mkdir -p "$out"
export WINEDEBUG=-all WINEPREFIX=$out/wine
libraries=$out/wine-libraries
export WINEPATH="Z:${libraries//\//\\}"
for platform in "${platforms[@]}"; do build "$platform"; done
for platform in "${platforms[@]}"; do commands "$platform"; done
in_an_empty_system
for platform in "${platforms[@]}"; do unit_tests "$platform"; done
for platform in "${platforms[@]}"; do
  [ "$platform" = musl ] || { across musl "$platform"; across "$platform" musl; }
done
say "models"
differences "${platforms[@]}"
say "programs"
for platform in "${platforms[@]}"; do pack "$platform"; done
for platform in "${platforms[@]}"; do stat -c '%s %n' "$(binary "$platform")" | awk -v p="$platform" '{ printf "%-10s%6.1f MB\n", p, $1 / 1e6 }'; done
