"""A mesh of few vertices and its model of degree 21, without smoothness, with the default and with one that is chosen."""

import warnings

from shapes import body
from draw import panels

import spharm_rs as sp

warnings.simplefilter("ignore", sp.SpharmWarning)
surface = body(3)
mapped = sp.parametrize(surface, area=0.25, degree=21)
models = {f"smoothness {s}": sp.fit(mapped, max_degree=21, objective="vertices", smoothness=s) for s in (0, None, "auto")}
names = ["smoothness=0", "the default", 'smoothness="auto"']
panels(
    [surface, *(model.surface(5) for model in models.values())],
    titles=[
        "642 vertices",
        *(f"{name}\n{model.report['smoothness']:.0e}" for name, model in zip(names, models.values())),
    ],
    view=(-75, 15),
    size=2.6,
)
