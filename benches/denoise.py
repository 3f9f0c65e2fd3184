"""Measures the noise removed by `fit --denoise`, in dB below the input noise, on surfaces of ../shared/data with added
noise.

    python3 benches/denoise.py SPHARM DATA [SIGMA ...]

Noise of standard deviation SIGMA (default 0.01; bounding box of volume 1) is added to each coordinate of each vertex,
by NumPy's generator with seed 0. The program fits the noisy vertices and the noisy surface, with and without --denoise.
The model at the vertices is compared with the surface without noise: `10 log10(3 sigma^2 / mean |model - clean|^2)`.
The required values are those of the best mesh filter, with the best number of iterations in hindsight, and of the
prototype.
"""

import base64
import gzip
import json
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml
import zlib
from pathlib import Path

import numpy as np

CASES = [
    ("5a head27618", "head27618.sphere.surf.gii", "head27618.surf.gii", 60, 14.5, 10.37),
    ("5b cort40962", "cort40962.sphere.surf.gii", "cort40962.surf.gii", 100, 13.0, 11.25),
    ("5c fsaverage5", "fsaverage5.sphere_left.gii.gz", "fsaverage5.pial_left.gii.gz", 60, 7.1, 7.12),
]


def gifti(path):
    """Returns vertices and triangles of a GIfTI surface."""
    data = path.read_bytes()
    root = xml.fromstring(gzip.decompress(data) if path.suffix == ".gz" else data)
    found = {}
    for array in root.iter("DataArray"):
        shape = [int(array.get(f"Dim{k}")) for k in range(int(array.get("Dimensionality")))]
        kind = {"NIFTI_TYPE_FLOAT32": "f4", "NIFTI_TYPE_FLOAT64": "f8", "NIFTI_TYPE_INT32": "i4"}[array.get("DataType")]
        order = "<" if array.get("Endian") == "LittleEndian" else ">"
        text = array.find("Data").text
        if array.get("Encoding") == "ASCII":
            values = np.array(text.split(), kind)
        else:
            raw = base64.b64decode(text)
            raw = zlib.decompress(raw) if array.get("Encoding") == "GZipBase64Binary" else raw
            values = np.frombuffer(raw, order + kind)
        found[array.get("Intent")] = values.reshape(shape)
    return found["NIFTI_INTENT_POINTSET"].astype(float), found["NIFTI_INTENT_TRIANGLE"].astype(int)


def write_ply(path, vertices, faces):
    """Writes a binary PLY file with coordinates as doubles."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty double x\nproperty double y\n"
    head += f"property double z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    rows["n"], rows["v"] = 3, faces
    path.write_bytes(head.encode() + vertices.astype("<f8").tobytes() + rows.tobytes())


def read_ply(path):
    """Returns the vertices of a binary PLY file of doubles or floats."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head = data[:end].decode().split("\n")
    count = next(int(line.split()[2]) for line in head if line.startswith("element vertex"))
    kind = "<f8" if "property double x" in head else "<f4"
    return np.frombuffer(data, kind, 3 * count, end).reshape(count, 3).astype(float)


def main():
    spharm, data = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    sigmas = [float(sigma) for sigma in sys.argv[3:]] or [0.01]
    head = f"{'surface':14} {'sigma':>6} {'target':>8} {'plain':>6} {'denoise':>8} {'bar':>5} {'best filter':>11}"
    print(head + f" {'sigma found':>11} {'freedom':>8} {'left out':>8} {'s':>5}")
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for name, sphere, surface, degree, bar, best in CASES:
            clean, faces = gifti(data / surface)
            clean = clean - clean.mean(0)
            size = np.ptp(clean, axis=0).prod() ** (1 / 3)
            for sigma in sigmas:
                s = sigma * size
                noise = np.random.default_rng(0).normal(size=clean.shape) * s
                noisy, model, back = (Path(folder) / f for f in ("noisy.ply", "model.npz", "back.ply"))
                write_ply(noisy, clean + noise, faces)
                for target in ("vertices", "surface"):
                    found = {}
                    for option in ((), ("--denoise",)):
                        command = [spharm, "fit", "--sphere", data / sphere, "--surface", noisy, "--objective", target]
                        command += ["--max-degree", str(degree), "--no-surface-distance", "--json", "-q", "--force"]
                        command += [*option, "-o", model]
                        report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
                        command = [spharm, "reconstruct", "--model", model, "-o", back, "-q", "--force"]
                        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
                        error = ((read_ply(back) - clean) ** 2).sum(1).mean()
                        found[option] = 10 * np.log10(3 * s**2 / error)
                    removed = report["surfaces"][0]["denoise"][0]
                    with_bar = sigma == 0.01
                    print(
                        f"{name:14} {sigma:6} {target:>8} {found[()]:6.2f} {found[('--denoise',)]:8.2f}"
                        f" {bar if with_bar else '-':>5} {best if with_bar else '-':>11} {removed['sigma'] / s:11.3f}"
                        f" {removed['degrees_of_freedom']:8.0f} {(removed['left_out'] or 0) / s:8.3f} {report['seconds']['total']:5.1f}",
                        flush=True,
                    )
                    if with_bar and found[("--denoise",)] < bar:
                        missed.append(f"{name}, {target}")
    print("below the bar: " + "; ".join(missed) if missed else "every bar is met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
