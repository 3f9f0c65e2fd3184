#!/usr/bin/env python3
"""Compares the time of mapping thin triangles with an icosphere of as many vertices: `./run bench slivers`.

The surfaces are a fan (a double pyramid over a polygon, whose poles have one triangle per side), a sphere by latitude
and longitude, and a tube of triangles that are 1000 times as long as wide. CPU seconds per vertex are compared, of
`parametrize` with its default method, and of `deform` onto an icosphere of 10,242 vertices. Uses Python's standard
library only. Exits with 1 if a required limit is missed.
"""

import argparse
import math
import struct
import sys
import tempfile
from pathlib import Path

from maps import SPHARM, run

# Largest permitted ratio to the icosphere's time: the required limit is 20, of which a fifth is kept in reserve.
MOST = 16
SUBDIVISIONS = 7
LAYOUT = "{:<28} {:>9} {:>8} {:>8} {:>9}"


def fan(sides):
    angles = [math.tau * k / sides for k in range(sides)]
    rim = [(math.cos(t), math.sin(t), 0.0) for t in angles]
    after = [(k, (k + 1) % sides) for k in range(sides)]
    faces = [(a, b, sides) for a, b in after] + [(b, a, sides + 1) for a, b in after]
    return rim + [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)], faces


def rings(profile, around):
    """Returns a surface of revolution: a pole, rings of `around` vertices at each (radius, height), and another
    pole."""
    first, *inner, last = profile
    turns = [math.tau * j / around for j in range(around)]
    points = [(r * math.cos(t), r * math.sin(t), z) for r, z in inner for t in turns]
    top, bottom = len(points), len(points) + 1
    points += [(0.0, 0.0, first[1]), (0.0, 0.0, last[1])]
    faces, end = [], (len(inner) - 1) * around
    for j in range(around):
        k = (j + 1) % around
        faces += [(j, k, top), (end + k, end + j, bottom)]
        for ring in range(0, end, around):
            a, b, c, d = ring + j, ring + k, ring + around + j, ring + around + k
            faces += [(a, c, b), (b, c, d)]
    return points, faces


def latitudes(vertices):
    count = round(math.sqrt(vertices / 2))
    angles = [math.pi * i / count for i in range(count + 1)]
    return rings([(math.sin(t), math.cos(t)) for t in angles], 2 * count)


def tube(vertices, ratio=1000):
    count = round(math.sqrt(vertices))
    edge = 2 * math.sin(math.pi / count)
    inner = [(1.0, -i * edge * ratio) for i in range(count)]
    return rings([(0.0, edge), *inner, (0.0, inner[-1][1] - edge)], count)


def write(path, mesh):
    points, faces = mesh
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    body = b"".join(struct.pack("<3d", *point) for point in points)
    path.write_bytes(head.encode() + body + b"".join(struct.pack("<B3i", 3, *face) for face in faces))
    return len(points)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--program", type=Path, default=SPHARM)
    parser.add_argument("--vertices", type=int, default=200_000)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    print(LAYOUT.format("surface", "vertices", "cpu s", "us each", "times"))
    missed = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        surfaces = {"icosphere": folder / "icosphere.ply"}
        run(arguments.program, "generate", "--subdivisions", SUBDIVISIONS, "--sphere", surfaces["icosphere"])
        sizes = {"icosphere": 10 * 4**SUBDIVISIONS + 2}
        for kind, make in (("fan", fan), ("latitudes and longitudes", latitudes), ("tube", tube)):
            surfaces[kind] = folder / f"{kind[:3]}.ply"
            sizes[kind] = write(surfaces[kind], make(arguments.vertices))
        for method in ("auto", "deform"):
            first = None
            for kind, surface in surfaces.items():
                if method == "deform" and kind not in ("icosphere", "fan"):
                    continue
                more = ["--subdivisions", 5, "--surface-output", folder / "deformed.ply"] if method == "deform" else []
                seconds, _ = run(arguments.program, "parametrize", "--surface", surface, "--method", method, "--threads",
                                 arguments.threads, "-o", folder / "map.ply", "--force", *more)
                each = 1e6 * seconds / sizes[kind]
                first = first or each
                print(LAYOUT.format(f"{kind}, {method}", sizes[kind], f"{seconds:.1f}", f"{each:.0f}", f"{each / first:.1f}"),
                      flush=True)
                if each > MOST * first:
                    missed.append(f"{kind}, {method}: {each / first:.1f} times the icosphere's, at most {MOST}")
    print("\n".join(["missed:", *missed]) if missed else "every bar is met")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
