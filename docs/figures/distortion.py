"""A body with arms mapped to the sphere in two ways, and its models of one degree over both maps."""

import warnings

import numpy as np
from draw import panels
from shapes import body, log_area_ratio

import spharm_rs as sp

warnings.simplefilter("ignore", sp.SpharmWarning)
surface = body(5)
rows, values, titles = [], [], []
for method in ("cald", "conformal"):
    mapped = sp.parametrize(surface, method=method)
    model = sp.fit(mapped, max_degree=20)
    rms = sp.compare(surface, model.surface(), surface_distance=True).surface["rms"]
    size = np.ptp(surface.vertices, axis=0).max() / 2.6
    rows += [sp.Surface(mapped.sphere.vertices * size, surface.faces), model.surface()]
    values += [log_area_ratio(surface, mapped.sphere)] * 2
    area = mapped.quality["area_rms"]
    titles += [f"{method}: sphere, area distortion {area:.2f}", f"model of degree 20, rms {rms:.3f}"]
panels(rows, values, titles, columns=2, view=(-75, 15), cmap="RdBu_r", limits=(-2, 2), label="log area ratio", size=3.6)
