#!/usr/bin/env python3
"""Checks that the recipes in packaging/recipes agree with the manifests: versions, licences, features and requirements."""

import pathlib
import re
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECIPES = ROOT / "packaging/recipes"

cargo = tomllib.loads((ROOT / "Cargo.toml").read_text())
python = tomllib.loads((ROOT / "pyproject.toml").read_text())
workspace = cargo["workspace"]["package"]
conda, brew, docker, apptainer = (
    (RECIPES / name).read_text() for name in ("conda/recipe.yaml", "homebrew/spharm.rb", "Dockerfile", "spharm.def")
)
problems = []


def expect(name: str, text: str, pattern: str, wanted: list[str]) -> None:
    """Records a problem unless the groups matched by the pattern are `wanted`, in this order."""
    found = re.findall(pattern, text, re.MULTILINE)
    if found != wanted:
        problems.append(f"{name}: expected {wanted} for {pattern!r}, found {found}")


version, licence = workspace["version"], workspace["license"]
expect("conda", conda, r'^  version: "(.*)"$', [version])
expect("conda", conda, r"^  license: (.*)$", [licence])
expect("conda", conda, r"- (maturin .*)$", [python["build-system"]["requires"][0].replace("maturin", "maturin ")])
expect("conda", conda, r"- python (>=.*)$", [python["project"]["requires-python"]])
expect("conda", conda, r"- (numpy .*)$", [python["project"]["dependencies"][0].replace("numpy", "numpy ")])
expect("conda", conda, r"^  summary: (.*)$", [python["project"]["description"]])
expect("homebrew", brew, r"spharm_rs-(.*)\.tar\.gz", [version])
expect("homebrew", brew, r'^  desc "(.*)"$', [python["project"]["description"]])
expect("homebrew", brew, r"license any_of: (.*)$", ["[" + ", ".join(f'"{one}"' for one in licence.split(" OR ")) + "]"])
expect("Dockerfile", docker, r"^FROM rust:(.*)-alpine", [workspace["rust-version"]])
for name, text in ("homebrew", brew), ("Dockerfile", docker):
    for feature in re.findall(r'--features[", ]+(\w+)', text):
        if feature not in cargo["features"]:
            problems.append(f"{name}: Cargo.toml has no feature {feature}")
for name, text in ("conda", conda), ("homebrew", brew), ("Dockerfile", docker):
    for file in re.findall(r"\b(LICENSE-\w+)", text):
        if not (ROOT / file).is_file():
            problems.append(f"{name}: there is no {file}")
expect("spharm.def", apptainer, r"^(%\w+)", ["%files", "%post", "%environment", "%runscript", "%test"])

print("\n".join(problems) or "recipes: versions, licences, features and requirements agree with the manifests")
sys.exit(bool(problems))
