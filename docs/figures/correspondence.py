"""Places of the same direction on members of a group: mapped one by one, and made to correspond."""

import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
from draw import panels

import spharm_rs as sp

warnings.simplefilter("ignore", sp.SpharmWarning)
with tempfile.TemporaryDirectory() as folder:
    generate = ["generate", "--group", "growing-bump", "--members", "4", "--upright", "--output-dir", folder, "-q"]
    subprocess.run([sys.executable, "-m", "spharm_rs", *generate], check=True, stdout=subprocess.DEVNULL)
    paths = sorted(Path(folder).glob("*.ply"))
    alone = [sp.fit(path, max_degree=12) for path in paths]
    group = sp.shape.correspond(paths, 12, subdivisions=3)

sphere = sp.icosphere(5)
together = [transform.inverse().apply(model) for model, transform in zip(group.models, group.transforms)]
drawn, values = [], []
for models in (alone, together):
    surfaces = [model.surface(sphere) for model in models]
    end = surfaces[0].vertices[:, 0].argmax()
    drawn += surfaces
    values += [np.degrees(np.arccos(np.clip(sphere.vertices @ sphere.vertices[end], -1, 1)))] * len(surfaces)
look = {"view": (-70, 25), "cmap": "turbo", "limits": (0, 180), "label": "angle from one direction"}
panels(drawn, values, columns=4, size=2.2, **look)
