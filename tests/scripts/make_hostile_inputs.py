#!/usr/bin/env python3
"""Makes those inputs of tests/data/hostile that a script can describe: files that claim wrong sizes, name other files,
nest, loop, or expand. Each input is a file and one more byte, which selects the file's name or the repair; see
`fuzz/src/readers/mod.rs`. Inputs found by the fuzzer, and `sound.*`, are stored beside them unchanged.
"""

import base64
import gzip
import io
import struct
import zipfile
import zlib
from pathlib import Path

DATA = Path(__file__).resolve().parent.parent / "data"
OUT = DATA / "hostile"
HUGE = 2**64 - 1


def put(reader, name, data, choice=0):
    (OUT / reader).mkdir(parents=True, exist_ok=True)
    data = data.encode() if isinstance(data, str) else bytes(data)
    (OUT / reader / name).write_bytes(data + bytes([choice]))


def changed(data, at, value):
    return data[:at] + value + data[at + len(value):]


def npy(header, body=b""):
    text = header.encode() + b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + body


def dictionary(descr, shape):
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"


def archive(members, method=zipfile.ZIP_STORED):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), data, method)
    return out.getvalue()


def surfaces():
    for name, header in (("most", HUGE), ("4G", 2**32 - 1), ("2G", 2**31)):
        put("surfaces", f"vertices-{name}.ply", f"ply\nformat binary_little_endian 1.0\nelement vertex {header}\nproperty float x\n"
            "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n" + "a" * 40, 2)
        put("surfaces", f"vertices-{name}.off", f"OFF\n{header} {header} 0\n0 0 0\n", 3)
        put("surfaces", f"points-{name}.vtk", f"# vtk DataFile Version 4.2\nx\nBINARY\nDATASET POLYDATA\nPOINTS {header} double\n", 5)
        put("surfaces", f"dim-{name}.gii", f'<GIFTI Version="1.0" NumberOfDataArrays="1"><DataArray Intent="NIFTI_INTENT_POINTSET" DataType='
            f'"NIFTI_TYPE_FLOAT64" ArrayIndexingOrder="RowMajorOrder" Dimensionality="2" Dim0="{header}" Dim1="3" Encoding="ASCII" '
            'Endian="LittleEndian"><Data>1 2 3</Data></DataArray></GIFTI>', 7)
    put("surfaces", "index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 18446744073709551615\nf -4 -1 -2\nf 0 1 2\n", 1)
    put("surfaces", "empty-face.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf\nf 1\nf 1 2\nf 1 1 1\n", 1)
    put("surfaces", "triangles.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), 4)
    put("surfaces", "external.gii", '<GIFTI><DataArray DataType="NIFTI_TYPE_FLOAT32" Dimensionality="1" Dim0="3" Encoding="ExternalFileBinary" '
        'ExternalFileName="/etc/passwd" ExternalFileOffset="0"><Data/></DataArray></GIFTI>', 7)
    put("surfaces", "entity.gii", '<!DOCTYPE GIFTI [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;"><!ENTITY x SYSTEM "file:///etc/'
        'passwd">]><GIFTI><MetaData>&b;&x;</MetaData></GIFTI>', 7)
    put("surfaces", "nested.gii", "<GIFTI>" + "<DataArray>" * 1500, 7)
    inner = zlib.compress(bytes(1 << 20))
    put("surfaces", "swells.gii", b'<GIFTI><DataArray DataType="NIFTI_TYPE_UINT8" Dimensionality="1" Dim0="1099511627776" Encoding='
        b'"GZipBase64Binary" Endian="LittleEndian"><Data>' + base64.b64encode(inner) + b"</Data></DataArray></GIFTI>", 8)
    put("surfaces", "swells.gz", gzip.compress(gzip.compress(bytes(1 << 22), mtime=0), mtime=0), 0)
    put("surfaces", "cut.gz", gzip.compress(b"OFF\n3 1 0\n", mtime=0)[:-6], 3)
    put("surfaces", "size.mgh", struct.pack(">7ih", 1, 2**31 - 1, 2**31 - 1, 2**31 - 1, 2**31 - 1, 3, 0, 0) + bytes(300), 9)
    put("surfaces", "negative.mgh", struct.pack(">7ih", 1, -1, 1, 1, 1, 3, 0, 0) + bytes(300), 9)
    put("surfaces", "wide.csv", "," * 4000 + "\n" + "1," * 4000, 10)
    put("surfaces", "nan.csv", "a\n1\nnan\ninf\n1e999\n", 10)
    put("surfaces", "pial", b"\xff\xff\xfex\n\n" + struct.pack(">ii", 2**31 - 1, -1) + bytes(36), 12)
    put("surfaces", "curv", b"\xff\xff\xff" + struct.pack(">iii", -1, 2**31 - 1, 2**31 - 1) + bytes(8), 13)
    scenes()


def glb(text, data=b""):
    text, data = text.encode() + b" " * (-len(text) % 4), data + bytes(-len(data) % 4)
    head = b"glTF" + struct.pack("<III", 2, 28 + len(text) + len(data), len(text)) + b"JSON"
    return head + text + struct.pack("<I", len(data)) + b"BIN\0" + data


def scenes():
    scene = ('{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{0}}}],"bufferViews":[{{"buffer":0,"byteLength":{0},"byteOffset":{1}}}],'
             '"accessors":[{{{2}"componentType":5126,"count":{3},"type":"VEC3"}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],'
             '"nodes":[{4}]}}')
    view, node = '"bufferView":0,', '{"mesh":0}'
    for name, words in (
        ("count", (36, 0, view, HUGE, node)), ("view", (36, HUGE, view, 3, node)), ("buffer", (HUGE, 0, view, 3, node)),
        ("zeros", (36, 0, "", 2**31, node)), ("loop", (36, 0, view, 3, '{"children":[1]},{"children":[1],"mesh":0}')),
        ("children", (36, 0, view, 3, f'{{"children":[{HUGE}]}}')),
    ):
        put("surfaces", f"{name}.glb", glb(scene.format(*words), bytes(36)), 14)
    sparse = ('"sparse":{"count":4294967295,"indices":{"bufferView":0,"componentType":5125},"values":{"bufferView":0}},')
    put("surfaces", "sparse.glb", glb(scene.format(36, 0, sparse, 4294967295, node), bytes(36)), 14)
    put("surfaces", "length.glb", b"glTF" + struct.pack("<III", 2, 2**32 - 1, 2**32 - 1) + b"JSON{}", 14)
    put("surfaces", "nested.gltf", '{"nodes":' + "[" * 4000, 15)
    put("surfaces", "external.gltf", scene.format(36, 0, view, 3, node).replace('{"byteLength":36}', '{"byteLength":36,"uri":"/etc/passwd"}'), 15)

    points = ('<VTKFile type="PolyData" header_type="UInt64" compressor="{}"><PolyData><Piece NumberOfPoints="{}"><Points><DataArray '
              'type="Float64" NumberOfComponents="3" format="{}">{}</DataArray></Points></Piece></PolyData>{}</VTKFile>')
    words = lambda *numbers: base64.b64encode(struct.pack(f"<{len(numbers)}Q", *numbers)).decode()
    swelling = zlib.compress(bytes(1 << 20))
    zlib_name = "vtkZLibDataCompressor"
    for name, text in (
        ("points", points.format("", HUGE, "ascii", "1 2 3", "")),
        ("bytes", points.format("", 1, "binary", words(HUGE, 1, 2, 3), "")),
        ("blocks", points.format(zlib_name, 1, "binary", words(HUGE, 32768, 0, 9), "")),
        ("block", points.format(zlib_name, 1, "binary", words(1, HUGE, HUGE, 9) + "AAAAAAAAAAAA", "")),
        ("swells", points.format(zlib_name, 1, "binary", words(1, 2**40, 0, len(swelling)) + base64.b64encode(swelling).decode(), "")),
        ("lz4", points.format("vtkLZ4DataCompressor", 1, "binary", words(1, 4096, 0, 18) + "/" * 24, "")),
        ("offset", points.format("", 1, f'appended" offset="{HUGE}', "", '<AppendedData encoding="raw">_12345678</AppendedData>')),
        ("nested", "<VTKFile type='PolyData'>" + "<Piece>" * 4000),
    ):
        put("surfaces", f"{name}.vtp", text, 16)
    put("surfaces", "types.vtu", points.format("", 0, "ascii", "", "").replace("PolyData", "UnstructuredGrid").replace("</Points>",
        '</Points><Cells><DataArray type="Int8" Name="types">5 42 6</DataArray><DataArray type="Int64" Name="offsets">-1 9 2</DataArray></Cells>'), 17)

    def model(objects, build):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as file:
            text = f"<model><resources>{objects}</resources><build>{build}</build></model>"
            file.writestr(zipfile.ZipInfo("3D/3dmodel.model"), text, zipfile.ZIP_DEFLATED)
        return out.getvalue()

    twice = "".join(f'<object id="{n}"><components>' + f'<component objectid="{n - 1}"/>' * 2 + "</components></object>" for n in range(1, 40))
    put("surfaces", "twice.3mf", model('<object id="0"/>' + twice, '<item objectid="39"/>'), 18)
    put("surfaces", "loop.3mf", model('<object id="1"><components><component objectid="1"/></components></object>', '<item objectid="1"/>'), 18)
    put("surfaces", "path.3mf", model("", '<item objectid="1" path="/../../etc/passwd"/>'), 18)
    put("surfaces", "swells.3mf", model(" " * (1 << 24), ""), 18)
    put("surfaces", "entries.3mf", changed(model("", ""), -14, b"\xff" * 12)[:-4], 18)

    use = "".join(f"DEF a{n} Group {{ children [ USE a{n - 1} USE a{n - 1} ] }}\n" for n in range(1, 40))
    put("surfaces", "twice.wrl", "#VRML V2.0 utf8\nDEF a0 Group { }\n" + use, 19)
    put("surfaces", "nested.wrl", "#VRML V2.0 utf8\n" + "Group { children [ " * 4000, 19)
    put("surfaces", "index.wrl", "#VRML V2.0 utf8\nShape { geometry IndexedFaceSet { coordIndex [0 9223372036854775807 -9223372036854775808 -1] "
        "coord Coordinate { point [0 0 0 1 0 0 0 1 0] } } }", 19)


def volumes():
    nifti = bytearray(352)
    nifti[:4] = struct.pack("<i", 348)
    nifti[344:348] = b"n+1\0"
    for name, dims in (("most", (3, 32767, 32767, 32767)), ("negative", (3, -1, 2, 2)), ("none", (0, 0, 0, 0)), ("seven", (7, 1, 1, 1))):
        data = changed(bytes(nifti), 40, struct.pack("<4h", *dims))
        data = changed(changed(data, 70, struct.pack("<2h", 8, 32)), 108, struct.pack("<f", 352))
        put("volumes", f"{name}.nii", data, 0)
        put("volumes", f"{name}.nii.gz", gzip.compress(data + bytes(1 << 20), mtime=0), 1)
    for name, offset in (("nan", float("nan")), ("far", 1e30), ("negative", -352.0)):
        data = changed(bytes(nifti), 40, struct.pack("<4h", 3, 2, 2, 2))
        put("volumes", f"offset-{name}.nii", changed(changed(data, 70, struct.pack("<2h", 2, 8)), 108, struct.pack("<f", offset)), 0)
    nrrd = "NRRD0005\ntype: {}\ndimension: 3\nsizes: {}\nencoding: {}\n{}\n"
    put("volumes", "sizes.nrrd", nrrd.format("uint8", f"{HUGE} {HUGE} {HUGE}", "raw", "") + "a", 3)
    put("volumes", "other-file.nrrd", nrrd.format("uint8", "2 2 2", "raw", "data file: /etc/passwd\n"), 3)
    put("volumes", "list.nrrd", nrrd.format("uint8", "2 2 2", "raw", "data file: LIST\n/etc/passwd\n"), 3)
    put("volumes", "skip.nrrd", nrrd.format("uint8", "2 2 2", "raw", f"byte skip: {HUGE}\nline skip: -1\n"), 3)
    put("volumes", "swells.nrrd", (nrrd.format("int32", "100000 100000 100", "gzip", "")).encode() + gzip.compress(bytes(1 << 20), mtime=0), 3)
    loop = struct.pack("<HHII", 256, 3, 1, 2**16 - 1) + struct.pack("<HHII", 257, 4, 1, 2**32 - 1)
    put("volumes", "loop.tif", b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 2) + loop + struct.pack("<I", 8), 4)
    put("volumes", "big.tif", b"II+\0" + struct.pack("<HHQ", 8, 0, 16) + struct.pack("<Q", HUGE), 4)
    for name, shape in (("most", f"({HUGE}, {HUGE}, 2)"), ("axes", "(" + "1, " * 2000 + ")"), ("negative", "(-1, 2, 2)")):
        put("volumes", f"{name}.npy", npy(dictionary("'|u1'", shape), bytes(8)), 5)


def arrays():
    """Makes models with false npy headers, as archives and as members of archives."""
    twice = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 3), 'shape': (1099511627776, 3), }"
    lies = {
        "shape-twice": npy(twice, bytes(96)),
        "shape-most": npy(dictionary("'<f8'", f"({HUGE}, 3)")),
        "shape-overflows": npy(dictionary("'<f8'", f"({2**33}, {2**33})"), bytes(8)),
        "shape-of-names": npy(dictionary("'<f8'", "(a, b)")),
        "axes": npy(dictionary("'<f8'", "(" + "1, " * 500 + ")"), bytes(8)),
        "objects": npy(dictionary("'|O'", "(4, 3)"), b"\x80\x04."),
        "text": npy(dictionary("'<U1073741824'", "()"), bytes(8)),
        "escape": npy("{'descr': '\x1b[2J\x07\n', 'fortran_order': False, 'shape': (4, 3), }", bytes(96)),
        "nested": npy("[" * 4000),
        "not-finite": npy(dictionary("'<f8'", "(1, 3)"), struct.pack("<3d", float("nan"), float("inf"), 1)),
        "length": b"\x93NUMPY\x02\0" + struct.pack("<I", 2**32 - 1) + b"{}",
        "cut": npy(dictionary("'<f8'", "(4, 3)"), bytes(95)),
    }
    sound = npy(dictionary("'<f8'", "(4, 3)"), struct.pack("<12d", *range(12)))
    for name, lie in lies.items():
        put("models", f"{name}.npz", archive({"coefficients": lie}))
        put("models", f"{name}-deflated.npz", archive({"coefficients": lie}, zipfile.ZIP_DEFLATED))
        put("archives", name, b"\0" + struct.pack("<H", len(lie)) + lie, 0)
        put("tables", f"{name}.npy", lie, 2)
        put("exchange", f"{name}.npy", lie, 11)
    for number, member in enumerate(("max_degree", "convention", "faces", "directions", "cut_from", "seam"), 1):
        lie = npy(dictionary("'<i8'", "(1099511627776,)"), bytes(8))
        put("models", f"{member}.npz", archive({"coefficients": sound, member: lie}))
        members = b"\0" + struct.pack("<H", len(sound)) + sound + bytes([number]) + struct.pack("<H", len(lie)) + lie
        put("archives", member, members, 1)
    swells = npy(dictionary("'<f8'", "(40000, 3)"), bytes(960_000))
    put("models", "swells.npz", archive({"coefficients": swells}, zipfile.ZIP_DEFLATED))
    put("models", "empty.npz", archive({}))
    put("models", "cut.npz", archive({"coefficients": sound})[:-10])
    put("models", "sound.npz", archive({"coefficients": sound}))


def stores():
    for reader, pattern in (("basis", "48*/A_2"), ("factors", "48*/factor_2_f64_*")):
        path = next((DATA / "golden-v1/store").glob(pattern))
        data = path.read_bytes()
        put(reader, "sound", data, 0)
        at = {"rows": (48, "<Q"), "degree": (56, "<I"), "columns": (60, "<I"), "scalar": (64, "<I"), "codec": (68, "<I"),
              "chunk_rows": (72, "<Q"), "chunk_count": (80, "<Q")}
        if reader == "factors":
            at = {"rows": (48, "<Q"), "max_degree": (56, "<I"), "columns": (64, "<Q"), "tile": (72, "<I"), "tile_columns": (76, "<I"),
                  "tile_count": (80, "<Q"), "norm": (128, "<Q"), "condition": (136, "<Q")}
        for name, (place, kind) in at.items():
            for label, value in (("zero", 0), ("most", 2 ** (8 * struct.calcsize(kind)) - 1)):
                put(reader, f"{name}-{label}", changed(data, place, struct.pack(kind, value)), 3)
        for label, value in (("table_offset", 8), ("entries", 16), ("file_len", 24)):
            put(reader, f"{label}-most", changed(data, len(data) - 128 + value, b"\xff" * 8), 3)
        table = struct.unpack("<Q", data[-120:-112])[0]
        for label, value in (("offset", 0), ("stored_len", 8), ("raw_len", 16)):
            put(reader, f"entry-{label}-most", changed(data, table + value, b"\xff" * 8), 7)
        put(reader, "cut", data[:-1], 0)


def others():
    moments = (DATA.parent.parent / "crates/moments/tests/data/v1.moments").read_bytes()
    put("moments", "sound", moments, 0)
    for name, place in (("degree", 28), ("channels", 32), ("sources", 36), ("names", 40), ("cells", 44)):
        put("moments", f"{name}-most", changed(moments, place, b"\xff" * 4), 1)
        put("moments", f"{name}-2000", changed(moments, place, struct.pack("<I", 2000)), 1)
    schemes = (DATA.parent.parent / "crates/moments/tests/data/v2.moments").read_bytes()
    put("moments", "sound-2", schemes, 0)
    put("moments", "no-scheme", changed(schemes, 72, bytes(32)), 1)
    put("moments", "reserved-most", changed(schemes, 104, b"\xff" * 24), 1)
    put("moments", "header-1", changed(schemes, 12, struct.pack("<I", 128)), 1)
    put("moments", "version-1", changed(schemes, 8, struct.pack("<I", 1)), 1)
    put("moments", "version-2", changed(moments, 8, struct.pack("<I", 2)), 1)
    put("moments", "version-most", changed(schemes, 8, b"\xff" * 4), 1)
    put("moments", "short-2", schemes[:170], 1)
    for path in sorted((DATA / "sphz-v1").glob("*.sphz")):
        data = path.read_bytes()
        put("sphz", f"sound-{path.stem}", data, 0)
        put("sphz", f"degree-{path.stem}", changed(data, 10, b"\xd0\x0f"), 1)
        put("sphz", f"head-{path.stem}", changed(data, 6, struct.pack("<I", len(data))), 1)
        put("sphz", f"prefix-{path.stem}", data[: len(data) * 2 // 3], 2)
    put("sphz", "zeros", b"\x89SPZ\x01\x01" + struct.pack("<I", 40) + b"\xd0\x0f\x03\x00\x00" + bytes(24), 1)
    put("cohorts", "quotes.csv", 'id,surface\n"a""b","x\ny"\n"never ends', 1)
    put("cohorts", "ids.tsv", "id\tsurface\n../../x\ta.ply\n\ta.ply\nCON\tb.ply\na\0b\tc.ply\n", 0)
    put("cohorts", "twice.tsv", "id\tsurface\na\ta.ply\na\tb.ply\n", 0)
    put("cohorts", "latin1.tsv", b"id\tsurface\n\xe9\ta.ply\n", 0)
    put("cohorts", "cut.status", "id\tstate\tmsd\txsd\tseconds\terror\toutput\na\tdone\t1\t1\t1\t\ta.npz\nb\tdo", 2)
    put("cohorts", "escape.status", "id\tstate\tmsd\txsd\tseconds\terror\toutput\n\x1b[2J\tfailed\tnan\tinf\t-1\t\x07\t\n", 2)
    put("exchange", "deep.json", "[" * 4000, 10)
    put("exchange", "rows.fits", ("SIMPLE  =                    T" + " " * 50 + "BITPIX  =                    8" + " " * 50 + "NAXIS   =                    0"
        + " " * 50 + "END" + " " * 77).ljust(2880) + ("XTENSION= 'BINTABLE'" + " " * 60 + f"NAXIS1  = {HUGE:>20}" + " " * 50
        + f"NAXIS2  = {HUGE:>20}" + " " * 50 + "END" + " " * 77).ljust(2880), 3)
    mat = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    put("exchange", "size.mat", mat + struct.pack("<II", 14, 2**32 - 1) + bytes(64), 1)
    put("exchange", "swells.mat", mat + struct.pack("<II", 15, 1100) + zlib.compress(bytes(1 << 20)), 1)
    put("exchange", "degree.coef", "{ 4294967295, {0, 0, 0}, {0, 0, 0} }", 0)
    put("exchange", "rows.csv", "l,m,x,y,z\n18446744073709551615,0,1,2,3\n", 9)
    put("exchange", "degrees.sh", "1000000000 0 1 0\n", 2)
    put("tables", "quotes.csv", 'x,y,z\n"1"",0,0\n', 0)
    put("tables", "numbers.csv", "x,y,z\n1e400,0,0\n0x1,1,1\n1,,\n", 0)
    put("tables", "rows.ply", f"ply\nformat binary_little_endian 1.0\nelement vertex {HUGE}\nproperty double x\nproperty double y\n"
        "property double z\nend_header\n", 4)
    put("tables", "elements.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty double x\nproperty double y\n"
        f"property double z\nelement a {HUGE}\nelement b {HUGE}\nend_header\n", 4)
    put("tables", "points.las", b"LASF" + bytes(90) + struct.pack("<HIIBHI", 227, 227, 2**32 - 1, 1, 65535, 2**32 - 1) + bytes(300), 5)
    put("tables", "footer.parquet", b"PAR1" + struct.pack("<I", 2**32 - 1) + b"PAR1", 6)
    put("tables", "footer.arrow", b"ARROW1\0\0" + struct.pack("<i", 2**31 - 1) + b"ARROW1", 7)


if __name__ == "__main__":
    for make in (surfaces, volumes, arrays, stores, others):
        make()
