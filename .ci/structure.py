#!/usr/bin/env python3
"""Checks the rules of CONTRIBUTING.md that no compiler checks; Python's standard library only.

- Source files have at most 400 lines, and lines of comments at most 120 columns. Tables, links and code in comments may
  be wider.
- Crates depend on each other as the table of CONTRIBUTING.md states, and only on crates above them in that table.
- Files of a crate don't import each other in circles. Test modules, re-exports and imports from a `lib.rs` are ignored.
- No comment, message or page contains a phrase of .ci/phrases.toml.
- fuzz/Cargo.lock has the dependencies in our crates' manifests; otherwise the fuzz targets can't be built with
  `--locked`.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ["crates", "tools", "tests", "benches", "examples", "fuzz/src"]
MOST_LINES = 400
MOST_COLUMNS = 120


def lengths():
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.rs")):
            lines = len(path.read_text().splitlines())
            if lines > MOST_LINES:
                yield f"{path.relative_to(ROOT)}: {lines} lines, at most {MOST_LINES} are allowed"


def widths():
    """Checks the widths of comments, because rustfmt wraps only code."""
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.rs")):
            fenced = False
            for number, line in enumerate(path.read_text().splitlines(), 1):
                comment = re.match(r"\s*//[/!]? ?(.*)", line)
                if not comment:
                    fenced = False
                    continue
                text = comment[1]
                fenced ^= text.startswith("```")
                if len(line) > MOST_COLUMNS and not fenced and not text.startswith(("|", "<", "[")):
                    yield f"{path.relative_to(ROOT)}:{number}: a comment of {len(line)} columns, at most {MOST_COLUMNS} are allowed"


def dependencies():
    """Compares the table with the manifests. Development dependencies are ignored."""
    table = {}
    for line in (ROOT / "CONTRIBUTING.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if match := re.fullmatch(r"`([a-z]+)`", cells[1] if len(cells) == 5 else ""):
            table[match[1]] = set(re.findall(r"`([a-z]+)`", cells[3]))
    manifests = {path.parent.name: path.read_text() for path in ROOT.glob("crates/*/Cargo.toml")}
    # The program's package is that of the workspace.
    manifests["tools"] = (ROOT / "Cargo.toml").read_text()
    names = {re.search(r'^name = "(.*)"', text, re.M)[1]: folder for folder, text in manifests.items()}
    for folder in table.keys() - manifests.keys():
        yield f"CONTRIBUTING.md: there is no crates/{folder}"
    for folder, text in sorted(manifests.items()):
        manifest = tomllib.loads(text)
        tables = [manifest, *manifest.get("target", {}).values()]
        entries = {name for entries in tables for name in entries.get("dependencies", {})}
        found = {names[name] for name in entries if name in names}
        if folder not in table:
            yield f"CONTRIBUTING.md: crates/{folder} is missing from the table"
        elif found != table[folder]:
            yield f"CONTRIBUTING.md: crates/{folder} depends on {sorted(found)}, the table has {sorted(table[folder])}"
        else:
            above = list(table)[: list(table).index(folder)]
            for name in sorted(found - set(above)):
                yield f"crates/{folder}: depends on {name}, which is below it in the table"


def modules(source):
    """Returns the files of a crate, by the path of their module as a tuple of names."""
    found = {}
    for path in source.rglob("*.rs"):
        names = path.relative_to(source).with_suffix("").parts
        found[names[:-1] if names[-1] in ("mod", "lib", "spharm") else names] = path
    return found


def used(tree):
    """Returns the paths in a use tree, `a::{b, c::d}`, without `as` and its names."""
    tree = tree.strip()
    if not (match := re.match(r"(.*?)\{(.*)\}$", tree, re.S)):
        return [tree.split(" as ")[0].strip()]
    branches, depth = [""], 0
    for character in match[2]:
        depth += (character == "{") - (character == "}")
        if character == "," and depth == 0:
            branches.append("")
        else:
            branches[-1] += character
    return [match[1] + path for branch in branches if branch.strip() for path in used(branch)]


def imports(module, path, files):
    """Yields the modules of the same crate from which a file imports."""
    text = re.sub(r"//.*", "", path.read_text().split("#[cfg(test)]\nmod tests {")[0])
    text = re.sub(r"^pub(\([a-z]+\))? use [^;]+;", "", text, flags=re.M)
    uses = [used(tree) for tree in re.findall(r"^use ([^;]+);", text, re.M)]
    names = [name for tree in uses for name in tree] + re.findall(r"\bcrate(?:::\w+)+", text)
    for name in names:
        parts = name.split("::")
        if parts[0] == "crate":
            target = parts[1:]
        elif parts[0] in ("super", "self"):
            ups = sum(part == "super" for part in parts)
            target = [*module[: len(module) - ups], *(part for part in parts if part not in ("super", "self"))]
        elif (*module, parts[0]) in files:
            target = [*module, *parts]
        else:
            continue
        while tuple(target) not in files:
            target.pop()
        # Imports from the crate's root are skipped: re-exports can't be distinguished from definitions, and the root
        # should define nothing.
        if target and tuple(target) != module:
            yield tuple(target)


def reached(start, edges):
    """Returns all modules that a module imports, directly or indirectly."""
    found, next_ones = set(), list(edges[start])
    while next_ones:
        module = next_ones.pop()
        if module not in found:
            found.add(module)
            next_ones.extend(edges[module])
    return found


def circles():
    for source in [*sorted(ROOT.glob("crates/*/src")), ROOT / "tools"]:
        files = modules(source)
        edges = {module: set(imports(module, path, files)) for module, path in files.items()}
        reach = {module: reached(module, edges) for module in edges}
        for module in sorted(edges):
            if module in reach[module]:
                next_ones = sorted(target for target in edges[module] if module in reach[target])
                names = ", ".join("::".join(target) for target in next_ones)
                yield f"{files[module].relative_to(ROOT)}: imports {names}, which imports it, directly or indirectly"


def fuzz_lock():
    """Checks the lock file of the fuzz targets: they are a separate workspace, so `cargo build` doesn't update it."""
    for package in tomllib.loads((ROOT / "fuzz/Cargo.lock").read_text())["package"]:
        manifest = ROOT / "crates" / package["name"].removeprefix("spharm-") / "Cargo.toml"
        if "source" in package or not manifest.is_file():
            continue
        # An entry is "name", or "name version" if several versions are locked.
        locked = {entry.split()[0] for entry in package.get("dependencies", [])}
        text = tomllib.loads(manifest.read_text())
        sections = [table.get(kind, {}) for table in [text, *text.get("target", {}).values()]
                    for kind in ("dependencies", "build-dependencies")]
        entries = {name: entry for section in sections for name, entry in section.items()}
        needed = {name for name, entry in entries.items() if not (isinstance(entry, dict) and entry.get("optional"))}
        if not needed <= locked <= entries.keys():
            names = ", ".join(sorted(needed - locked | locked - entries.keys()))
            yield f"fuzz/Cargo.lock: {package['name']} differs in {names}; run cargo metadata --manifest-path fuzz/Cargo.toml"


def phrases():
    """Searches comments, messages and pages for the phrases of .ci/phrases.toml."""
    listed = tomllib.loads((ROOT / ".ci/phrases.toml").read_text())["phrases"]
    listed = [(re.compile(phrase, re.IGNORECASE), better) for phrase, better in listed.items()]
    files = [file for source in SOURCES for file in sorted((ROOT / source).rglob("*")) if file.suffix in (".rs", ".py")]
    files += [*sorted((ROOT / "python").rglob("*.py")), *sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("*.md"))]
    for file in files:
        for number, line in enumerate(file.read_text().splitlines(), 1):
            for phrase, better in listed:
                if found := phrase.search(line):
                    yield f"{file.relative_to(ROOT)}:{number}: {found.group()!r}: write {better}"


if __name__ == "__main__":
    faults = [*lengths(), *widths(), *dependencies(), *circles(), *fuzz_lock(), *phrases()]
    print(*faults, sep="\n")
    sys.exit(bool(faults))
