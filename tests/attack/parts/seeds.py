"""Makes seed corpora of the fuzz targets from the fixtures in `tests/data` and from the program's outputs.

An input is a file and one more byte, which selects the file's name or the repair; `fuzz/src/readers/mod.rs` lists the
names in the same order.
"""

import gzip
import struct
import zipfile
import zlib

from common import ROOT, run
from verbs import nifti, samples

SURFACES = ("", ".obj", ".ply", ".off", ".stl", ".vtk", ".meta", ".surf.gii", ".func.gii", ".mgh", ".csv", ".tsv", "pial", "curv",
            ".glb", ".gltf", ".vtp", ".vtu", ".3mf", ".wrl")
TABLES = (".csv", ".tsv", ".npy", ".npz", ".ply", ".las", ".parquet", ".arrow")
VOLUMES = (".nii", ".nii.gz", ".mgz", ".nrrd", ".tif", ".npy")
FORMATS = ("pdm", "mat", "pyshtools", "healpy", "s2fft", "ktch", "flowshape", "aics", "afni", "csv", "json")
ARRAYS = ("coefficients", "max_degree", "convention", "faces", "directions", "cut_from", "seam", "scheme_key", "provenance",
          "modes", "variances", "scores", "members")
#: Largest size of a seed in bytes: longer files slow down the fuzzer and reach no further code.
LONGEST = 16 << 10
#: Dictionary of the formats' words, for all targets.
WORDS = (
    "ply\\x0aformat ascii 1.0\\x0a", "format binary_little_endian 1.0\\x0a", "element vertex ", "property list uchar int ",
    "vertex_indices", "end_header\\x0a", "OFF", "COFF", "solid", "facet normal", "# vtk DataFile Version 5.1", "DATASET POLYDATA",
    "POINTS ", "POLYGONS ", "TRIANGLE_STRIPS ", "CELLS ", "CELL_TYPES ", "element tristrips ", "OFFSETS vtktypeint64", "CONNECTIVITY", "<GIFTI", "<DataArray", "Encoding=\\\"GZipBase64Binary\\\"",
    "Encoding=\\\"ASCII\\\"", "DataType=\\\"NIFTI_TYPE_FLOAT64\\\"", "Dimensionality=\\\"", "Dim0=\\\"", "ArrayIndexingOrder=",
    "<![CDATA[", "<!DOCTYPE", "<!ENTITY", "\\x1f\\x8b\\x08", "\\x93NUMPY\\x01\\x00", "{'descr': '<f8', 'fortran_order': False, 'shape': (",
    "'shape': (", "'<U", "'|u1'", "'>f4'", "18446744073709551615", "9223372036854775807", "4294967295", "1e308", "1e-320", "nan",
    "inf", "-0", "NRRD0005", "encoding: gzip", "sizes: ", "space directions: ", "data file: ", "PAR1", "ARROW1", "LASF", "SPHMOMNT",
    "\\x89SPZ", "II*\\x00", "MM\\x00*", "PK\\x03\\x04", "PK\\x01\\x02", "PK\\x05\\x06", "SIMPLE  =", "XTENSION", "BINTABLE", "TFORM1",
    "NAXIS2", "MATLAB 5.0 MAT-file", "fvec", "\\xff\\xff\\xff\\xff\\xff\\xff\\xff\\xff", "\\x00\\x00\\x00\\x80", "\\xef\\xbb\\xbf", "\\\"\\\"",
    "glTF\\x02\\x00\\x00\\x00", "\\\"POSITION\\\":0", "\\\"bufferView\\\":", "\\\"sparse\\\":", "\\\"matrix\\\":", "\\\"children\\\":[", "<VTKFile type=",
    "compressor=\\\"vtkZLibDataCompressor\\\"", "format=\\\"appended\\\"", "<AppendedData", "<component objectid=", "transform=\\\"",
    "#VRML V2.0 utf8", "IndexedFaceSet {", "coordIndex [", "DEF a ", "USE a ", "Transform {",
    "\\x1b[", "id\\x09surface\\x0a", "\\x09done\\x09", "@", "\\\"markups\\\"",
)


class Corpora:
    """Folders of inputs, one per target."""

    def __init__(self, folder):
        self.folder = folder

    def add(self, target, name, data, choice=0):
        path = self.folder / target
        path.mkdir(parents=True, exist_ok=True)
        if len(data) <= LONGEST:
            (path / name.replace("/", "_")).write_bytes(bytes(data) + bytes([choice]))


def ending(name, endings):
    """Returns the index of the longest of the extensions that a name has."""
    name = name.removesuffix(".gz") if not name.endswith(".nii.gz") else name
    fitting = [number for number, end in enumerate(endings) if end and name.endswith(end)]
    return max(fitting, key=lambda number: len(endings[number]), default=0)


def make(site, folder):
    """Makes all corpora in a folder."""
    corpora = Corpora(folder)
    work = site.folder("seeds")

    def program(*words):
        ended = run([site.program, *words], cwd=work, limit=120)
        if ended.code != 0:
            site.say(f"a seed can't be made: {' '.join(map(str, words))}: {ended.last()}")

    data = ROOT / "tests/data"
    for path in sorted((data / "meshes").iterdir()):
        if path.suffix != ".json":
            corpora.add("surfaces", path.name, path.read_bytes(), ending(path.name, SURFACES))
    program("generate", "--subdivisions", 0, "--surface", "s.ply", "--sphere", "sphere.obj")
    corpora.add("surfaces", "s.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
                b"endfacet\nendsolid a\n", SURFACES.index(".stl"))
    for name in ("s.surf.gii", "s.vtk", "s.off"):
        program("generate", "--subdivisions", 0, "--surface", name)
        corpora.add("surfaces", name, (work / name).read_bytes() if (work / name).exists() else b"", ending(name, SURFACES))
    corpora.add("surfaces", "s.mgz", mgh(), SURFACES.index(".mgh"))
    corpora.add("surfaces", "s.meta", b"ObjectType = Mesh\nNDims = 3\nNPoints = 3\nPoints = \n0 0 0 0\n1 1 0 0\n2 0 1 0\nNCells = 1\n"
                b"CellType = TRI\nCells = \n0 0 1 2\n", SURFACES.index(".meta"))

    small = nifti(6)
    corpora.add("volumes", "a.nii", small, 0)
    corpora.add("volumes", "a.nii.gz", gzip.compress(small, mtime=0), 1)
    corpora.add("volumes", "a.mgz", mgh((3, 3, 3)), 2)
    nrrd = (b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 3 3 3\nspace: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) "
            b"(0,0,1)\nspace origin: (0,0,0)\nencoding: ")
    corpora.add("volumes", "raw.nrrd", nrrd + b"raw\n\n" + cube(), 3)
    corpora.add("volumes", "gzip.nrrd", nrrd + b"gzip\n\n" + gzip.compress(cube(), mtime=0), 3)
    corpora.add("volumes", "ascii.nrrd", nrrd + b"ascii\n\n" + b" ".join(b"%d" % x for x in cube()), 3)
    corpora.add("volumes", "a.tif", tiff(), 4)
    corpora.add("volumes", "a.npy", npy("|u1", "(3, 3, 3)", cube()), 5)

    rows = samples(12).encode()
    corpora.add("tables", "a.csv", rows, 0)
    corpora.add("tables", "a.tsv", rows.replace(b",", b"\t"), 1)
    numbers = [float(cell) for line in rows.decode().splitlines()[1:] for cell in line.split(",")]
    packed = struct.pack(f"<{len(numbers)}d", *numbers)
    descr = "[('x', '<f8'), ('y', '<f8'), ('z', '<f8'), ('v', '<f8')]"
    corpora.add("tables", "a.npy", npy(descr, f"({len(numbers) // 4},)", packed), 2)
    corpora.add("tables", "s.ply", (work / "s.ply").read_bytes(), 4)

    program("fit", "--sphere", "sphere.obj", "--surface", "s.ply", "--max-degree", 1, "-o", "m.npz", "-q")
    model = (work / "m.npz").read_bytes()
    corpora.add("models", "m.npz", model)
    corpora.add("archives", "m", members(work / "m.npz"), 0)
    corpora.add("archives", "deflated", members(work / "m.npz"), 1)
    for target, pattern in (("basis", "store/*/A_*"), ("factors", "store/*/factor_*")):
        for path in sorted((data / "golden-v1").glob(pattern)):
            for kind in (0, 3, 31):
                corpora.add(target, f"{path.parent.name[:4]}-{path.name}-{kind}", path.read_bytes(), kind)
    for path in sorted((ROOT / "crates/moments/tests/data").glob("*.moments")):
        for kind in (0, 1):
            corpora.add("moments", f"{path.name}-{kind}", path.read_bytes(), kind)
    for path in sorted((data / "sphz-v1").glob("*.sphz")):
        for kind in range(4):
            corpora.add("sphz", f"{path.name}-{kind}", path.read_bytes(), kind)
    corpora.add("cohorts", "list.tsv", b"id\tsurface\tsphere\ngroup\na\ta.ply\ts.ply\nb\t\"b \"\"c\"\".ply\"\ts.ply\n", 0)
    corpora.add("cohorts", "list.csv", b"id,surface,group\na,a.ply,1\nb,b.ply,2\n", 1)
    corpora.add("cohorts", "status.tsv", b"id\tstate\tmsd\txsd\tseconds\terror\toutput\na\tdone\t1e-5\t2e-4\t0.5\t\ta.npz\n"
                b"b\tfailed\t\t\t0.1\tno such file\t\n", 2)
    # A radius, because one of the formats can hold only a radius.
    (work / "radius.csv").write_text("radius\n" + "1\n" * 12)
    program("fit", "--sphere", "sphere.obj", "--surface", "radius.csv", "--max-degree", 1, "-o", "radius.npz", "-q", "--force")
    for number, name in enumerate(FORMATS):
        program("export", "radius.npz" if name == "aics" else "m.npz", "--to", name, "-o", f"x-{name}", "-q", "--force")
        for path in sorted(work.glob(f"x-{name}*")):
            for file in [path] if path.is_file() else sorted(path.iterdir()):
                corpora.add("exchange", f"{name}-{file.name}", file.read_bytes(), number)
                corpora.add("exchange", f"{name}-{file.name}-told", file.read_bytes(), len(FORMATS))
    pose = struct.pack("<24d", *[1.0, 0, 0, 0, 1, 0, 0, 0, 1] * 2, 0.1, 1, 3, 2, 1, 0)
    # For kinds from 62 on, the fuzz target also resumes the alignment from the poses.
    corpora.add("journals", "poses", pose * 4, 63)
    corpora.add("journals", "short", pose + pose[:100], 1)
    corpora.add("journals", "start", b"spharm group 1\r\n".ljust(64, b"\0"), 0)
    point = '{"label": "tip", "position": [1.5, -2, 3e1], "positionStatus": "defined"}'
    markups = f'{{"markups": [{{"coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": [{point}]}}]}}'
    corpora.add("landmarks", "a.mrk.json", markups.encode(), 0)
    corpora.add("landmarks", "a.json", b'[{"id": "A", "coordinates": [1, 2, 3]}]', 1)
    corpora.add("landmarks", "a.fcsv", b"# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n1,1,2,3,\"tip, left\"\n", 2)
    corpora.add("landmarks", "a.csv", b"name,x,y,z\nA,1,2,3\n", 3)
    corpora.add("landmarks", "a.tsv", b"A\t1\t2\t3\nB\t4\t5\t6\n", 4)
    # Inputs found by earlier runs, and formats that this script doesn't write.
    for path in sorted((data / "hostile").glob("*/*")):
        content = path.read_bytes()
        corpora.add(path.parent.name, f"hostile-{path.name}", content[:-1], content[-1])
    lines = [f'"{word}"' for word in WORDS]
    (folder / "words.dict").write_text("\n".join(lines) + "\n")


def cube():
    return bytes(1 if number == 13 else 0 for number in range(27))


def mgh(size=(4, 1, 1)):
    voxels = size[0] * size[1] * size[2]
    head = struct.pack(">7ih", 1, *size, 1, 0 if voxels == 27 else 3, 0, 1)
    head += struct.pack(">15f", 1, 1, 1, -1, 0, 0, 0, 0, -1, 0, 1, 0, 0, 0, 0)
    body = cube() if voxels == 27 else struct.pack(f">{voxels}f", *range(voxels))
    return gzip.compress(head.ljust(284, b"\0") + body, mtime=0)


def npy(descr, shape, body):
    descr = descr if descr.startswith("[") else f"'{descr}'"
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + body


def tiff():
    """Returns a page of 3 x 3 pixels of 8 bits, deflated."""
    strip = zlib.compress(cube()[9:18])
    tags = ((256, 3, 3), (257, 3, 3), (258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, 8), (277, 3, 1), (278, 3, 3), (279, 4, len(strip)))
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    at = 8 + len(strip) + len(strip) % 2
    return b"II*\0" + struct.pack("<I", at) + strip.ljust(at - 8, b"\0") + struct.pack("<H", len(tags)) + entries + bytes(4)


def members(path):
    """Returns the members of an archive as input for the target `archives`."""
    out = b""
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            body = archive.read(name)
            if name.removesuffix(".npy") in ARRAYS and len(body) < 1 << 16:
                out += struct.pack("<BH", ARRAYS.index(name.removesuffix(".npy")), len(body)) + body
    return out
