"""The surface of a label of voxels, mapped to the sphere by equal-area."""

import numpy as np
from shapes import draw_map

import spharm_rs as sp

i, j, k = np.indices((30, 16, 14))
x, y, z = (i - 14.5) / 11, (j - 6 - 4 * ((i - 14.5) / 11) ** 2) / 4, (k - 6.5) / 4.5
draw_map(sp.parametrize_volume((x**2 + y**2 + z**2 < 1).astype(int)), "equal-area", limits=(-0.5, 0.5), view=(-70, 40))
