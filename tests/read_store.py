"""Reads a basis file or a factor. Written from store-format.md alone, to show that the document suffices.

    read_store.py SCHEME_FOLDER DEGREE OUT.npy
    read_store.py SCHEME_FOLDER FACTOR_NAME OUT.npy

Makes the checks of "What a reader checks" with two exceptions. The hashes (of header, footer and chunks, and the root)
aren't checked, because BLAKE3 isn't in Python's standard library. The number of rows isn't compared with the
directions, because the script doesn't have them.
"""

import os
import stat
import struct
import sys

import numpy as np
import zstandard

FIELDS = "key rows degree columns scalar codec chunk_rows chunk_count".split()


def crc_of_byte(value):
    for _ in range(8):
        value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value


CRC_TABLE = [crc_of_byte(value) for value in range(256)]


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


def check(condition, what):
    if not condition:
        raise ValueError(what)


def load(path):
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        check(stat.S_ISREG(os.fstat(file.fileno()).st_mode), "not a regular file")
        data = file.read()
    check(len(data) >= 4096 + 64 + 128, "too short")
    return data


def decode(stored, codec, raw_len, size):
    """Returns the decoded bytes of a chunk."""
    if codec == 0:
        return stored
    check(stored[:4] == b"\x28\xb5\x2f\xfd", "not a zstd frame")
    frame = zstandard.get_frame_parameters(stored)
    check(frame.content_size == raw_len and frame.dict_id == 0, "not a frame as described")
    # The decoder's buffer has the content size declared in the frame; the decoder writes at most this many bytes.
    shuffled = zstandard.ZstdDecompressor().decompress(stored, read_across_frames=False, allow_extra_data=False)
    check(len(shuffled) == raw_len, "length of the decoded chunk")
    return np.frombuffer(shuffled, "u1").reshape(size, -1).T.tobytes()


def read(path):
    """Returns the header as a dict, and the values: a row for each direction, a column for each order from -l to l."""
    data = load(path)
    check(data[:8] == b"\x89SPH\r\n\x1a\n", "not a basis file")
    version, header_len = struct.unpack_from("<2I", data, 8)
    check(version == 1, f"version {version}, not 1")
    check(header_len == 4096 and not any(data[88:4064]), "header_len or reserved bytes")
    header = dict(zip(FIELDS, struct.unpack_from("<32sQ4I2Q", data, 16)))
    key, rows, degree, columns, scalar, codec, chunk_rows, chunk_count = header.values()
    check(degree <= 2000 and columns == 2 * degree + 1, "degree or columns")
    check(scalar in (1, 2) and codec in (0, 1), "scalar or codec")
    check(chunk_rows % 8 == 0 and 8 <= chunk_rows <= 2**20, "chunk_rows")
    size = {1: 8, 2: 4}[scalar]
    check(chunk_rows * columns * size <= 2**32 and 1 <= rows <= 2**40, "rows")
    check(chunk_count <= 2**22 and chunk_count == -(-rows // chunk_rows), "chunk_count")

    footer = data[-128:]
    magic, table_offset, entries, file_len = struct.unpack_from("<8s3Q", footer)
    check(magic == b"SPH-END\n" and not any(footer[64:96]), "footer")
    check(file_len == len(data) and entries == chunk_count, "file_len or entries")
    check(table_offset >= 4096 and table_offset + 64 * entries + 128 == file_len, "table_offset")

    chunks, end = [], 4096
    for chunk in range(chunk_count):
        offset, stored_len, raw_len, crc, kind = struct.unpack_from("<3Q2I", data, table_offset + 64 * chunk)
        height = min(chunk_rows, rows - chunk * chunk_rows)
        check(offset == end and raw_len == height * columns * size, f"place or length of chunk {chunk}")
        check(kind <= codec, f"codec of chunk {chunk}")
        check(stored_len == raw_len if kind == 0 else 1 <= stored_len < raw_len, f"stored_len of chunk {chunk}")
        end = -(-(offset + stored_len) // 64) * 64
        check(end <= table_offset and not any(data[offset + stored_len : end]), f"gap after chunk {chunk}")
        chunks.append((offset, stored_len, raw_len, crc, kind, height))
    check(end == table_offset, "chunks don't end at the table")
    folder, name = os.path.split(os.path.abspath(path))
    check(os.path.basename(folder) == key.hex() and name == f"A_{degree}", "of another scheme or degree")

    blocks = []
    for offset, stored_len, raw_len, crc, kind, height in chunks:
        stored = data[offset : offset + stored_len]
        check(crc32c(stored) == crc, f"CRC of the chunk at {offset}")
        values = np.frombuffer(decode(stored, kind, raw_len, size), f"<f{size}")
        blocks.append(values.reshape(columns, height).T)
    return header, np.ascontiguousarray(np.concatenate(blocks))


def read_factor(path):
    """Returns the lower triangular factor, (columns, columns)."""
    data = load(path)
    check(data[:8] == b"\x89SPF\r\n\x1a\n", "not a factor")
    version, header_len = struct.unpack_from("<2I", data, 8)
    check(version == 1, f"version {version}, not 1")
    check(header_len == 4096 and not any(data[144:4064]), "header_len or reserved bytes")
    key, rows, degree, scalar, columns, tile, tile_columns, tile_count = struct.unpack_from("<32sQ2IQ2IQ", data, 16)
    smoothness, norm, reciprocal = struct.unpack_from("<3d", data, 120)
    check(1 <= rows <= 2**40 and degree <= 2000 and columns == (degree + 1) ** 2, "rows, degree or columns")
    check(scalar in (1, 2) and tile % 8 == 0 and 8 <= tile <= 1024, "scalar or tile")
    check(tile_columns == -(-columns // tile) and tile_count == tile_columns * (tile_columns + 1) // 2, "tiles")
    check(tile_count <= 2**22 and 0 <= smoothness < np.inf and 0 <= norm < np.inf and 0 <= reciprocal <= 1, "numbers")
    size = {1: 8, 2: 4}[scalar]

    footer = data[-128:]
    magic, table_offset, entries, file_len = struct.unpack_from("<8s3Q", footer)
    check(magic == b"SPH-END\n" and not any(footer[64:96]), "footer")
    check(file_len == len(data) and entries == tile_count, "file_len or entries")
    check(table_offset >= 4096 and table_offset + 64 * entries + 128 == file_len, "table_offset")

    factor = np.zeros((columns, columns), f"<f{size}")
    at, end = table_offset, 4096
    for j in range(0, columns, tile):
        for i in range(j, columns, tile):
            height, width = min(tile, columns - i), min(tile, columns - j)
            offset, stored_len, raw_len, crc, codec = struct.unpack_from("<3Q2I", data, at)
            check(offset == end and stored_len == raw_len == height * width * size and codec == 0, f"tile ({i}, {j})")
            stored = data[offset : offset + stored_len]
            check(crc32c(stored) == crc, f"CRC of the tile at {offset}")
            factor[i : i + height, j : j + width] = np.frombuffer(stored, f"<f{size}").reshape(width, height).T
            at, end = at + 64, -(-(offset + stored_len) // 64) * 64
            check(end <= table_offset and not any(data[offset + stored_len : end]), f"gap after tile ({i}, {j})")
    check(end == table_offset, "tiles don't end at the table")
    folder, name = os.path.split(os.path.abspath(path))
    check(os.path.basename(folder) == key.hex(), "of another scheme")
    check(name.startswith(f"factor_{degree}_f{8 * size}_"), "of another degree or scalar type")
    return factor


if __name__ == "__main__":
    check(crc32c(b"123456789") == 0xE3069283, "CRC-32C")
    if sys.argv[2].startswith("factor_"):
        np.save(sys.argv[3], read_factor(os.path.join(sys.argv[1], sys.argv[2])))
    else:
        np.save(sys.argv[3], read(os.path.join(sys.argv[1], f"A_{int(sys.argv[2])}"))[1])
