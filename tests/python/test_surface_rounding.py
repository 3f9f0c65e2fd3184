"""Files whose 32-bit numbers are too coarse for a surface."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import spharm_rs as sp

CHOICE = ["a.surf.gii", "a.ply", "a.ply.gz"]
SINGLE = ["a.glb", "a.stl", "lh.pial"]
EXACT = ["a.obj", "a.off", "a.vtk", "a.vtp", "a.3mf", "lh.a.OBJ.gz"]


@pytest.mark.parametrize("name", CHOICE + SINGLE + EXACT)
def test_a_warning_is_given_if_positions_are_lost(tmp_path: Path, name: str) -> None:
    ball = sp.icosphere(2)
    far = sp.Surface(1.3 * ball.vertices + 1e6, ball.faces)
    for double in (False, True):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            sp.write_surface(tmp_path / name, ball, overwrite=True, double=double)
            far.save(tmp_path / name, overwrite=True, double=double)
        written = sp.read_surface(tmp_path / name).vertices
        lost = not np.allclose(written.min(axis=0), far.vertices.min(axis=0), rtol=0, atol=1e-6)
        assert lost == (name in SINGLE or (name in CHOICE and not double))
        assert [one.filename for one in found] == [__file__] * lost
        remedy = "give double=True" if name in CHOICE else "such as .vtp"
        texts = [str(one.message) for one in found]
        assert all("32-bit numbers are too coarse" in text and text.endswith(remedy) for text in texts)
