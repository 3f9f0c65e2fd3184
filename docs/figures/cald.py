"""A body with arms, mapped to the sphere by cald."""

from shapes import body, draw_map

import spharm_rs as sp

draw_map(sp.parametrize(body(), method="cald"), "cald", limits=(-0.5, 0.5))
