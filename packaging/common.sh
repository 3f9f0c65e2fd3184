# Functions shared by the packaging scripts, which source this file.

say() { printf '\n== %s (%d s)\n' "$*" "$SECONDS" >&2; }

# Installs Debian packages unless a command exists: need COMMAND PACKAGE...
need() {
  local command=$1; shift
  command -v "$command" >/dev/null && return
  say "installing $*"
  if [ "$(id -u)" != 0 ]; then echo "error: installing $* needs root" >&2; exit 1; fi
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# Prints Rust's target triple of a platform; nothing for an unknown platform.
triple() {
  case $1 in
    musl) echo x86_64-unknown-linux-musl ;;
    arm64) echo aarch64-unknown-linux-gnu ;;
    windows) echo x86_64-pc-windows-gnu ;;
  esac
}

# Installs the compilers for a platform.
compilers() {
  case $1 in
    musl) need musl-gcc musl-tools ;;
    arm64)
      need aarch64-linux-gnu-gcc gcc-aarch64-linux-gnu libc6-dev-arm64-cross
      need qemu-aarch64 qemu-user
      export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc ;;
    windows) need x86_64-w64-mingw32-gcc gcc-mingw-w64-x86-64 ;;
  esac
  rustup target add "$(triple "$1")"
}
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)

# Fills a folder with the program, its two other names, manual pages and completions: stage FOLDER PROGRAM COMMAND...
# COMMAND runs the program.
stage() {
  local folder=$1 program=$2 shell; shift 2
  rm -rf "$folder"
  install -D -m 755 "$program" "$folder/bin/${program##*/}"
  if [[ $program != *.exe ]]; then ln -s spharm "$folder/bin/basis-build"; ln -s spharm "$folder/bin/fit"; fi
  mkdir -p "$folder/share/man/man1"
  (cd "$folder" && "$@" man share/man/man1)
  gzip -9n "$folder"/share/man/man1/*.1
  for shell in bash:bash-completion/completions/spharm zsh:zsh/site-functions/_spharm fish:fish/vendor_completions.d/spharm.fish; do
    mkdir -p "$folder/share/$(dirname "${shell#*:}")"
    "$@" completions "${shell%%:*}" > "$folder/share/${shell#*:}"
  done
  install -D -m 644 -t "$folder/share/doc/spharm" README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE
}
