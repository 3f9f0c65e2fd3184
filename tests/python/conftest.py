"""Fixtures that tests share: a folded surface, its sphere, and their files."""

from __future__ import annotations

from pathlib import Path

import pytest

import spharm_rs as sp

Study = tuple[sp.Surface, sp.Surface]


@pytest.fixture(scope="session")
def study() -> Study:
    """Returns a folded surface of 2,562 vertices and its sphere."""
    return sp.example_surface(4)


@pytest.fixture(scope="session")
def files(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with the surface and its sphere as `surface.ply` and `sphere.ply`."""
    folder = tmp_path_factory.mktemp("study")
    for name, mesh in zip(("surface", "sphere"), study):
        mesh.save(folder / f"{name}.ply", double=True)
    return folder
