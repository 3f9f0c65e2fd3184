#!/usr/bin/env bash
# Makes the packages of a release in target/packages, and tries each where there is no compiler. `./run package` calls it.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/target/packages
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
name=spharm-$version-$(uname -m)-linux

say() { printf '\n== %s\n' "$*" >&2; }

# Wheel and source distribution. zig links against the glibc of 2018, so that the wheel installs nearly everywhere.
wheel() {
  say "wheel and source distribution"
  rm -rf "$out"/*.whl "$out"/spharm_rs-*.tar.gz
  PATH="$PWD/target/python/bin:$PATH" maturin build --release --zig --compatibility manylinux_2_28 --compression-level 9 \
    -o "$out"
  target/python/bin/maturin sdist -o "$out"
}

# One folder: program, its two other names, manual pages, completions.
stage() {
  local folder=$1
  rm -rf "$folder"
  install -D -m 755 target/release/spharm "$folder/bin/spharm"
  ln -s spharm "$folder/bin/basis-build"; ln -s spharm "$folder/bin/fit"
  mkdir -p "$folder/share/man/man1"
  "$folder/bin/spharm" man "$folder/share/man/man1"
  gzip -9n "$folder"/share/man/man1/*.1
  for shell in bash:bash-completion/completions/spharm zsh:zsh/site-functions/_spharm fish:fish/vendor_completions.d/spharm.fish; do
    mkdir -p "$folder/share/$(dirname "${shell#*:}")"
    "$folder/bin/spharm" completions "${shell%%:*}" > "$folder/share/${shell#*:}"
  done
  install -D -m 644 -t "$folder/share/doc/spharm" README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE
}

tarball() {
  say "tarball"
  stage "target/stage/$name"
  tar -C target/stage --owner=0 --group=0 -czf "$out/$name.tar.gz" "$name"
}

# The Debian package leaves out the names `fit` and `basis-build`, which are too common for a system's folder.
debian() {
  say "Debian package"
  if [ "$(target/deny/bin/cargo-deb --version 2>/dev/null)" != "$deb_version" ]; then
    cargo install -q cargo-deb --locked --version "$deb_version" --root target/deny --debug
  fi
  stage target/stage/deb
  target/deny/bin/cargo-deb -p spharm-tools --no-build --no-strip -o "$out/"
}
deb_version=3.8.0

# Fits an example with what is installed in $1, a command that runs programs there.
try() {
  local run=("$@") folder
  folder=$(mktemp -d)
  "${run[@]}" spharm generate --subdivisions 4 --surface "$folder/s.ply" --sphere "$folder/sphere.ply" -q
  "${run[@]}" spharm fit --surface "$folder/s.ply" --max-degree 10 -o "$folder/s.spharm.npz" -q
  "${run[@]}" spharm reconstruct --model "$folder/s.spharm.npz" -o "$folder/r.ply" -q
  [ -s "$folder/r.ply" ]
  rm -r "$folder"
}

# Each package where there is no compiler: `env -i` with a folder of programs that has none.
try_all() {
  local venv=target/stage/venv bare=target/stage/bare
  say "the wheel, in a new environment"
  rm -rf "$venv"; python3 -m venv "$venv"
  "$venv/bin/pip" install -q "$out"/*.whl auditwheel pyelftools
  "$venv/bin/auditwheel" show "$out"/*.whl | grep -m1 -o 'manylinux_[0-9_]*_[a-z0-9_]*'
  exported=$(nm -D --defined-only "$venv"/lib/python*/site-packages/spharm_rs/_core*.so | awk '{print $NF}')
  [ "$exported" = PyInit__core ] || { echo "error: the module exports $exported" >&2; exit 1; }
  try env -i PATH="$PWD/$venv/bin"
  env -i "$venv/bin/python" -c 'import spharm_rs as sp; print(sp.fit(sp.example_surface(4)[0], max_degree=10))'
  say "the tarball"
  rm -rf "$bare"; mkdir -p "$bare"; tar -C "$bare" -xzf "$out/$name.tar.gz"
  try env -i PATH="$PWD/$bare/$name/bin"
  say "the Debian package"
  dpkg-deb --info "$out"/*.deb | grep -E '^ (Package|Version|Depends|Installed-Size)'
  rm -rf "$bare/deb"; dpkg-deb -x "$out"/*.deb "$bare/deb"
  try env -i PATH="$PWD/$bare/deb/usr/bin"
  say "libraries that the program needs"
  ldd "$bare/deb/usr/bin/spharm" | awk '{print $1}' | tr '\n' ' '; echo
}

mkdir -p "$out"
wheel; tarball; debian; try_all
say "packages"; (cd "$out" && sha256sum ./*.whl ./*.tar.gz ./*.deb | tee SHA256SUMS && ls -l)
