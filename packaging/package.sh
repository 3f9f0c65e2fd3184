#!/usr/bin/env bash
# Makes the packages of a release in target/packages, and tries each in an environment without a compiler. `./run
# package` calls it.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/target/packages
. packaging/common.sh
name=spharm-$version-$(uname -m)-linux

# Makes the wheel and the source distribution. zig links against the glibc of 2018, so that the wheel installs nearly
# everywhere.
wheel() {
  say "wheel and source distribution"
  rm -rf "$out"/*.whl "$out"/spharm_rs-*.tar.gz
  PATH="$PWD/target/python/bin:$PATH" maturin build --release --zig --compatibility manylinux_2_28 --compression-level 9 \
    -o "$out"
  target/python/bin/maturin sdist -o "$out"
}

tarball() {
  say "tarball"
  stage "target/stage/$name" target/release/spharm "$PWD/target/release/spharm"
  tar -C target/stage --owner=0 --group=0 -czf "$out/$name.tar.gz" "$name"
}

# Makes the Debian package, without the names `fit` and `basis-build`, which are too common for /usr/bin.
debian() {
  say "Debian package"
  if [ "$(target/deny/bin/cargo-deb --version 2>/dev/null)" != "$deb_version" ]; then
    cargo install -q cargo-deb --locked --version "$deb_version" --root target/deny --debug
  fi
  stage target/stage/deb target/release/spharm "$PWD/target/release/spharm"
  target/deny/bin/cargo-deb -p spharm-tools --no-build --no-strip -o "$out/"
}
deb_version=3.8.0

# Fits an example with an installed program. The arguments are a command prefix that runs a command in the program's
# system or environment.
try() {
  "$@" sh -euc 'cd "$(mktemp -d)"; spharm generate --subdivisions 4 --surface s.ply -q
    spharm fit --surface s.ply --max-degree 10 -o s.spharm.npz; spharm reconstruct --model s.spharm.npz -o r.ply; test -s r.ply'
}

# Tries the program in a minimal Debian system or, if such a system can't be made, with an empty environment.
try_program() {
  local system=target/stage/system bare=target/stage/bare
  if [ "$(id -u)" = 0 ] && command -v debootstrap >/dev/null; then
    [ -f "$system/etc/debian_version" ] || debootstrap --variant=minbase bookworm "$system" >target/stage/debootstrap.log
    say "the tarball, in a Debian without a compiler"
    rm -rf "$system/opt"; mkdir "$system/opt"; tar -C "$system/opt" -xzf "$out/$name.tar.gz"
    try chroot "$system" env -i PATH="/opt/$name/bin:/usr/bin:/bin"
    say "the Debian package, there"
    cp "$out"/*.deb "$system/opt/"
    chroot "$system" sh -c 'dpkg -i /opt/*.deb && dpkg -s spharm | grep -E "^(Version|Depends|Installed-Size)"'
    try chroot "$system" env -i PATH=/usr/bin:/bin
  else
    say "the tarball and the Debian package (debootstrap and root would try them in a system of their own)"
    rm -rf "$bare"; mkdir -p "$bare"; tar -C "$bare" -xzf "$out/$name.tar.gz"
    try env -i PATH="$PWD/$bare/$name/bin:/usr/bin:/bin"
    dpkg-deb -x "$out"/*.deb "$bare/deb"
    try env -i PATH="$PWD/$bare/deb/usr/bin:/usr/bin:/bin"
  fi
}

# Checks the wheel's platform and exported symbols, and tries a fit with it in a new environment; then tries a fit with
# the source distribution.
try_python() {
  local venv=target/stage/venv exported
  say "the wheel, in a new environment"
  rm -rf "$venv"; python3 -m venv "$venv"; "$venv/bin/pip" install -q "$out"/*.whl auditwheel
  "$venv/bin/auditwheel" show "$out"/*.whl | grep -m1 -o 'manylinux_[0-9_]*_[a-z0-9_]*'
  exported=$(nm -D --defined-only "$venv"/lib/python*/site-packages/spharm_rs/_core*.so | awk '{print $NF}')
  [ "$exported" = PyInit__core ] || { echo "error: the module exports $exported" >&2; exit 1; }
  env -i "$venv/bin/python" -c 'import spharm_rs as sp; print(sp.fit(sp.example_surface(4)[0], max_degree=10))'
  try env -i PATH="$PWD/$venv/bin:/usr/bin:/bin"
  say "the source distribution, in a new environment and without this checkout"
  rm -rf "$venv"; python3 -m venv "$venv"; "$venv/bin/pip" install -q "$out"/spharm_rs-*.tar.gz
  env -i "$venv/bin/python" -c 'import spharm_rs as sp; print(sp.fit(sp.example_surface(4)[0], max_degree=10))'
}

mkdir -p "$out"
wheel; tarball; debian; try_program; try_python
say "packages"; (cd "$out" && sha256sum ./*.whl ./*.tar.gz ./*.deb | tee SHA256SUMS && ls -l)
