"""A body with arms, mapped to the sphere by deform."""

from shapes import body, draw_map

import spharm_rs as sp

draw_map(sp.parametrize(body(), method="deform"), "deform", limits=(-1, 1))
