"""A body with arms, mapped to the sphere by stretch."""

from shapes import body, draw_map

import spharm_rs as sp

draw_map(sp.parametrize(body(), method="stretch"), "stretch")
