"""Two bodies in different poses with different parameters, and the first one after the alignment to the second."""

import warnings

import numpy as np
from shapes import angles_from, body
from draw import panels

import spharm_rs as sp

warnings.simplefilter("ignore", sp.SpharmWarning)


def model(length, turn=None, seed=0):
    surface = body(4, length=length)
    fitted = sp.fit(sp.parametrize(surface, area=0.25, degree=15, seed=seed), max_degree=15)
    return fitted if turn is None else fitted.rotate(object=turn)


turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
moved, target = model(1.2, turn, seed=3), model(1.0)
found = sp.shape.align(moved, target)
sphere = sp.icosphere(5)
panels(
    [one.surface(sphere) for one in (moved, found.model, target)],
    [angles_from(2, sphere)] * 3,
    ["a body", f"aligned: {found.rmsd_after:.2f} rms", "the target"],
    view=(-75, 15),
    cmap="turbo",
    limits=(0, 180),
    label="angle from the north pole",
    size=2.8,
)
