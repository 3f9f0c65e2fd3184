"""The distance between a surface and its model of degree 20, and how it settles as the points get denser."""

import matplotlib.pyplot as plt
import shapes  # noqa: F401
from draw import paint
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

import spharm_rs as sp

surface, sphere = sp.example_surface(5)
model = sp.fit(surface, sphere, 20).surface(4)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), width_ratios=(1.3, 1), layout="constrained")
found = sp.compare(surface, model, surface_distance=True)
paint(left, model, found.per_vertex, cmap="YlOrRd", limits=(0, 3))
figure.colorbar(ScalarMappable(Normalize(0, 3), "YlOrRd"), ax=left, shrink=0.7, label="distance from the original, mm")
left.set_title("degree 20, on 2,562 vertices", fontsize=10)

counts = [3_000, 10_000, 30_000, 100_000, 300_000]
each = [sp.compare(surface, model, surface_distance=True, samples=count).surface for count in counts]
right.semilogx(counts, [e["hausdorff"] for e in each], "o-", color="#8c3a2b", label="Hausdorff, found")
right.fill_between(
    counts,
    [e["hausdorff"] for e in each],
    [e["hausdorff"] + e["bound"] for e in each],
    color="#8c3a2b",
    alpha=0.15,
    linewidth=0,
    label="where it may be",
)
right.semilogx(counts, [e["percentile95"] for e in each], "s-", color="#c77f2a", label="95th percentile")
right.semilogx(counts, [e["rms"] for e in each], "^-", color="#2b5d8c", label="root mean square")
right.set(xlabel="points", ylabel="mm", ylim=(0, None))
right.legend(fontsize=8)
right.grid(alpha=0.3)
