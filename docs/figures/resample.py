"""A surface put on icospheres of several levels."""

import shapes  # noqa: F401  (for the path of draw)
from draw import panels

import spharm_rs as sp

surface, _ = sp.example_surface(5)
mapped = sp.parametrize(surface)
found = [sp.resample(surface, mapped.sphere, f"icosphere:{level}") for level in (3, 4, 5)]
panels(
    [surface, *(one.surface for one in found)],
    titles=[
        f"given, {len(surface.vertices):,} vertices",
        *(f"{len(one.surface.vertices):,}, off by {one.report['distance_rms']:.2f} mm rms" for one in found),
    ],
    columns=2,
    edges=True,
    size=3.6,
)
