"""Generates FreeSurfer subjects in two groups with a known difference, for trying out a study.

    python make_subjects.py DIR [SUBJECTS]

Needs numpy, scipy, nibabel and nilearn; nilearn's package contains FreeSurfer's average fsaverage5. Each subject has
its own
triangulation of 9,000 to 11,000 vertices per hemisphere, its own head size, and its own smooth folds. Subjects of the
group
`patient` have a left cortex that is thicker by up to 1.5 mm within 25 degrees of one direction of the sphere; all other
differences are random. DIR has the layout of SUBJECTS_DIR, and participants.tsv lists the group of each subject.
"""

import sys
from pathlib import Path

import nibabel.freesurfer as freesurfer
import numpy as np
from nilearn.datasets import fetch_surf_fsaverage
from nilearn.surface import load_surf_data, load_surf_mesh
from scipy.spatial import ConvexHull, cKDTree

#: Centre of the region where the patients' left cortex is thicker, a direction of sphere.reg; its radius; the
#: difference in mm.
PLACE, WIDTH, THICKER = np.array([-0.6, 0.0, 0.8]), np.radians(25), 1.5
HEMISPHERES = {"lh": "left", "rh": "right"}


def average(side):
    """Returns directions, triangles and values of a hemisphere of fsaverage5."""
    data = fetch_surf_fsaverage("fsaverage5")
    mesh = lambda name: load_surf_mesh(data[f"{name}_{side}"])  # noqa: E731
    sphere = mesh("sphere")
    directions = np.asarray(sphere.coordinates, float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    white, pial = (np.asarray(mesh(name).coordinates, float) for name in ("white", "pial"))
    curv = np.asarray(load_surf_data(data[f"curv_{side}"]), float)
    return directions, np.asarray(sphere.faces), white, pial, curv


def sphere_of(count, rng):
    """Returns directions spread almost evenly, and the triangles between them, counter-clockwise seen from outside."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    azimuth = i * np.pi * (3 - 5**0.5)
    d = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    d += rng.normal(0, 0.15 * (4 * np.pi / count) ** 0.5, d.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    faces = ConvexHull(d).simplices
    a, b, c = (d[faces[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return d, faces


def interpolate(directions, sphere, faces, values):
    """Interpolates values at directions, linearly on the sphere's triangles. Of the 8 nearest triangles it uses the one
    whose smallest barycentric weight is largest."""
    corners = sphere[faces]
    centres = corners.mean(axis=1)
    near = cKDTree(centres / np.linalg.norm(centres, axis=1, keepdims=True)).query(directions, k=8)[1]
    inverse = np.linalg.inv(corners.transpose(0, 2, 1))
    weights = np.einsum("ptij,pj->pti", inverse[near], directions)
    best = weights.min(axis=2).argmax(axis=1)
    rows = np.arange(len(directions))
    weights, triangle = np.maximum(weights[rows, best], 0), near[rows, best]
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("pi,pi...->p...", weights, values[faces[triangle]])


def waves(directions, rng):
    """Returns a smooth random field of three components, of a size around 1."""
    field = np.zeros((len(directions), 3))
    for _ in range(12):
        frequency, phase = rng.normal(0, 2.5, 3), rng.uniform(0, 2 * np.pi)
        field += rng.normal(0, 1, 3) * np.cos(directions @ frequency + phase)[:, None]
    return field / 12**0.5


def make(folder, number, averages):
    """Writes one subject; returns its row of the participants' table."""
    rng = np.random.default_rng(number)
    patient = number % 2 == 1
    head = np.eye(3) + rng.normal(0, 0.02, (3, 3))
    centre = rng.normal(0, 5, 3)
    name = f"sub-{number + 1:02d}"
    surf = folder / name / "surf"
    surf.mkdir(parents=True)
    for hemisphere, (sphere, triangles, *values) in averages.items():
        directions, faces = sphere_of(9000 + 500 * (number % 5), rng)
        white, pial, curv = (interpolate(directions, sphere, triangles, of) for of in values)
        across = pial - white
        thickness = np.linalg.norm(across, axis=1)
        across /= np.maximum(thickness, 1e-6)[:, None]
        thickness = thickness * (1 + 0.05 * waves(directions, rng)[:, 0])
        if patient and hemisphere == "lh":
            angle = np.arccos(np.clip(directions @ (PLACE / np.linalg.norm(PLACE)), -1, 1))
            thickness += THICKER * np.where(angle < WIDTH, np.cos(np.pi / 2 * angle / WIDTH) ** 2, 0)
        white = white + 0.8 * waves(directions, rng)
        pial = white + across * thickness[:, None]
        volume = {
            "head": np.array([2, 0, 20], np.int32), "valid": "1  # volume info valid", "filename": "../mri/filled.mgz",
            "volume": np.array([256, 256, 256]), "voxelsize": np.ones(3), "xras": np.array([-1.0, 0, 0]),
            "yras": np.array([0, 0, -1.0]), "zras": np.array([0, 1.0, 0]), "cras": centre,
        }
        for kind, vertices in (("white", white @ head), ("pial", pial @ head)):
            freesurfer.write_geometry(surf / f"{hemisphere}.{kind}", vertices, faces, volume_info=volume)
        freesurfer.write_geometry(surf / f"{hemisphere}.sphere.reg", 100 * directions, faces)
        freesurfer.write_morph_data(surf / f"{hemisphere}.thickness", thickness, fnum=len(faces))
        freesurfer.write_morph_data(surf / f"{hemisphere}.curv", curv, fnum=len(faces))
    return f"{name}\t{'patient' if patient else 'control'}\t{rng.integers(20, 70)}\n"


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    folder, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) == 3 else 12
    if (folder / "sub-01").exists():
        sys.exit(f"{folder}: has subjects already; choose another folder")
    averages = {hemisphere: average(side) for hemisphere, side in HEMISPHERES.items()}
    rows = [make(folder, number, averages) for number in range(count)]
    (folder / "participants.tsv").write_text("participant_id\tgroup\tage\n" + "".join(rows))
    print(f"{folder}: {count} subjects")


if __name__ == "__main__":
    main()
