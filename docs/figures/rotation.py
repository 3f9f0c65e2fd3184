"""A surface after a rotation of its parameters, and after a rotation of space. Colours are those of the directions."""

import numpy as np
from shapes import angles_from, body
from draw import panels

import spharm_rs as sp

surface = body(4, length=1.2)
model = sp.fit(sp.parametrize(surface, area=0.25, degree=15), max_degree=15)
angle = np.radians(60)
turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
models = [model, model.rotate(parameters=turn), model.rotate(object=turn)]
sphere = sp.icosphere(5)
panels(
    [one.surface(sphere) for one in models],
    [angles_from(0, sphere)] * 3,
    ["the model", "parameters rotated by 60°", "space rotated by 60°"],
    view=(-75, 15),
    cmap="turbo",
    limits=(0, 180),
    label="angle from the x axis",
    size=2.8,
)
