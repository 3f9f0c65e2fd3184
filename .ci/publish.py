#!/usr/bin/env python3
"""Lists the published crates in the order of their dependencies, and makes their packages; uses Python's standard
library only.

- Published crates are `spharm`, `spharm-cohort` and the crates on which they depend.
- Each crate has the metadata that the registry requires, at most five keywords, and the common version. Dependencies on
  other published crates state that version, too.
- `cargo package` makes each package without building it, from cargo's local cache or else from the registry. No package
  exceeds the registry's size limit.

`cargo publish --workspace` publishes the packages, once Cargo.toml has the address of the repository.
"""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PUBLIC = ["spharm", "spharm-cohort"]
MOST_KEYWORDS = 5
MOST_BYTES = 10 << 20
#: The registry's categories that suit these crates; the registry refuses an unknown category at upload.
CATEGORIES = {"algorithms", "encoding", "external-ffi-bindings", "filesystem", "graphics", "mathematics", "science"}


def metadata():
    command = ["cargo", "metadata", "--no-deps", "--format-version", "1"]
    return json.loads(subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout)


def needed(packages):
    """Maps each crate to the crates of this repository needed to build it. Development dependencies are left out: cargo
    drops those without a version."""
    def is_needed(entry):
        return entry["name"] in packages and entry.get("path") and entry["kind"] != "dev"

    return {name: {entry["name"] for entry in package["dependencies"] if is_needed(entry)} for name, package in packages.items()}


def in_order(names, edges):
    """Sorts crates so that each comes after the crates that it needs; otherwise by name."""
    done = []
    while left := sorted(set(names) - set(done)):
        ready = [name for name in left if edges[name] & set(names) <= set(done)]
        if not ready:
            sys.exit(f"error: circular dependency among {', '.join(left)}")
        done.append(ready[0])
    return done


def all_of(names, edges):
    found, left = set(), list(names)
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left.extend(edges[name])
    return found


def faults(packages, edges):
    published = {name for name, package in packages.items() if package["publish"] != []}
    wanted = all_of(PUBLIC, edges)
    for name in sorted(published ^ wanted):
        yield f"{name}: " + ("isn't published, but needed by a public crate" if name in wanted else "published, but not needed")
    version = packages[PUBLIC[0]]["version"]
    for name in sorted(published):
        package = packages[name]
        for field in ("description", "license", "readme", "documentation", "keywords", "categories"):
            if not package[field]:
                yield f"{name}: Cargo.toml has no {field}"
        if len(package["keywords"]) > MOST_KEYWORDS or any(len(word) > 20 for word in package["keywords"]):
            yield f"{name}: more than {MOST_KEYWORDS} keywords, or one of more than 20 letters"
        if unknown := set(package["categories"]) - CATEGORIES:
            yield f"{name}: unknown category {', '.join(sorted(unknown))}; expected categories listed in .ci/publish.py"
        if package["version"] != version:
            yield f"{name}: version {package['version']}, expected {version}, as of {PUBLIC[0]}"
        for entry in package["dependencies"]:
            wanted_version = "*" if entry["name"] not in published else f"={version}"
            if entry["name"] in packages and entry["req"] != wanted_version:
                yield f"{name}: depends on {entry['name']} {entry['req']}, expected {wanted_version}"


def package(names, version, target):
    """Makes the packages, offline if cargo's local cache suffices."""
    command = ["cargo", "package", "--quiet", "--no-verify", "--allow-dirty", *(word for name in names for word in ("-p", name))]
    made = subprocess.run([*command, "--offline"], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    if made.returncode != 0:
        made = subprocess.run(command, cwd=ROOT)
    else:
        sys.stderr.write(made.stderr)
    if made.returncode != 0:
        sys.exit("error: cargo package failed")
    return {name: (target / "package" / f"{name}-{version}.crate").stat().st_size for name in names}


def main():
    found = metadata()
    packages = {package["name"]: package for package in found["packages"]}
    edges = needed(packages)
    if wrong := list(faults(packages, edges)):
        sys.exit("\n".join(wrong))
    names = in_order(all_of(PUBLIC, edges), edges)
    sizes = package(names, packages[PUBLIC[0]]["version"], Path(found["target_directory"]))
    for name in names:
        print(f"{name:20} {sizes[name] / 1024:6.0f} KiB")
    if large := [name for name in names if sizes[name] > MOST_BYTES]:
        sys.exit(f"error: packages larger than {MOST_BYTES >> 20} MiB: {', '.join(large)}")
    if not packages[PUBLIC[0]]["repository"]:
        print("note: Cargo.toml has no address of the repository yet, which publishing needs", file=sys.stderr)


if __name__ == "__main__":
    main()
