"""Makes the references of this folder with NumPy, SciPy and ppigrf, without this project's code.

    pip install numpy scipy nibabel ppigrf
    python make.py [SPHERE.surf.gii SURFACE.surf.gii L]

`sphere.surf.gii` and `surface.surf.gii` are a bumpy body of 2,562 vertices over a sphere that is sampled unevenly, so
that plain residual fitting converges slowly. `reference.json` has the mean and the largest squared distance at the
vertices, with the bounding box scaled to volume 1, for SIRF, for IRF after p passes over blocks of whole degrees with
at most g functions, and for the full least squares. The basis is a dense matrix; each block is solved by the Cholesky
factor of its Gram matrix, and the full least squares by QR.

`igrf.csv` has the coefficients of IGRF-13 at 2020.0 as published by the International Association of Geomagnetism and
Aeronomy, in nT: n, m, g, h (Schmidt's semi-normalisation). `igrf_field.csv` has the field's radial component at the
Earth's mean radius, evaluated by ppigrf at the directions of `igrf_directions.csv`.

With arguments, prints the figures of other files instead, to compare this script with another program.
"""

import datetime
import json
import sys
from pathlib import Path

import nibabel as nib
import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import ConvexHull
from scipy.special import sph_harm_y

HERE = Path(__file__).parent
DEGREE = 20


def basis(directions, degrees):
    """Returns real orthonormal harmonics without the Condon-Shortley phase, in the order l^2 + l + m: (n, K)."""
    theta, phi = np.arccos(np.clip(directions[:, 2], -1, 1)), np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in degrees:
        for order in range(-degree, degree + 1):
            y = sph_harm_y(degree, abs(order), theta, phi) * (-1) ** order
            part = y.real if order >= 0 else y.imag
            columns.append(part * (1 if order == 0 else np.sqrt(2)))
    return np.stack(columns, axis=1)


def solve(block, values):
    """Returns the least-squares coefficients of one block, by its Gram matrix."""
    return cho_solve(cho_factor(block.T @ block), block.T @ values)


def figures(surface, fitted):
    """Returns msd and xsd, the mean and the largest squared distance, for a bounding box of volume 1."""
    scale = np.prod(np.ptp(surface, axis=0)) ** (1 / 3)
    squares = np.sum((surface - fitted) ** 2, axis=1) / scale**2
    return {"msd": float(squares.mean()), "xsd": float(squares.max())}


def irf(surface, a, blocks, passes):
    """Returns msd and xsd after each number of passes."""
    residual, found = surface.copy(), {}
    for done in range(1, max(passes) + 1):
        for block in blocks:
            residual -= a[:, block] @ solve(a[:, block], residual)
        if done in passes:
            found[done] = figures(surface, surface - residual)
    return found


def whole_degrees(degree, g):
    """Returns the columns of blocks of whole degrees, with at most g functions unless a single degree has more."""
    blocks, first = [], 0
    for last in range(degree + 1):
        if last == degree or (last + 2) ** 2 - first**2 > g:
            blocks.append(slice(first**2, (last + 1) ** 2))
            first = last + 1
    return blocks


def reference(directions, surface, degree):
    """Returns all figures of a surface."""
    a = basis(directions, range(degree + 1))
    degrees = [slice(l * l, (l + 1) ** 2) for l in range(degree + 1)]
    results = {}
    for top in sorted({5, degree // 2, degree}):
        results[f"sirf L={top}"] = irf(surface, a, degrees[: top + 1], [1])[1]
    for g in (1, 40, 150):
        for p, found in irf(surface, a, whole_degrees(degree, g), [1, 2, 4, 8]).items():
            results[f"irf p={p} g={g} L={degree}"] = found
    q, _ = np.linalg.qr(a)
    results[f"least-squares L={degree}"] = figures(surface, q @ (q.T @ surface))
    scale = float(np.prod(np.ptp(surface, axis=0)) ** (1 / 3))
    return {"n": len(surface), "L": degree, "scale": scale, "results": results}


def read(path):
    """Returns a file's positions, unchanged, and its triangles."""
    image = nib.load(path)
    return image.agg_data("pointset").astype(float), image.agg_data("triangle")


def write(path, positions, faces):
    """Writes a GIfTI file in single precision."""
    arrays = [
        nib.gifti.GiftiDataArray(positions.astype("f4"), intent="NIFTI_INTENT_POINTSET"),
        nib.gifti.GiftiDataArray(faces.astype("i4"), intent="NIFTI_INTENT_TRIANGLE"),
    ]
    nib.save(nib.gifti.GiftiImage(darrays=arrays), path)


def body():
    """Returns the directions, triangles and positions of a bumpy body over an unevenly sampled sphere."""
    n = 2562
    i = np.arange(n)
    z, azimuth = 1 - (2 * i + 1) / n, i * np.pi * (3 - 5**0.5)
    d = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    # Makes one side denser, by a factor of about three in length.
    d += np.array([0.45, 0.2, -0.1])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    faces = ConvexHull(d).simplices
    a, b, c = (d[faces[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    rng = np.random.default_rng(2006)
    radius = np.ones(n)
    for _ in range(40):
        centre = rng.normal(size=3)
        cosine = d @ (centre / np.linalg.norm(centre))
        radius += 0.12 * rng.normal() * np.exp(rng.uniform(8, 400) * (cosine - 1))
    return d, faces, d * radius[:, None] * np.array([40.0, 28.0, 22.0]) + np.array([12.0, -7.0, 3.0])


def magnetic_field():
    """Writes IGRF-13 at 2020.0, and the radial field that ppigrf evaluates from it."""
    import ppigrf

    date = datetime.datetime(2020, 1, 1)
    g, h = ppigrf.ppigrf.read_shc(str(Path(ppigrf.__file__).parent / "IGRF13.shc"))
    rows = []
    for n, m in [(n, m) for n in range(1, 14) for m in range(n + 1)]:
        rows.append([n, m, g[(n, m)].loc[date], h[(n, m)].loc[date] if m else 0.0])
    np.savetxt(HERE / "igrf.csv", rows, fmt=["%d", "%d", "%.2f", "%.2f"], delimiter=",", header="n,m,g,h", comments="")
    n = 600
    i = np.arange(n)
    theta, phi = np.degrees(np.arccos(1 - (2 * i + 1) / n)), np.degrees(i * np.pi * (3 - 5**0.5)) % 360
    radial, _, _ = ppigrf.igrf_gc(ppigrf.ppigrf.RE, theta, phi, date, coeff_fn=str(Path(ppigrf.__file__).parent / "IGRF13.shc"))
    angles = np.stack([np.radians(theta), np.radians(phi)], axis=1)
    np.savetxt(HERE / "igrf_directions.csv", angles, fmt="%.17g", delimiter=",", header="theta,phi", comments="")
    np.savetxt(HERE / "igrf_field.csv", np.ravel(radial), fmt="%.17g", header="radial", comments="")


def main():
    if len(sys.argv) == 4:
        (sphere, _), (surface, _) = read(sys.argv[1]), read(sys.argv[2])
        directions = sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
        print(json.dumps(reference(directions, surface, int(sys.argv[3])), indent=1))
        return
    sphere, faces, surface = body()
    write(HERE / "sphere.surf.gii", sphere, faces)
    write(HERE / "surface.surf.gii", surface, faces)
    # Read back from the files, whose positions are in single precision.
    (sphere, _), (surface, _) = read(HERE / "sphere.surf.gii"), read(HERE / "surface.surf.gii")
    directions = sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    (HERE / "reference.json").write_text(json.dumps(reference(directions, surface, DEGREE), indent=1) + "\n")
    magnetic_field()


if __name__ == "__main__":
    main()
