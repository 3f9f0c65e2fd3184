"""Writes mesh and signal files as other programs do, for the tests of crates/surface.

    make_mesh_fixtures.py OUT           write the files and expected.json to OUT (tests/data/meshes)
    make_mesh_fixtures.py --check DIR   read what `cargo run --example write_all` wrote to DIR

Files are written by the formats' own Python libraries if these can, otherwise by this script as exporters do.
expected.json holds the contents as read by those libraries (never by this project).

Made with Python 3.11 and nibabel==5.4.2 meshio==5.3.5 trimesh==5.2.0 vtk==9.7.2 pyvista==0.49.1 lib3mf==2.5.0 networkx==3.6.1
lxml==6.1.3 numpy==2.4.6. The dates in three files change with each run.
"""

import gzip
import json
import pathlib
import struct
import sys
import zipfile

import lib3mf
import meshio
import nibabel as nib
import numpy as np
import pyvista
import trimesh
import vtk
from nibabel.freesurfer import io as fsio
from nibabel.gifti import GiftiCoordSystem, GiftiDataArray, GiftiImage, GiftiMetaData
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

EXPECTED = {}


def icosahedron():
    """Returns a closed surface whose coordinates are all different, so that a swapped axis or row is noticed."""
    mesh = trimesh.creation.icosahedron()
    faces = np.array(mesh.faces, dtype=np.int32)
    vertices = np.array(mesh.vertices) * [61.7, 43.1, 29.3] + [-31.25, 17.5, 8.125]
    vertices += np.sin(np.arange(36.0)).reshape(12, 3)
    return vertices, faces


def box():
    """Returns a box of six quadrangles."""
    vertices = np.array([[x, y, z] for z in (0.5, 4.0) for y in (-1.25, 2.0) for x in (-3.0, 7.5)])
    vertices += 0.01 * np.arange(24.0).reshape(8, 3)
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6]])
    return vertices, quads


def fan(polygons):
    return [[int(p[0]), int(p[i]), int(p[i + 1])] for p in polygons for i in range(1, len(p) - 1)]


def expect_mesh(name, vertices, polygons, **more):
    faces = fan(polygons)
    EXPECTED[name] = {"vertices": np.asarray(vertices, dtype=np.float64).tolist(), "faces": faces, **more}


def expect_signal(name, values):
    values = np.asarray(values, dtype=np.float64)
    EXPECTED[name] = {"signal": values.reshape(len(values), -1).tolist()}


# GIfTI


def gifti_surface(vertices, faces, encoding, order="C", dtype=np.float32):
    meta = {"AnatomicalStructurePrimary": "CortexLeft", "GeometricType": "Anatomical", "Note": "a < b & \"c\""}
    system = GiftiCoordSystem(dataspace=1, xformspace=3, xform=np.diag([1.0, 1.0, 1.0, 1.0]) + np.eye(4, k=3) * 2.5)
    arrays = [
        GiftiDataArray(
            np.asarray(vertices, dtype=dtype),
            intent="NIFTI_INTENT_POINTSET",
            encoding=encoding,
            ordering=order,
            meta=GiftiMetaData(meta),
            coordsys=system,
            datatype=np.dtype(dtype).name,
        ),
        GiftiDataArray(
            faces, intent="NIFTI_INTENT_TRIANGLE", encoding=encoding, ordering=order, datatype="int32"
        ),
    ]
    return GiftiImage(darrays=arrays, meta=GiftiMetaData({"UserName": "tester"}))


def write_gifti(out):
    vertices, faces = icosahedron()
    save = lambda image, name: (out / name).write_bytes(image.to_bytes())
    for name, encoding, order, dtype in [
        ("ascii.surf.gii", "ASCII", "C", np.float32),
        ("base64.surf.gii", "Base64Binary", "C", np.float32),
        ("gzip.surf.gii", "GZipBase64Binary", "C", np.float32),
        ("column_major.surf.gii", "GZipBase64Binary", "F", np.float32),
        ("double.surf.gii", "GZipBase64Binary", "C", np.float64),
    ]:
        # nibabel's own writer refuses float64, which isn't in the standard; Workbench reads it.
        mode = {"mode": "force"} if dtype == np.float64 else {}
        image = gifti_surface(vertices, faces, encoding, order, dtype)
        (out / name).write_bytes(image.to_bytes(**mode))

    # nibabel reads big-endian files but labels every file that it writes little-endian, so the script swaps the bytes.
    swapped = gifti_surface(vertices, faces, "Base64Binary")
    text = swapped.to_bytes().decode()
    for array in swapped.darrays:
        little = data_text(array.data)
        assert little in text
        text = text.replace(little, data_text(array.data.astype(array.data.dtype.newbyteorder(">"))))
    text = text.replace("LittleEndian", "BigEndian")
    (out / "big_endian.surf.gii").write_bytes(text.encode())

    # The entire file gzipped, with a Data element in several pieces, CDATA, and the white space of other writers.
    text = gifti_surface(vertices, faces, "Base64Binary").to_bytes().decode()
    for array in gifti_surface(vertices, faces, "Base64Binary").darrays:
        little = data_text(array.data)
        text = text.replace(little, "\n" + "\n".join(little[i : i + 76] for i in range(0, len(little), 76)) + "\n")
    text = text.replace("<Name>UserName</Name>", "<Name><![CDATA[UserName]]></Name>\n  ")
    (out / "wrapped.surf.gii.gz").write_bytes(gzip.compress(text.encode(), mtime=0))

    for path in sorted(out.glob("*.surf.gii*")):
        image = nib.load(path)
        points, triangles = image.darrays
        written = vertices if path.name.startswith("double") else vertices.astype(np.float32)
        assert np.allclose(points.data, written, rtol=0, atol=1e-5 if path.name.startswith("ascii") else 0)
        assert np.array_equal(triangles.data, faces)
        expect_mesh(
            path.name,
            points.data,
            triangles.data,
            structure=points.meta["AnatomicalStructurePrimary"],
            note=points.meta["Note"],
            user=image.meta["UserName"],
            data_space=points.coordsys.dataspace,
            transformed_space=points.coordsys.xformspace,
            matrix=np.asarray(points.coordsys.xform).ravel().tolist(),
        )

    rng = np.random.default_rng(7)
    series = rng.normal(size=(12, 4)).astype(np.float32)
    frames = [GiftiDataArray(c, intent="NIFTI_INTENT_TIME_SERIES", datatype="float32") for c in series.T]
    save(GiftiImage(darrays=frames), "series.func.gii")
    save(GiftiImage(darrays=[GiftiDataArray(series[:, 0], intent="NIFTI_INTENT_SHAPE")]), "one.shape.gii")
    counts = (np.arange(24) * 9 % 251).reshape(12, 2).astype(np.uint8)
    # Not as text: nibabel writes and reads text row by row, whatever order it declares.
    array = GiftiDataArray(counts, intent="NIFTI_INTENT_NONE", ordering="F", encoding="Base64Binary", datatype="uint8")
    save(GiftiImage(darrays=[array]), "counts.func.gii")
    for name in ["series.func.gii", "one.shape.gii", "counts.func.gii"]:
        arrays = [np.asarray(a.data, dtype=np.float64).reshape(12, -1) for a in nib.load(out / name).darrays]
        expect_signal(name, np.hstack(arrays))


def data_text(data):
    import base64

    return base64.b64encode(data.tobytes()).decode()


# FreeSurfer


def write_freesurfer(out):
    vertices, faces = icosahedron()
    volume = {
        "head": np.array([2, 0, 20], dtype=np.int32),
        "valid": "1  # volume info valid",
        "filename": "../mri/filled.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.array([1.0, 1.0, 1.0]),
        "xras": np.array([-1.0, 0.0, 0.0]),
        "yras": np.array([0.0, 0.0, -1.0]),
        "zras": np.array([0.0, 1.0, 0.0]),
        "cras": np.array([5.25, -17.5, 18.125]),
    }
    stamp = "created by tester on a day"
    fsio.write_geometry(out / "lh.pial", vertices, faces, create_stamp=stamp, volume_info=volume)
    fsio.write_geometry(out / "rh.white", vertices, faces, create_stamp=stamp)
    raw = (out / "lh.pial").read_bytes()
    bare = len((out / "rh.white").read_bytes())
    points, triangles = fsio.read_geometry(out / "lh.pial")
    expect_mesh("lh.pial", points, triangles, stamp=stamp, footer=list(raw[bare:]))
    points, triangles = fsio.read_geometry(out / "rh.white")
    expect_mesh("rh.white", points, triangles, stamp=stamp, footer=None)
    fsio.write_morph_data(out / "lh.thickness", np.cos(np.arange(12.0)), fnum=20)
    expect_signal("lh.thickness", fsio.read_morph_data(out / "lh.thickness"))


# Text and exchange formats


def polygons_of(mesh):
    return [list(polygon) for block in mesh.cells for polygon in block.data]


def write_obj(out):
    vertices, quads = box()
    lines = ["# by hand, as exporters write", "mtllib none.mtl", "o box"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    # As many texture coordinates and normals as vertices, because meshio requires it; with other indices than the
    # vertices.
    lines += [f"vt 0 {i / 8}" for i in range(8)] + [f"vn 0 0 {i}" for i in range(8)] + ["s off", "usemtl none"]
    full = lines + ["f " + " ".join(f"{i + 1}/{k + 1}/{8 - k}" for k, i in enumerate(q)) for q in quads]
    (out / "quads.obj").write_text("\r\n".join(full) + "\r\n")
    mesh = meshio.read(out / "quads.obj")
    expect_mesh("quads.obj", mesh.points, polygons_of(mesh))

    vertices, faces = icosahedron()
    lines = [f"v {x!r} {y!r} {z!r} 0.5 0.5 0.5" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(int(i) - 12) for i in f) for f in faces]
    (out / "negative.obj").write_text("\n".join(lines))
    mesh = trimesh.load(out / "negative.obj", process=False, maintain_order=True)
    expect_mesh("negative.obj", mesh.vertices, mesh.faces)


def vtk_polydata(vertices, polygons):
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
    cells = vtk.vtkCellArray()
    for polygon in polygons:
        cells.InsertNextCell(len(polygon), [int(i) for i in polygon])
    data = vtk.vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    scalars = numpy_to_vtk(np.arange(len(vertices), dtype=np.float32), deep=True)
    scalars.SetName("index")
    scalars.SetComponentName(0, "a component")
    data.GetPointData().SetScalars(scalars)
    field = numpy_to_vtk(np.array([1.5, 2.5]), deep=True)
    field.SetName("time")
    data.GetFieldData().AddArray(field)
    return data


def from_polydata(data):
    points = vtk_to_numpy(data.GetPoints().GetData())
    ids, polygons = vtk.vtkIdList(), []
    cells = data.GetPolys()
    cells.InitTraversal()
    while cells.GetNextCell(ids):
        polygons.append([ids.GetId(i) for i in range(ids.GetNumberOfIds())])
    return points, polygons


def read_with(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return from_polydata(reader.GetOutput())


def write_ply(out):
    vertices, quads = box()
    mesh = meshio.Mesh(vertices, [("quad", quads)], point_data={"weight": np.arange(8.0)})
    meshio.write(out / "ascii.ply", mesh, binary=False)
    meshio.write(out / "little.ply", mesh, binary=True)
    for name in ["ascii.ply", "little.ply"]:
        mesh = meshio.read(out / name)
        expect_mesh(name, mesh.points, polygons_of(mesh))
    writer = vtk.vtkPLYWriter()
    writer.SetInputData(vtk_polydata(vertices.astype(np.float32), quads))
    writer.SetFileTypeToBinary()
    writer.SetDataByteOrderToBigEndian()
    writer.SetFileName(str(out / "big.ply"))
    writer.Write()
    expect_mesh("big.ply", *read_with(vtk.vtkPLYReader(), out / "big.ply"))


# A concave quadrangle of the tube's vertices, and its triangles on both sides of the inner diagonal.
CONCAVE = [0, 2, 11, 4]
CONCAVE_CUT = [[4, 0, 2], [2, 11, 4]]


def strips():
    """Returns two strips of an open tube, the second with a corner repeated, and their vertices."""
    angle = np.arange(12.0) * np.pi / 5
    vertices = np.stack([3 * np.cos(angle), 2 * np.sin(angle), np.arange(12.0) * 0.75], axis=1)
    return vertices, [[0, 1, 2, 3, 4, 5, 6], [6, 5, 7, 7, 8, 9, 10, 11]]


def write_strips(out):
    vertices, lists = strips()
    data = vtk_polydata(vertices, [CONCAVE])
    cells = vtk.vtkCellArray()
    for corners in lists:
        cells.InsertNextCell(len(corners), corners)
    data.SetStrips(cells)
    writer = vtk.vtkPolyDataWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(out / "strips.vtk"))
    writer.SetFileType(vtk.VTK_BINARY)
    writer.Write()
    reader = vtk.vtkPolyDataReader()
    reader.SetFileName(str(out / "strips.vtk"))
    points, triangles = strip_triangles(reader)
    expect_mesh("strips.vtk", points, CONCAVE_CUT + triangles)

    # These libraries neither write nor read strips in PLY. The triangles are those that VTK makes of the same strips.
    for name, kind in [("strips_ascii.ply", "ascii"), ("strips_big.ply", "binary_big_endian")]:
        numbers = [i for corners in lists for i in [*corners, -1]][:-1]
        head = f"ply\nformat {kind} 1.0\nelement vertex 12\n" + "".join(f"property double {x}\n" for x in "xyz")
        head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        if kind == "ascii":
            lines = [" ".join(map(repr, v)) for v in vertices.tolist()] + [" ".join(map(str, [len(numbers), *numbers]))]
            body = ("\n".join(lines) + "\n").encode()
        else:
            body = vertices.astype(">f8").tobytes() + np.array([len(numbers), *numbers], dtype=">i4").tobytes()
        (out / name).write_bytes(head.encode() + body)
        expect_mesh(name, vertices, triangles)


def strip_triangles(reader):
    """Returns the points of a VTK reader and the triangles that VTK makes of its strips, without repeated corners."""
    reader.Update()
    data = vtk.vtkPolyData()
    data.SetPoints(reader.GetOutput().GetPoints())
    data.SetStrips(reader.GetOutput().GetStrips())
    cut = vtk.vtkTriangleFilter()
    cut.SetInputData(data)
    cut.Update()
    points, triangles = from_polydata(cut.GetOutput())
    return points, proper(triangles)


def proper(triangles):
    return [list(map(int, t)) for t in triangles if len(set(map(int, t))) == 3]


def write_grids(out):
    vertices, quads = box()
    top = [[4, 5, 7], [4, 7, 6]]
    cells = [("quad", quads[[0, 2, 3]]), ("triangle", np.array(top)), ("vertex", np.array([[1]])), ("line", np.array([[0, 7]]))]
    for name, version, binary in [("grid42.vtk", "4.2", True), ("grid51.vtk", "5.1", False)]:
        meshio.vtk.write(out / name, meshio.Mesh(vertices, cells), fmt_version=version, binary=binary)
        reader = vtk.vtkUnstructuredGridReader()
        reader.SetFileName(str(out / name))
        reader.Update()
        grid = reader.GetOutput()
        flat = [i for i in range(grid.GetNumberOfCells()) if grid.GetCell(i).GetCellDimension() == 2]
        expect_mesh(name, vtk_to_numpy(grid.GetPoints().GetData()), [cell_corners(grid, i) for i in flat])


def cell_corners(grid, number):
    ids = vtk.vtkIdList()
    grid.GetCellPoints(number, ids)
    return [ids.GetId(i) for i in range(ids.GetNumberOfIds())]


def write_off(out):
    vertices, faces = icosahedron()
    meshio.write(out / "plain.off", meshio.Mesh(vertices, [("triangle", faces)]))
    mesh = meshio.read(out / "plain.off")
    expect_mesh("plain.off", mesh.points, polygons_of(mesh))
    vertices, quads = box()
    lines = ["OFF # by hand", "", "8 6 12"] + [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"4 {a} {b} {c} {d} 0.1 0.2 0.3" for a, b, c, d in quads]
    (out / "quads.off").write_text("\n".join(lines) + "\n")
    expect_mesh("quads.off", vertices, quads)


def write_stl(out):
    vertices, faces = icosahedron()
    mesh = meshio.Mesh(vertices.astype(np.float32), [("triangle", faces)])
    meshio.write(out / "binary.stl", mesh, binary=True)
    meshio.write(out / "text.stl", mesh, binary=False)
    # Many programs write binary files that begin with the word `solid`.
    raw = (out / "binary.stl").read_bytes()
    (out / "solid_binary.stl").write_bytes(b"solid" + raw[5:])
    for name in ["binary.stl", "text.stl"]:
        soup = trimesh.load(out / name, process=False)
        EXPECTED[name] = {"corners": np.asarray(soup.triangles, dtype=np.float64).tolist(), "unique": 12}
    EXPECTED["solid_binary.stl"] = EXPECTED["binary.stl"]


def write_vtk(out):
    for name, binary, version in [
        ("ascii42.vtk", False, 42),
        ("binary42.vtk", True, 42),
        ("ascii51.vtk", False, 51),
        ("binary51.vtk", True, 51),
    ]:
        vertices, polygons = box() if version == 51 else icosahedron()
        writer = vtk.vtkPolyDataWriter()
        writer.SetInputData(vtk_polydata(vertices, polygons))
        writer.SetFileVersion(version)
        writer.SetFileType(vtk.VTK_BINARY if binary else vtk.VTK_ASCII)
        writer.SetFileName(str(out / name))
        writer.Write()
        expect_mesh(name, *read_with(vtk.vtkPolyDataReader(), out / name))


def write_vtk_xml(out):
    vertices, faces = icosahedron()
    tube, lists = strips()
    for name, mode, compressor, wide, big, offsets in [
        ("ascii.vtp", "Ascii", "None", False, False, False),
        ("inline.vtp", "Binary", "ZLib", False, False, False),
        ("raw.vtp", "Appended", "LZ4", True, False, False),
        ("raw_big.vtp", "Appended", "None", False, True, False),
        ("base64.vtp", "Appended", "ZLib", True, True, True),
    ]:
        data = vtk_polydata(vertices.astype(np.float32), faces)
        if mode == "Ascii":
            data = vtk_polydata(*box())
        if mode == "Binary":
            data = vtk_polydata(tube, [CONCAVE])
            cells = vtk.vtkCellArray()
            for corners in lists:
                cells.InsertNextCell(len(corners), corners)
            data.SetStrips(cells)
        writer = vtk.vtkXMLPolyDataWriter()
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
        writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
        writer.SetByteOrderToBigEndian() if big else writer.SetByteOrderToLittleEndian()
        writer.SetEncodeAppendedData(offsets)
        # Small blocks, so that an array has several.
        writer.SetBlockSize(128)
        writer.SetInputData(data)
        writer.SetFileName(str(out / name))
        writer.Write()
        points, polygons = read_with(vtk.vtkXMLPolyDataReader(), out / name)
        if mode == "Binary":
            reader = vtk.vtkXMLPolyDataReader()
            reader.SetFileName(str(out / name))
            polygons = CONCAVE_CUT + strip_triangles(reader)[1]
        expect_mesh(name, points, polygons)

    # The same piece twice.
    text = (out / "ascii.vtp").read_text()
    start, end = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    (out / "pieces.vtp").write_text(text[:end] + "\n" + text[start:end] + text[end:])
    expect_mesh("pieces.vtp", *read_with(vtk.vtkXMLPolyDataReader(), out / "pieces.vtp"))

    vertices, quads = box()
    cells = [("quad", quads[[0, 2, 3]]), ("triangle", np.array([[4, 5, 7], [4, 7, 6]])), ("line", np.array([[0, 7]]))]
    meshio.write(out / "grid.vtu", meshio.Mesh(vertices, cells))
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(out / "grid.vtu"))
    reader.Update()
    grid = reader.GetOutput()
    flat = [i for i in range(grid.GetNumberOfCells()) if grid.GetCell(i).GetCellDimension() == 2]
    expect_mesh("grid.vtu", vtk_to_numpy(grid.GetPoints().GetData()), [cell_corners(grid, i) for i in flat])


def write_gltf(out):
    vertices, quads = box()
    triangles = np.array(fan(quads))
    # Each triangle with its own vertices and normals.
    split = trimesh.Trimesh(vertices[triangles.ravel()], np.arange(36).reshape(12, 3), process=False)
    (out / "split.glb").write_bytes(split.export(file_type="glb", include_normals=True))

    # Two meshes in nested nodes, one of them turned by 90 degrees and one a mirror image.
    vertices, faces = icosahedron()
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(vertices, faces, process=False), node_name="a", geom_name="a")
    turned = [[0, -2, 0, 512], [2, 0, 0, 0.5], [0, 0, 2, 0], [0, 0, 0, 1]]
    scene.add_geometry(split, node_name="b", geom_name="b", parent_node_name="a", transform=np.array(turned, dtype=float))
    mirror = np.diag([-1.0, 1, 1, 1]) + 64 * np.eye(4, k=2)
    scene.graph.update("c", "b", matrix=mirror, geometry="a")
    (out / "scene.glb").write_bytes(scene.export(file_type="glb"))
    files = trimesh.Trimesh(vertices, faces, process=False).scene().export(file_type="gltf", embed_buffers=True)
    (out / "embedded.gltf").write_bytes(files["model.gltf"])
    (out / "modes.glb").write_bytes(modes())

    for name, nodes in [("split.glb", None), ("scene.glb", "abc"), ("embedded.gltf", None), ("modes.glb", None)]:
        reader = vtk.vtkGLTFReader()
        reader.SetFileName(str(out / name))
        reader.Update()
        corners = np.concatenate([corners_of(part) for part in leaves(reader.GetOutput())])
        if nodes:
            # VTK rounds positions that it moves to 32 bits, and doesn't turn the triangles of a mirror image.
            scene = trimesh.load_scene(out / name, process=False)
            exact = np.concatenate([placed(scene, node).triangles for node in nodes])
            assert np.allclose(np.sort(exact, axis=1), np.sort(corners, axis=1), rtol=1e-6)
            corners = exact
        unique = len(np.unique(corners.reshape(-1, 3), axis=0))
        EXPECTED[name] = {"corners": corners.tolist(), "unique": unique}


def placed(scene, node):
    transform, geometry = scene.graph[node]
    return scene.geometry[geometry].copy().apply_transform(transform)


def leaves(blocks):
    iterator = blocks.NewIterator()
    iterator.InitTraversal()
    while not iterator.IsDoneWithTraversal():
        yield iterator.GetCurrentDataObject()
        iterator.GoToNextItem()


def corners_of(data):
    """Returns the corners of a VTK object's polygons and strips as triangles, without repeated corners."""
    cut = vtk.vtkTriangleFilter()
    cut.SetInputData(data)
    cut.PassLinesOff()
    cut.PassVertsOff()
    cut.Update()
    points, triangles = from_polydata(cut.GetOutput())
    return np.asarray(points, dtype=np.float64)[np.array(proper(triangles), dtype=int).reshape(-1, 3)]


def modes():
    """Returns a GLB file with every way to store triangles: in order, indices of each size, a strip, a fan, rows with
    padding, and sparse positions."""
    rng = np.random.default_rng(3)
    bin, views, accessors, primitives = b"", [], [], []

    def view(data, **more):
        nonlocal bin
        bin += b"\0" * (-len(bin) % 4)
        views.append({"buffer": 0, "byteOffset": len(bin), "byteLength": len(data), **more})
        bin += data
        return len(views) - 1

    def accessor(data, kind, code, count, stride=None, **more):
        stride = {} if stride is None else {"byteStride": stride}
        accessors.append({"bufferView": view(data, **stride), "componentType": code, "count": count, "type": kind, **more})
        return len(accessors) - 1

    def positions(count, padding=0):
        points = rng.normal(size=(count, 3)).astype("<f4")
        rows = b"".join(row.tobytes() + b"\x7f" * padding for row in points)
        bounds = {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
        return accessor(rows, "VEC3", 5126, count, 12 + padding if padding else None, **bounds)

    def primitive(points, mode=4, dtype=None, indices=()):
        entry = {"attributes": {"POSITION": points}, "mode": mode}
        if dtype:
            code = {"u1": 5121, "<u2": 5123, "<u4": 5125}[dtype]
            entry["indices"] = accessor(np.array(indices, dtype=dtype).tobytes(), "SCALAR", code, len(indices))
        primitives.append({"primitives": [entry]})

    primitive(positions(6))
    primitive(positions(4, padding=8), dtype="u1", indices=[0, 1, 2, 2, 1, 3])
    primitive(positions(4), dtype="<u4", indices=[3, 2, 1, 0, 1, 2])
    primitive(positions(6), mode=5)
    primitive(positions(5), mode=5, dtype="<u2", indices=[0, 1, 2, 3, 4])
    primitive(positions(5), mode=6, dtype="u1", indices=[4, 0, 1, 2, 3])
    primitive(positions(3), mode=1)
    sparse = positions(3)
    # VTK requires the offsets, which the specification makes optional.
    accessors[sparse]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": view(np.array([0, 2], dtype="<u2").tobytes()), "byteOffset": 0, "componentType": 5123},
        "values": {"bufferView": view(np.arange(6, dtype="<f4").tobytes()), "byteOffset": 0},
    }
    primitive(sparse)
    document = {
        "asset": {"version": "2.0", "generator": "by hand"},
        "scenes": [{"nodes": list(range(len(primitives)))}],
        "nodes": [{"mesh": i} for i in range(len(primitives))],
        "meshes": primitives,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(bin)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    bin += b"\0" * (-len(bin) % 4)
    head = b"glTF" + struct.pack("<II", 2, 28 + len(text) + len(bin))
    return head + struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(bin)) + b"BIN\0" + bin


def write_3mf(out):
    vertices, faces = icosahedron()
    (out / "object.3mf").write_bytes(trimesh.Trimesh(vertices, faces, process=False).export(file_type="3mf"))
    points = trimesh.load(out / "object.3mf", process=False, force="mesh")
    expect_mesh("object.3mf", points.vertices, points.faces)

    # An assembly in two parts, as slicers write: a mesh of another part twice, once turned and once as a mirror image,
    # a support, and a mesh of the root part.
    core = 'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"'
    production = 'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"'
    corners, quads = box()
    # lib3mf has 32 bits.
    mesh = mesh_3mf(np.round(corners * 64) / 64, fan(quads))
    tetrahedron = mesh_3mf(np.eye(4)[:, :3] * 0.5 + 100, [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
    part = f'<model {core}><resources><object id="7">{mesh}</object></resources><build/></model>'
    root = (
        f'<model unit="meter" {core} {production} requiredextensions="p"><resources>'
        f'<object id="1" type="model">{tetrahedron}</object><object id="2" type="support">{mesh}</object>'
        '<object id="3"><components><component p:path="/3D/Objects/box.model" objectid="7" transform="0 2 0 -2 0 0 0 0 2 512 0.5 0"/>'
        '<component objectid="1"/></components></object></resources><build><item objectid="3" transform="-1 0 0 0 1 0 0 0 1 0 0 64"/>'
        '<item objectid="2"/><item objectid="1"/></build></model>'
    )
    model_type = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    relation = f'<Relationship Target="/3D/root.model" Id="a" Type="{model_type}"/>'
    inner = f'<Relationship Target="/3D/Objects/box.model" Id="b" Type="{model_type}"/>'
    space = 'xmlns="http://schemas.openxmlformats.org/package/2006/relationships"'
    types = (
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" ContentType='
        '"application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType='
        '"application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
    )
    with zipfile.ZipFile(out / "build.3mf", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in [
            ("[Content_Types].xml", types),
            ("_rels/.rels", f"<Relationships {space}>{relation}</Relationships>"),
            ("3D/root.model", root),
            ("3D/_rels/root.model.rels", f"<Relationships {space}>{inner}</Relationships>"),
            ("3D/Objects/box.model", part),
        ]:
            archive.writestr(zipfile.ZipInfo(name), '<?xml version="1.0"?>' + text, zipfile.ZIP_DEFLATED)
    corners, unique = lib3mf_corners(out / "build.3mf")
    EXPECTED["build.3mf"] = {"corners": corners.tolist(), "unique": unique}


def lib3mf_corners(path):
    """Returns the corners of the triangles that lib3mf finds in a build, and the number of different ones."""
    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))

    def matrix(transform):
        rows = np.array([list(row) for row in transform.Fields], dtype=np.float64)
        return np.hstack([rows, [[0], [0], [0], [1]]])

    def triangles(found, placement):
        if found.GetType() == lib3mf.ObjectType.Support:
            return
        number = found.GetResourceID()
        if not found.IsMeshObject():
            parts = model.GetComponentsObjectByID(number)
            for i in range(parts.GetComponentCount()):
                part = parts.GetComponent(i)
                yield from triangles(part.GetObjectResource(), matrix(part.GetTransform()) @ placement)
            return
        mesh = model.GetMeshObjectByID(number)
        points = np.array([list(v.Coordinates) + [1.0] for v in mesh.GetVertices()]) @ placement
        faces = np.array([list(t.Indices) for t in mesh.GetTriangleIndices()])
        # A mirror image is turned, so that its outer side stays outside.
        yield points[:, :3][faces if np.linalg.det(placement) > 0 else faces[:, [0, 2, 1]]]

    corners, items = [], model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        corners += triangles(item.GetObjectResource(), matrix(item.GetObjectTransform()))
    corners = np.concatenate(corners)
    # Each object has its own vertices, even where they touch those of others.
    return corners, 8 + 4 + 4


def mesh_3mf(vertices, faces):
    points = "".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in np.asarray(vertices).tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    return f"<mesh><vertices>{points}</vertices><triangles>{triangles}</triangles></mesh>"


def write_vrml(out):
    window, renderer = vtk.vtkRenderWindow(), vtk.vtkRenderer()
    window.SetOffScreenRendering(True)
    window.AddRenderer(renderer)
    vertices, faces = icosahedron()
    corners, quads = box()
    for data, place, scale in [(vtk_polydata(vertices, faces), (0, 0, 0), 1), (vtk_polydata(corners.astype(np.float32), quads), (512, 0, 64), 2)]:
        mapper, actor = vtk.vtkPolyDataMapper(), vtk.vtkActor()
        mapper.SetInputData(data)
        mapper.ScalarVisibilityOff()
        actor.SetMapper(mapper)
        actor.SetPosition(*place)
        actor.SetScale(scale, scale, scale)
        renderer.AddActor(actor)
    exporter = vtk.vtkVRMLExporter()
    exporter.SetRenderWindow(window)
    exporter.SetFileName(str(out / "scene.wrl"))
    exporter.Write()

    importer = vtk.vtkVRMLImporter()
    importer.SetFileName(str(out / "scene.wrl"))
    importer.Update()
    points, polygons = [], []
    for actor in importer.GetRenderer().GetActors():
        actor.GetMapper().Update()
        part, lists = from_polydata(actor.GetMapper().GetInput())
        matrix = np.array([[actor.GetMatrix().GetElement(i, k) for k in range(4)] for i in range(4)])
        polygons += [[i + len(points) for i in corners] for corners in lists]
        points += (np.asarray(part, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).tolist()
    # VTK reads 32 bits; the positions are those written, in their places.
    wanted = np.concatenate([vertices, 2 * corners.astype(np.float32).astype(np.float64) + [512, 0, 64]])
    assert np.allclose(points, wanted, rtol=1e-6)
    expect_mesh("scene.wrl", wanted, polygons)


def write_tables(out):
    values = np.sin(np.arange(36.0)).reshape(12, 3)
    np.savetxt(out / "named.csv", values, delimiter=",", header="thickness,area,curv", comments="", fmt="%.17g")
    np.savetxt(out / "plain.tsv", values[:, 0], delimiter="\t", fmt="%.17g")
    expect_signal("named.csv", np.loadtxt(out / "named.csv", delimiter=",", skiprows=1))
    expect_signal("plain.tsv", np.loadtxt(out / "plain.tsv", delimiter="\t"))


# Checks files written by the project


def check(directory):
    directory = pathlib.Path(directory)
    fixtures = pathlib.Path(__file__).parent.parent / "data" / "meshes"
    truth = json.loads((fixtures / "expected.json").read_text())["double.surf.gii"]
    vertices, faces = np.array(truth["vertices"]), np.array(truth["faces"])
    single = vertices.astype(np.float32).astype(np.float64)
    checked = 0

    def same(name, found_vertices, found_faces, wanted=single):
        nonlocal checked
        assert np.array_equal(np.asarray(found_vertices, dtype=np.float64), wanted), name
        assert np.array_equal(np.asarray(found_faces), faces), name
        checked += 1

    for name, wanted in [("out.surf.gii", single), ("out_double.surf.gii", vertices), ("out.surf.gii.gz", single)]:
        image = nib.load(directory / name)
        points, triangles = image.agg_data(("pointset", "triangle"))
        same(name, points, triangles, wanted)
        meta = image.darrays[0].meta
        assert meta["AnatomicalStructurePrimary"] == truth["structure"], name
        assert meta["Note"] == truth["note"] and image.meta["UserName"] == truth["user"], name
        assert np.array_equal(np.ravel(image.darrays[0].coordsys.xform), truth["matrix"]), name
    same("lh.out", *fsio.read_geometry(directory / "lh.out"))
    same("out.obj", *mesh_of(meshio.read(directory / "out.obj")), vertices)
    same("out.obj by trimesh", *trimesh_of(directory / "out.obj"), vertices)
    same("out.off", *trimesh_of(directory / "out.off"), vertices)
    same("out.ply", *mesh_of(meshio.read(directory / "out.ply")))
    same("out.ply by trimesh", *trimesh_of(directory / "out.ply"))
    same("out_double.ply", *mesh_of(meshio.read(directory / "out_double.ply")), vertices)
    same("out.vtk", *read_with(vtk.vtkPolyDataReader(), directory / "out.vtk"), vertices)
    same("out.vtp", *read_with(vtk.vtkXMLPolyDataReader(), directory / "out.vtp"), vertices)
    same("out.vtp by PyVista", pyvista.read(directory / "out.vtp").points, pyvista.read(directory / "out.vtp").regular_faces, vertices)
    same("out.glb", *scene_of(directory / "out.glb"))
    reader = vtk.vtkGLTFReader()
    reader.SetFileName(str(directory / "out.glb"))
    reader.Update()
    same("out.glb by VTK", *from_polydata(next(leaves(reader.GetOutput()))))
    same("out.3mf", *scene_of(directory / "out.3mf"), vertices)
    # lib3mf has 32 bits.
    same("out.3mf by lib3mf", *lib3mf_mesh(directory / "out.3mf"))
    soup = trimesh.load(directory / "out.stl", process=False)
    assert np.array_equal(np.asarray(soup.triangles, dtype=np.float64), single[faces])
    normals = np.cross(single[faces][:, 1] - single[faces][:, 0], single[faces][:, 2] - single[faces][:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    written = meshio.read(directory / "out.stl").cell_data
    stored = np.frombuffer((directory / "out.stl").read_bytes()[84:], dtype=[("n", "<f4", 3), ("rest", "V38")])["n"]
    assert np.allclose(stored, normals, atol=1e-6), written
    checked += 1

    colored = meshio.read(directory / "attributes.ply")
    same("attributes.ply", *mesh_of(colored))
    assert np.array_equal(colored.point_data["error"], (np.arange(12) / 8).astype(np.float32))
    assert np.array_equal(colored.point_data["red"], np.arange(12)) and np.all(colored.point_data["blue"] == 7)

    valued = pyvista.read(directory / "attributes.vtp")
    same("attributes.vtp", valued.points, valued.regular_faces, vertices)
    assert np.array_equal(valued.point_data["error"], np.arange(12) / 8)

    signal = np.arange(36.0).reshape(12, 3) / 7.0
    arrays = nib.load(directory / "out.func.gii").agg_data()
    assert np.array_equal(np.array(arrays).T, signal.astype(np.float32))
    assert np.array_equal(np.loadtxt(directory / "out.csv", delimiter=","), signal)
    assert np.array_equal(fsio.read_morph_data(directory / "lh.out.curv"), signal[:, 0].astype(np.float32))
    print(f"{checked + 3} files agree")


def mesh_of(mesh):
    return mesh.points, polygons_of(mesh)


def scene_of(path):
    (mesh,) = trimesh.load_scene(path, process=False).geometry.values()
    return mesh.vertices, mesh.faces


def lib3mf_mesh(path):
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    meshes = model.GetMeshObjects()
    assert meshes.MoveNext()
    mesh = meshes.GetCurrentMeshObject()
    assert mesh.IsManifoldAndOriented()
    return [list(v.Coordinates) for v in mesh.GetVertices()], [list(t.Indices) for t in mesh.GetTriangleIndices()]


def trimesh_of(path):
    mesh = trimesh.load(path, process=False, maintain_order=True)
    return mesh.vertices, mesh.faces


def main():
    if len(sys.argv) == 3 and sys.argv[1] == "--check":
        return check(sys.argv[2])
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    for write in [write_gifti, write_freesurfer, write_obj, write_ply, write_off, write_stl, write_vtk, write_strips, write_grids, write_vtk_xml, write_gltf, write_3mf, write_vrml, write_tables]:
        write(out)
    (out / "expected.json").write_text(json.dumps(EXPECTED, indent=None, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
