#!/usr/bin/env bash
# Prepares a release: `./run release VERSION [--dry-run]`. Checks that VERSION is that of Cargo.toml, that it isn't
# tagged, that the changelog has a dated section for it, that the owner has filled in the repository's address, and that
# nothing is uncommitted. Then writes into target/packages, in addition to the packages made earlier: the notes, a list
# of all dependencies (CycloneDX), and the checksums of all files. Without --dry-run it also makes the tag, but uploads
# nothing: the commands for that are printed. With --dry-run, obstacles to the release are only listed, and the files
# are still written.
set -euo pipefail
cd "$(dirname "$0")/.."
. packaging/common.sh
out=$PWD/target/packages

cyclonedx_version=0.5.9
wanted='' dry=''
for argument; do
  case $argument in
    --dry-run) dry=1 ;;
    -*) echo "error: $argument: expected VERSION [--dry-run]" >&2; exit 2 ;;
    *) wanted=$argument ;;
  esac
done
[ -n "$wanted" ] || { echo "usage: ./run release VERSION [--dry-run]" >&2; exit 2; }

problems=()
notes=$(sed -n "/^## ${wanted//./\\.} /,/^## /p" CHANGELOG.md | sed '$!b; /^## /d')
# The section's summary, up to the first subsection.
summary=$(sed '1d; /^### /,$d' <<<"$notes")
[ "$wanted" = "$version" ] || problems+=("Cargo.toml has the version $version, not $wanted")
[ -n "$notes" ] || problems+=("CHANGELOG.md has no section \"## $wanted (date)\"")
if grep -q "^## ${wanted//./\\.} (not released" CHANGELOG.md; then problems+=("CHANGELOG.md has no date for $wanted"); fi
grep -q '^repository = ""' Cargo.toml && problems+=("Cargo.toml: the repository's address is missing")
git rev-parse -q --verify "refs/tags/v$wanted" >/dev/null && problems+=("the tag v$wanted exists")
[ -z "$(git status --porcelain)" ] || problems+=("there are uncommitted changes")
# Files that `./run package`, `./run platforms` and `./run wheels` must have made.
for file in "spharm_rs-$wanted.tar.gz" "spharm_rs-$wanted-*-manylinux_*_x86_64.whl" "spharm-$wanted-x86_64-linux.tar.gz" "spharm_$wanted-*.deb" \
  "spharm-$wanted-x86_64-linux-musl.tar.gz" "spharm-$wanted-aarch64-linux.tar.gz" "spharm-$wanted-x86_64-windows.zip" \
  "spharm_rs-$wanted-*-musllinux_*_x86_64.whl" "spharm_rs-$wanted-*-manylinux_*_aarch64.whl" "spharm_rs-$wanted-*-win_amd64.whl"; do
  compgen -G "$out/$file" >/dev/null || problems+=("target/packages has no $file")
done

if [ ${#problems[@]} -gt 0 ]; then
  printf 'missing: %s\n' "${problems[@]}" >&2
  [ -n "$dry" ] || exit 1
fi

mkdir -p "$out"
say "notes"
printf '%s\n' "$summary" | tee "$out/NOTES.md"
say "dependencies, as a CycloneDX document"
if [ "$(target/deny/bin/cargo-cyclonedx cyclonedx --version 2>/dev/null | cut -d' ' -f2)" != "$cyclonedx_version" ]; then
  cargo install -q cargo-cyclonedx --locked --version "$cyclonedx_version" --root target/deny --debug
fi
PATH="$PWD/target/deny/bin:$PATH" cargo cyclonedx -q --manifest-path Cargo.toml --format json --describe binaries --target all
mv spharm_bin.cdx.json "$out/spharm-$wanted.cdx.json"
# The tool writes one document beside the manifest of every crate.
git ls-files --others --exclude-standard -- '*.cdx.json' | xargs -r rm --
say "checksums"
(cd "$out" && find . -maxdepth 1 -type f -name "*$wanted*" -printf '%P\n' | sort | xargs sha256sum | tee SHA256SUMS)
say "packages for the registry of crates"
python3 .ci/publish.py

if [ -n "$dry" ]; then
  say "not done: git tag -a v$wanted"
else
  git tag -a "v$wanted" -F "$out/NOTES.md"
fi
cat <<END

What remains to be done by hand:
  git push origin v$wanted
  cargo publish --workspace
  pipx run twine upload target/packages/spharm_rs-$wanted*.whl target/packages/spharm_rs-$wanted.tar.gz
  the files that target/packages/SHA256SUMS lists, and SHA256SUMS, where the repository keeps its releases
  the version and checksum in packaging/recipes
END
