"""Reads a compressed model: read_sphz.py FILE.sphz OUT.npy [--prefix]. Written from docs/sphz-format.md alone, in
Python and NumPy, to show that the page suffices. Short rather than fast."""

import json
import sys
import zlib

import numpy as np

KNOTS = [22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743, 32768, 40793, 47911, 53581]
KNOTS += [57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514]


class Bad(Exception):
    """A file that breaks the format's rules."""


def check(condition, what):
    if not condition:
        raise Bad(what)


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


class Fields:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count, what):
        check(self.at + count <= len(self.data), f"{what} is cut off")
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self, what, least=0, most=2**64 - 1):
        number = shift = 0
        while True:
            byte = self.take(1, what)[0]
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
            check(shift < 70, what)
        check(least <= number <= most, f"{what} {number}, not {least} to {most}")
        return number

    def unsigned(self, what):
        return int.from_bytes(self.take(4, what), "little")


def read_head(data):
    check(data[:4] == b"\x89SPZ", "magic")
    check(len(data) >= 10, "the head is cut off")
    check(data[4] == 1, f"version {data[4]}, not 1")
    flags, length = data[5], int.from_bytes(data[6:10], "little")
    check(14 <= length <= len(data), "the head is cut off")
    check(crc32c(data[: length - 4]) == int.from_bytes(data[length - 4 : length], "little"), "checksum of the head")
    check(flags < 4, "flags")
    fields = Fields(data[10 : length - 4])
    head = {"length": length, "surface": bool(flags & 1)}
    head["L"] = fields.varint("L", 0, 2000)
    head["c"] = fields.varint("c", 1, 65536)
    check(head["c"] == 3 or not head["surface"], "channels of a surface")
    check((head["L"] + 1) ** 2 * head["c"] <= 2**28, "number of coefficients")
    head["T"] = fields.varint("T", 0, head["L"])
    head["g"] = fields.varint("g", 0, 20)
    head["r"] = np.frombuffer(fields.take(2, "r"), "i1").astype(int)
    head["steps"] = np.frombuffer(fields.take(8 * (1 if head["surface"] else head["c"]), "steps"), "<f8")
    check(np.all(head["steps"] > 0) and np.all(np.isfinite(head["steps"])), "steps")
    numbers = [fields.varint("degree 0") for _ in range(head["c"])]
    head["first"] = [n // 2 if n % 2 == 0 else -(n + 1) // 2 for n in numbers]
    head["segments"], degree = [], 0
    for _ in range(fields.varint("segments", 1 if head["T"] else 0, head["T"])):
        degree += fields.varint("degree of a segment", 1, head["T"] - degree)
        size = fields.varint("length of a segment", 0, 2**32 - 1)
        head["segments"].append((degree, size, fields.unsigned("checksum of a segment")))
    check(degree == head["T"], "degree of the last segment")
    whole = length + sum(size for _, size, _ in head["segments"])
    zeros = ((head["L"] + 1) ** 2 - (head["T"] + 1) ** 2) * head["c"]
    check(zeros <= 2**20 + 2**10 * whole, "number of coefficients")
    head["text"] = None
    if flags & 2:
        size = fields.varint("length of the text", 0, 2**24)
        inflate = zlib.decompressobj()
        text = inflate.decompress(fields.data[fields.at :], size + 1)
        check(len(text) == size and inflate.eof and not inflate.unused_data, "length of the text")
        head["text"] = json.loads(text.decode("utf-8"))
    else:
        check(fields.at == len(fields.data), "bytes behind the head's fields")
    return head


class Decoder:
    def __init__(self, data):
        self.data, self.at, self.low, self.high, self.window = data, 0, 0, 2**32 - 1, 0
        for _ in range(4):
            self.shift()

    def shift(self):
        byte = self.data[self.at] if self.at < len(self.data) else 0
        self.window = (self.window << 8) % 2**32 + byte
        self.at += 1

    def decision(self, p):
        middle = self.low + ((self.high - self.low) * p >> 16)
        one = self.window <= middle
        if one:
            self.high = middle
        else:
            self.low = middle + 1
        while self.low >> 24 == self.high >> 24:
            self.low = (self.low << 8) % 2**32
            self.high = (self.high << 8) % 2**32 + 255
            self.shift()
        check(self.at <= len(self.data) + 4, "the stream ends early")
        return int(one)

    def plain(self, count):
        bits = 0
        for _ in range(count):
            bits = 2 * bits + self.decision(32768)
        return bits


def squash(x):
    y = min(max(x, -2047), 2047) + 2048
    a, b = y >> 7, y % 128
    return (KNOTS[a] * (128 - b) + KNOTS[a + 1] * b) >> 7


def stretches():
    table, x = [], -2047
    for u in range(4096):
        while x < 2047 and squash(x) < 16 * u + 8:
            x += 1
        table.append(x)
    return table


def class_of(x):
    if x < 4:
        return x
    n = x.bit_length() - 1
    return min(47, 4 * (n - 1) + (x >> (n - 2)) % 4)


def bound(k):
    return k if k < 4 else (4 + k % 4) * 2 ** (k // 4 - 1)


class Numbers:
    """Decodes the whole numbers of a stream."""

    def __init__(self, head, data):
        self.c, self.decoder, self.stretch = head["c"], Decoder(data), stretches()
        self.magnitudes, self.values = {}, {}
        self.M1 = self.M2 = 256 * 2 ** head["g"]
        self.C = [self.M1] * self.c
        self.estimates = {}
        self.weights = {(j, size): [9830] * 6 for j in range(20) for size in range(3)}

    def estimate(self, t, k, kind, j):
        if (t, k, kind, j) not in self.estimates:
            b = bound(k) + bound(k + 1)
            p = (b << 22) // (b + (384 if j == 0 else 512))
            self.estimates[t, k, kind, j] = [min(max(p, 2**14), 2**22 - 2**16), 0]
        return self.estimates[t, k, kind, j]

    def degree(self, l):
        self.s, self.si, self.N = 0, [0] * self.c, 0
        for k in range(l + 1):
            for m in [k, -k] if k else [0]:
                for i in range(self.c):
                    magnitude = self.magnitude(l, m, i)
                    negative = magnitude and self.decoder.plain(1)
                    self.values[l, m, i] = -magnitude if negative else magnitude
                    counted = min(magnitude, 2**20)
                    self.magnitudes[l, m, i] = counted
                    self.s, self.N = self.s + counted, self.N + 1
                    self.si[i] += counted
        mean = 256 * self.s // ((2 * l + 1) * self.c)
        self.M2, self.M1 = (mean if l == 1 else self.M1), mean
        self.C = [256 * s // (2 * l + 1) for s in self.si]

    def expected(self, l, m, i):
        k, a = abs(m), lambda l, m, i: self.magnitudes.get((l, m, i), 0)
        pair = lambda l, k, i: a(l, k, i) + a(l, -k, i)
        beside, below, others = [0, 0], [0, 0], [0, 0]

        def add(sums, s, w):
            sums[0] += s
            sums[1] += w

        for d, w in (1, 8), (2, 5):
            if k >= d:
                add(beside, w * pair(l, k - d, i), 2 * w)
        if m < 0:
            add(beside, 7 * a(l, k, i), 7)
        for o in abs(k - 1), k, k + 1:
            w = 4 if o == k else 3
            if o <= l - 1:
                add(below, w * pair(l - 1, o, i), 2 * w)
            if o <= l - 2:
                add(below, 3 * pair(l - 2, o, i), 6)
        for j in range(max(0, i - 2), min(self.c, i + 3)):
            if j < i:
                add(others, 6 * a(l, m, j), 6)
            elif j > i and m < 0:
                add(others, 4 * a(l, k, j), 4)
            if j != i and k <= l - 1:
                add(others, 2 * pair(l - 1, k, j), 4)
        e1 = (24 * ((5 * self.M1 + 3 * self.M2) // 8) + 256 * self.s) // (24 + self.N)
        e5 = (30 * self.C[i] + 256 * self.si[i]) // (30 + self.N // self.c)
        mean = lambda s, w, v: (256 * s + v * e1) // (w + v)
        two = [x + y for x, y in zip(beside, below)]
        three = [x + y for x, y in zip(two, others)]
        return [mean(*three, 19), e1, mean(*two, 19), mean(*below, 32), mean(*others, 32), e5]

    def magnitude(self, l, m, i):
        e = self.expected(l, m, i)
        shift = next((s for s in range(24) if e[0] >> s <= 1536), 24)
        kinds = [0, min(3, 4 * abs(m) // (l + 1)), 0, 0, i % 4, 0]
        classes = [class_of(x >> shift) for x in e]
        quotient = 0
        while quotient < 20:
            used = [self.estimate(t, classes[t], kinds[t], quotient) for t in range(6)]
            if not self.mixed(used, self.weights[quotient, min(shift, 2)]):
                break
            quotient += 1
        if quotient == 20:
            n = 0
            while n < 31 and self.decoder.plain(1):
                n += 1
            quotient += 2**n + self.decoder.plain(n) - 1
        return min(2**30, (quotient << shift) + self.decoder.plain(shift))

    def mixed(self, used, weights):
        x = [self.stretch[p >> 10] for p, _ in used]
        p = min(max(squash(sum(w * y for w, y in zip(weights, x)) >> 16), 16), 65520)
        d = self.decoder.decision(p)
        error = 65536 * d - p
        for t in range(6):
            weights[t] = min(max(weights[t] + ((error * x[t] + 32768) >> 16), -(2**20)), 2**20)
            p, n = used[t]
            p += ((2**22 * d - p) * (65536 // (n + 8))) >> 16
            used[t][:] = [min(max(p, 2**10), 2**22 - 2**10), min(250, n + 1)]
        return d


def read(data, prefix=False):
    head = read_head(data)
    whole = head["length"] + sum(size for _, size, _ in head["segments"])
    check(len(data) <= whole, "bytes behind the last segment")
    check(prefix or len(data) == whole, "the file is cut off")
    at, degree = head["length"], 0
    for last, size, crc in head["segments"]:
        if at + size > len(data):
            break
        check(crc32c(data[at : at + size]) == crc, "checksum of a segment")
        at, degree = at + size, last
    check(at == whole or degree > 0, "no whole level")
    top, degree = degree, head["L"] if at == whole else degree
    numbers = Numbers(head, data[head["length"] : at])
    for l in range(1, top + 1):
        numbers.degree(l)
    steps, r1, r2 = np.broadcast_to(head["steps"], head["c"]), head["r"][0] / 256, head["r"][1] / 256
    out = np.zeros(((degree + 1) ** 2, head["c"]))
    out[0] = np.array(head["first"], float) * steps
    for (l, m, i), q in numbers.values.items():
        if q:
            out[l * l + l + m, i] = np.sign(q) * (abs(q) - (r1 if abs(q) == 1 else r2)) * steps[i]
    check(np.all(np.isfinite(out)), "coefficients")
    return head, out


if __name__ == "__main__":
    with open(sys.argv[1], "rb") as file:
        contents = file.read()
    try:
        _, coefficients = read(contents, "--prefix" in sys.argv)
    except Bad as error:
        sys.exit(f"{sys.argv[1]}: {error}")
    np.save(sys.argv[2], coefficients)
