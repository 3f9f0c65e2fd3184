"""The documentation's snippets and commands run, and its reference is complete."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

import spharm_rs as sp

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("algorithms/*.md"), *DOCS.glob("reference/*.md")])
EXAMPLES = sorted((ROOT / "examples" / "python").glob("[0-9]_*.py"))


def blocks(path: Path, language: str) -> list[str]:
    """Returns the fenced blocks of a page, or the code blocks in an example's text, which don't run while the site is
    built."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)
    found = re.findall(rf"^# \.\. code-block:: {language}\n#\n((?:#    .*\n)+)", text, re.M)
    return [re.sub(r"^#    ", "", block, flags=re.M) for block in found]


def of(language: str) -> pytest.MarkDecorator:
    pages = [page for page in [*PAGES, *EXAMPLES] if blocks(page, language)]
    return pytest.mark.parametrize("page", pages, ids=lambda page: str(page.relative_to(ROOT)))


def write_nifti(path: Path, labels: np.ndarray) -> None:
    """Writes a NIfTI file of labels with voxels of 1 mm."""
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.int32), np.eye(4)), path)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Changes to a new folder with the files that the pages assume to exist."""
    surface, sphere = sp.example_surface(4)
    for folder in (tmp_path, tmp_path / "subjects" / "sub-01" / "surf", tmp_path / "sub-01" / "surf"):
        folder.mkdir(parents=True, exist_ok=True)
        surface.save(folder / "lh.pial")
        sphere.save(folder / "lh.sphere.reg")
        sp.write_signal(folder / "lh.thickness", 2 + 0.1 * sphere.vertices[:, 0])
    sphere.save(tmp_path / "lh.sphere.surf.gii")
    surface.save(tmp_path / "s01.ply")
    for subject in range(3):
        sp.example_surface(4, subject)[0].save(tmp_path / f"subject{subject}.surf.gii")
    (tmp_path / "subjects.txt").write_text("".join(f"subject{subject}.surf.gii\n" for subject in range(3)))
    sp.fit(surface, sphere, 8).save(tmp_path / "lh.spharm.npz")
    labels = np.zeros((24, 24, 24), int)
    labels[2:9, 3:10, 3:8] = 1
    labels[10:20, 12:20, 9:18] = 2
    write_nifti(tmp_path / "cells.nii.gz", labels)
    write_nifti(tmp_path / "hippocampus.nii.gz", np.where(labels == 2, 17, labels))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@of("python")
def test_the_snippets_of_a_page_run(page: Path, study: Path) -> None:
    names: dict[str, Any] = {"sp": sp} if page in EXAMPLES else {}
    for at, block in enumerate(blocks(page, "python")):
        exec(compile(block, f"{page.name}, snippet {at + 1}", "exec"), names)


@of("sh")
def test_the_commands_of_a_page_run(page: Path, study: Path) -> None:
    program = study / "bin" / "spharm"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m spharm_rs "$@"\n')
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}", "ID": "sub-01"}
    environment.pop("SPHARM_STORE", None)
    for block in blocks(page, "sh"):
        # Reduce degrees, because the study's surfaces are small.
        commands = re.sub(r"(--max-degree|--factor) ([2-9]\d|\d{3,})\b", r"\1 20", block)
        done = subprocess.run(["bash", "-euo", "pipefail", "-c", commands], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{commands}\n{done.stderr}"


def test_every_public_name_is_in_the_reference() -> None:
    reference = (DOCS / "reference" / "python.rst").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   ([\w.]+)$", reference, re.M))
    modules = {"__version__", "convert", "errors", "reports", "shape", "spectra"}
    assert set(sp.__all__) - modules <= listed
    assert {f"convert.{name}" for name in sp.convert.__all__} <= listed
    assert {f"shape.{name}" for name in sp.shape.__all__} <= listed
    assert {f"spectra.{name}" for name in sp.spectra.__all__} <= listed
    assert {name for name in sp.errors.__all__} <= listed


def test_every_option_that_a_page_names_exists() -> None:
    def help_of(*verb: str) -> str:
        command = [sys.executable, "-m", "spharm_rs", *verb, "--help"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    def verbs_of(text: str) -> list[str]:
        commands = re.search(r"^Commands:\n(.*?)(\n\S|\Z)", text, re.M | re.S)
        names = re.findall(r"^  ([a-z-]+)  ", commands[1], re.M) if commands else []
        return [name for name in names if name != "help"]

    def helps(*verb: str) -> str:
        text = help_of(*verb)
        return text + "".join(helps(*verb, name) for name in verbs_of(text))

    known = set(re.findall(r"--[a-z][a-z-]*", helps()))
    # Options of cargo, pip and Apple's tools.
    others = {"--locked", "--path", "--git", "--features", "--no-default-features", "--open", "--install",
              "--config-settings", "--no-verify"}  # fmt: skip
    for page in [*DOCS.glob("algorithms/*.md"), DOCS / "index.md", DOCS / "install.md", DOCS / "conventions.md"]:
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", page.read_text(encoding="utf-8")))
        assert named <= known | others, page
