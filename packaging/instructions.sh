#!/usr/bin/env bash
# Counts the instructions of transforms on ARM64, run by QEMU, and those of the same code without vector instructions.
# `./run bench instructions` calls it. Only instructions of this package are counted, not the Fourier transforms by
# rustfft, which has vector instructions of its own.
set -euo pipefail
cd "$(dirname "$0")/.."
. packaging/common.sh
out=$PWD/target/instructions

compilers arm64
target=$(triple arm64)
# The plugin finds functions by their symbols.
export CARGO_PROFILE_RELEASE_STRIP=false
build() { cargo build -q --release --target "$target" -p spharm-transform --example instructions --target-dir "$out/$1"; }
say "the transforms with and without vector instructions"
build vector
RUSTFLAGS="-C no-vectorize-loops -C no-vectorize-slp" build plain
cc -shared -fPIC -O2 -o "$out/count.so" packaging/count_instructions.c

# Prints the instructions of one call of a kernel, in millions: those of a run with two calls minus those of a run with
# one.
count() {
  local program=$out/$1/$target/release/examples/instructions once twice
  run() { RAYON_NUM_THREADS=1 qemu-aarch64 -L /usr/aarch64-linux-gnu -plugin "$out/count.so,only=spharm_transform" "$program" "$@" 2>&1 >/dev/null; }
  once=$(run "$2" 1); twice=$(run "$2" 2)
  if [[ ! $once$twice =~ ^[0-9]+$ ]] || [ "$twice" -le "$once" ]; then echo "error: $program: $once $twice" >&2; exit 1; fi
  echo $(((twice - once) / 1000000))
}

say "millions of instructions"
printf '%-12s%8s%8s%8s\n' kernel vector plain ratio
for kernel in synthesis adjoint legendre; do
  vector=$(count vector "$kernel") || exit; plain=$(count plain "$kernel") || exit
  awk -v k="$kernel" -v a="$vector" -v b="$plain" 'BEGIN { printf "%-12s%8d%8d%8.2f\n", k, a, b, a / b }'
done
