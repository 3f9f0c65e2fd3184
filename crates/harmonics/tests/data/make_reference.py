#!/usr/bin/env python3
"""Make reference.csv: real spherical harmonics to 25 digits, for the tests.

What
    Rows `x,y,z,degree,order,value` under a few comment lines that start with
    `#`. The doubles x, y, z (written as repr, so they round-trip) are the exact
    input: a direction, of unit length up to rounding. The reference divides by
    the exact |(x, y, z)|, so theta = atan2(hypot(x, y), z), phi = atan2(y, x)
    hold without error and nothing depends on the rounding of the length.

Convention
    The canonical basis: real, orthonormal over the sphere, no Condon-Shortley
    phase. With N^2 = (2l+1)/(4 pi) (l-m)!/(l+m)! and P_l^m >= 0 at l = m,
        S_{l,0}  = N P_l(cos theta)
        S_{l,m}  = sqrt(2) N P_l^m(cos theta) cos(m phi)      m > 0
        S_{l,-m} = sqrt(2) N P_l^m(cos theta) sin(m phi)      m > 0

Method
    In multiple precision, whose exponents don't run out, so no scaling is
    needed. For each direction and each m, one sweep in l of the un-normalised
        (l-m) Q_l = (2l-1) cos(theta) Q_{l-1} - (l+m-1) Q_{l-2},  Q_m = 1,
    with Q_l = P_l^m / P_m^m; then, at the degrees asked for, the factor
    N (2m-1)!! from exact integers, and sin(theta)^m. cos(theta) and sin(theta)
    are z/r and hypot(x, y)/r. cos(m phi), sin(m phi) are the parts of
    ((x + i y)/hypot(x, y))^m by repeated multiplication. This agrees with
    sin(m atan2(y, x)), but it also keeps its relative precision next to
    phi = pi (for example y = 1e-300), where a rounded phi would lose it, and
    it gives exact zeros if y = 0.
    Values below 1e-320 in size are written as `0`. Larger values are written
    with all digits, even if they are subnormal as doubles.

Checks (a failure of any stops the script before it writes)
    1. Every row at 80 and at 160 digits: relative difference below 1e-50, the
       same printed digits, exact zeros alike.
    2. Every row against another formula: theta and phi by atan2, and the finite
       sum P_l^m = (l+m)! / (2^m m! (l-m)!) sin(theta)^m
       2F1(m-l, l+m+1; m+1; sin(theta/2)^2), term by term with enough digits
       (1.1 l + 500) to outlast its cancellation: relative difference below
       1e-50; where the row is exactly zero, the sum's size below 1e-400.
    3. Degrees 0 to 3 against the polynomials in x, y, z, written out; it pins
       the convention. Degrees to 20 against mpmath.spherharm, which has the
       Condon-Shortley phase, converted.
    4. The addition theorem sum_m S_{l,m}^2 = (2l+1)/(4 pi) at l = 2000, over
       all orders, for two directions, to 1e-60 relative.
    5. Each direction's length is 1 to within 4e-16.

Run
    Needs mpmath; gmpy2, when there, makes it several times faster.
        python3 -m venv VENV && VENV/bin/pip install mpmath gmpy2
        VENV/bin/python make_reference.py            # writes reference.csv
        VENV/bin/python make_reference.py --check    # compares, writes nothing
    The directions are made with mpmath and IEEE operations alone, so the table
    comes out the same, byte for byte, on any machine.
"""

import argparse
import functools
import io
import math
import multiprocessing
import pathlib
import sys
import time

from mpmath import mp, mpf

DIGITS = 80  # working precision; each row is checked at twice this
WRITTEN = 25  # significant digits in the file
DEGREES = [0, 1, 2, 3, 5, 10, 20, 50, 85, 86, 87, 100, 150, 151, 200, 300, 500,
           700, 1000, 1500, 1999, 2000]
SIZE_LIMIT = 1_000_000  # bytes
THIN_ABOVE = 300  # degree; keeps the file under SIZE_LIMIT
HEADER = """\
# Real orthonormal spherical harmonics, no Condon-Shortley phase; order < 0 is the sine part.
# x,y,z are exact doubles (unit up to rounding; the value is that of the exactly normalised direction).
# Values to 25 significant digits; 0 where the size is below 1e-320. Made by make_reference.py: don't edit.
x,y,z,degree,order,value
"""


# ---------------------------------------------------------------- directions

def direction(theta, phi, south=False):
    """Returns a direction near (theta, phi) as doubles of nearly unit length.
    With `south`, theta is measured from the south pole."""
    with mp.workdps(40):
        theta, phi = mpf(theta), mpf(phi)
        x = float(mp.sin(theta) * mp.cos(phi))
        y = float(mp.sin(theta) * mp.sin(phi))
        z = float(mp.cos(theta))
    r = math.sqrt(x * x + y * y + z * z)
    return x / r, y / r, (-z if south else z) / r


def seam(theta, sign, y):
    """Returns a direction on or next to a seam: x with the given sign, and the
    given y, which is 0 or tiny."""
    x, _, z = direction(theta, 0)
    return sign * x, y, z


def directions():
    """Returns (thin, (x, y, z)) for each direction. Directions with `thin` get
    fewer orders at high degrees."""
    full = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    # Near the poles, z rounds to +-1, and only x and y determine the direction.
    full += [direction("1e-8", phi) for phi in ("0.7", "2.9", "-1.3")]
    full += [direction("1e-8", phi, south=True) for phi in ("0.2", "1.9", "-2.4")]
    full += [direction(theta, phi) for theta, phi in (
        ("1e-5", "0.61"), ("1e-4", "-2.17"), ("1e-3", "1.83"), ("4e-3", "-0.37"),
        ("0.01", "2.71"), ("0.03", "-1.49"), ("0.1", "0.93"), ("0.3", "-2.93"))]
    thin = []
    # On the equator, and 1e-9 from it.
    x, y, _ = direction(mp.pi / 2, "1.1")
    thin += [(x, y, 0.0), (x, y, 1e-9), (-x, y, -1e-9)]
    thin += [(1.0, 0.0, 0.0)]
    # The seams phi = 0 and phi = +-pi.
    thin += [seam("1.05", 1, y) for y in (0.0, 1e-17, -1e-17)]
    thin += [seam("0.45", 1, y) for y in (1e-9, -1e-9)]
    thin += [seam("1.35", -1, y) for y in (0.0, -0.0)]
    thin += [seam("0.8", -1, y) for y in (1e-300, -1e-300)]
    # One direction in each octant.
    thin += [direction("1.2", "0.4"), direction("0.6", "2.2"),
             direction("0.9", "-2.6"), direction("1.5", "-0.8"),
             direction("2.5", "1.0"), direction("1.7", "2.0"),
             direction("0.3", "-1.7", south=True), direction("2.1", "-0.15")]
    return [(False, v) for v in full] + [(True, v) for v in thin]


def orders(degree, vector, thin):
    """Returns the orders to write for one degree, with both signs: small ones,
    ones spread over the range, the one nearest to the turning point
    |m| = l sin theta (halves rounded up), and the largest."""
    l = degree
    turning = math.floor(l * math.sqrt(vector[0] ** 2 + vector[1] ** 2) + 0.5)
    size = {0, 1, 2, l // 2, turning, l - 1, l}
    if not (thin and l > THIN_ABOVE):
        size |= {3, l // 4, 3 * l // 4}
    size = {m for m in size if 0 <= m <= l}
    return sorted(size | {-m for m in size})


# ------------------------------------------------------------ the recurrence

@functools.lru_cache(maxsize=None)
def odd_factorial(m):
    """(2m-1)!!, exact."""
    return math.factorial(2 * m) // (math.factorial(m) << m)


@functools.lru_cache(maxsize=None)
def norm(l, m, dps):
    """N (2m-1)!!, and sqrt(2) if m > 0, at `dps` digits (the current ones)."""
    square = mpf((2 * l + 1) * odd_factorial(m) ** 2) / math.perm(l + m, 2 * m)
    return mp.sqrt(square * (2 if m else 1) / (4 * mp.pi))


def recurrence(vector, wanted):
    """Returns {(l, m): S_{l,m}} for `wanted` = {|m|: degrees} and both signs of
    m, in the current precision."""
    x, y, z = (mpf(c) for c in vector)
    rho = mp.sqrt(x * x + y * y)
    r = mp.sqrt(x * x + y * y + z * z)
    cos_theta, sin_theta = z / r, rho / r
    c1, s1 = (x / rho, y / rho) if rho else (mpf(1), mpf(0))
    values = {}
    c, s, power, at = mpf(1), mpf(0), mpf(1), 0
    for m in sorted(wanted):
        while at < m:
            c, s = c * c1 - s * s1, s * c1 + c * s1
            power *= sin_theta
            at += 1
        picked = set(wanted[m])
        before, q = mpf(0), mpf(1)
        for l in range(m, max(picked) + 1):
            if l > m:
                before, q = q, ((2 * l - 1) * (cos_theta * q) - (l + m - 1) * before) / (l - m)
            if l in picked:
                p = norm(l, m, mp.dps) * power * q
                values[l, m] = p * c
                if m:
                    values[l, -m] = p * s
    return values


# --------------------------------------------------------- the second formula

def explicit(vector, l, m):
    """Returns (S_{l,m}, S_{l,-m}) for m >= 0, computed from theta and phi by the
    finite sum of check 2, with a precision that depends on l."""
    with mp.workdps(int(1.1 * l) + 500):
        x, y, z = (mpf(c) for c in vector)
        theta = mp.atan2(mp.hypot(x, y), z)
        phi = mp.atan2(y, x) if x or y else mpf(0)
        t = mp.sin(theta / 2) ** 2
        term = total = mpf(1)
        for k in range(l - m):
            term = term * t * ((m - l + k) * (l + m + 1 + k)) / ((m + 1 + k) * (k + 1))
            total += term
        legendre = mp.sin(theta) ** m * total * mp.factorial(l + m) \
            / (mp.factorial(m) * mp.factorial(l - m) * mpf(2) ** m)
        scale = mp.sqrt((2 * l + 1) / (4 * mp.pi) * mp.factorial(l - m) / mp.factorial(l + m))
        if m == 0:
            return scale * legendre, mpf(0)
        p = mp.sqrt(2) * scale * legendre
        return p * mp.cos(m * phi), p * mp.sin(m * phi)


def relative(a, b):
    """|a - b| / |b|; 0 if both are 0."""
    return abs(a - b) / abs(b) if b else (mpf(0) if not a else mp.inf)


def written(value):
    if abs(value) < mpf("1e-320"):
        return "0"
    return mp.nstr(value, WRITTEN, strip_zeros=True, min_fixed=1, max_fixed=0)


def one_direction(job):
    """Computes the rows of one direction and makes checks 1, 2 and 5. Returns
    the rows as text, their number, and the largest differences found."""
    thin, vector = job
    pairs = [(l, m) for l in DEGREES for m in orders(l, vector, thin)]
    wanted = {}
    for l, m in pairs:
        wanted.setdefault(abs(m), set()).add(l)
    norm.cache_clear()
    with mp.workdps(DIGITS):
        low = recurrence(vector, wanted)
    with mp.workdps(2 * DIGITS):
        high = recurrence(vector, wanted)

        length = mp.sqrt(sum(mpf(c) ** 2 for c in vector))
        assert abs(length - 1) < mpf("4e-16"), vector

        seen = {"precision": mpf(0), "formula": mpf(0), "zero": mpf(0), "zeros": 0, "tiny": 0}
        for m, degrees in wanted.items():
            for l in degrees:
                other = explicit(vector, l, m)
                for signed, o in ((m, other[0]), (-m, other[1]))[:2 if m else 1]:
                    value = high[l, signed]
                    at = (vector, l, signed)
                    d = relative(low[l, signed], value)
                    assert d < mpf("1e-50"), ("precision", at, d)
                    assert written(low[l, signed]) == written(value), ("digits", at)
                    seen["precision"] = max(seen["precision"], d)
                    if value:
                        d = relative(+o, value)
                        assert d < mpf("1e-50"), ("formula", at, d)
                        seen["formula"] = max(seen["formula"], d)
                        seen["tiny"] += abs(value) < mpf("1e-320")
                    else:
                        assert abs(o) < mpf("1e-400"), ("zero", at, o)
                        seen["zero"] = max(seen["zero"], abs(o))
                        seen["zeros"] += 1
        where = ",".join(repr(c) for c in vector)
        text = "".join(f"{where},{l},{m},{written(high[l, m])}\n" for l, m in pairs)
    return text, len(pairs), seen


# ---------------------------------------------------------- remaining checks

def check_low_degrees(vectors):
    """Makes check 3: compares with polynomials in x, y, z, then with
    mpmath.spherharm."""
    worst = mpf(0)
    count = 0
    with mp.workdps(DIGITS):
        for vector in vectors:
            x, y, z = (mpf(c) for c in vector)
            r = mp.sqrt(x * x + y * y + z * z)
            x, y, z = x / r, y / r, z / r
            pi, root = mp.pi, mp.sqrt
            table = {
                (0, 0): root(1 / (4 * pi)),
                (1, -1): root(3 / (4 * pi)) * y,
                (1, 0): root(3 / (4 * pi)) * z,
                (1, 1): root(3 / (4 * pi)) * x,
                (2, -2): root(15 / (4 * pi)) * x * y,
                (2, -1): root(15 / (4 * pi)) * y * z,
                (2, 0): root(5 / (16 * pi)) * (2 * z * z - x * x - y * y),
                (2, 1): root(15 / (4 * pi)) * x * z,
                (2, 2): root(15 / (16 * pi)) * (x * x - y * y),
                (3, -3): root(35 / (32 * pi)) * y * (3 * x * x - y * y),
                (3, -2): root(105 / (4 * pi)) * x * y * z,
                (3, -1): root(21 / (32 * pi)) * y * (4 * z * z - x * x - y * y),
                (3, 0): root(7 / (16 * pi)) * z * (2 * z * z - 3 * x * x - 3 * y * y),
                (3, 1): root(21 / (32 * pi)) * x * (4 * z * z - x * x - y * y),
                (3, 2): root(105 / (16 * pi)) * z * (x * x - y * y),
                (3, 3): root(35 / (32 * pi)) * x * (x * x - 3 * y * y),
            }
            got = recurrence(vector, {m: set(range(m, 4)) for m in range(4)})
            assert got.keys() == table.keys()
            for key, value in table.items():
                d = relative(got[key], value)
                assert d < mpf("1e-50"), ("polynomial", vector, key, d)
                worst, count = max(worst, d), count + 1

            if not rho_is_generic(vector):
                continue
            theta, phi = mp.atan2(mp.hypot(x, y), z), mp.atan2(y, x)
            degrees = (4, 7, 12, 20)
            got = recurrence(vector, {m: {l for l in degrees if l >= m} for m in range(21)})
            for l in degrees:
                for m in range(l + 1):
                    v = mp.spherharm(l, m, theta, phi)
                    sign = mpf(-1) ** m
                    pair = ((m, mp.sqrt(2) * sign * v.real), (-m, mp.sqrt(2) * sign * v.imag)) \
                        if m else ((0, v.real),)
                    for signed, value in pair:
                        d = relative(got[l, signed], value)
                        assert d < mpf("1e-50"), ("spherharm", vector, l, signed, d)
                        worst, count = max(worst, d), count + 1
    return count, worst


def rho_is_generic(vector):
    """Returns whether a direction is far from poles, equator and seams. There,
    spherharm is accurate to all digits."""
    return min(abs(c) for c in vector) > 0.02


def check_addition(vector, l=2000):
    """Makes check 4, the addition theorem, for one direction."""
    with mp.workdps(DIGITS):
        values = recurrence(vector, {m: {l} for m in range(l + 1)})
        assert len(values) == 2 * l + 1
        total = mp.fsum(v * v for v in values.values())
        d = relative(total, (2 * l + 1) / (4 * mp.pi))
        assert d < mpf("1e-60"), ("addition theorem", vector, d)
        return d


def main():
    parser = argparse.ArgumentParser(description="Make reference.csv (see the docstring).")
    parser.add_argument("--check", action="store_true",
                        help="compare with the file there is, write nothing")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    args = parser.parse_args()
    path = pathlib.Path(__file__).with_name("reference.csv")
    start = time.time()

    jobs = directions()
    vectors = [v for _, v in jobs]
    assert len({repr(v) for v in vectors}) == len(vectors)
    octants = {tuple(c > 0 for c in v) for v in vectors if rho_is_generic(v)}
    assert len(octants) == 8, octants

    with multiprocessing.Pool(args.jobs) as pool:
        additions = pool.map_async(check_addition, [vectors[-8], vectors[11]], chunksize=1)
        low = pool.apply_async(check_low_degrees, (vectors,))
        results = pool.map(one_direction, jobs, chunksize=1)
        additions, (low_count, low_worst) = additions.get(), low.get()

    out = io.StringIO()
    out.write(HEADER)
    for text, _, _ in results:
        out.write(text)
    data = out.getvalue().encode("ascii")
    rows = sum(count for _, count, _ in results)

    def worst(key):
        return mp.nstr(max(seen[key] for _, _, seen in results), 3)

    print(f"{len(vectors)} directions, {rows} rows, {len(data)} bytes, {time.time() - start:.0f} s")
    print(f"exactly zero: {sum(s['zeros'] for _, _, s in results)}; "
          f"written 0 for being below 1e-320: {sum(s['tiny'] for _, _, s in results)}")
    print(f"1. {DIGITS} against {2 * DIGITS} digits: worst relative {worst('precision')}")
    print(f"2. finite sum: worst relative {worst('formula')}; at exact zeros {worst('zero')}")
    print(f"3. polynomials and spherharm: {low_count} values, worst relative {mp.nstr(low_worst, 3)}")
    print(f"4. addition theorem at 2000: relative {', '.join(mp.nstr(d, 3) for d in additions)}")
    assert len(data) < SIZE_LIMIT, "too large: thin out more"

    if args.check:
        same = path.read_bytes() == data
        print("same as the file" if same else "DIFFERS from the file")
        return 0 if same else 1
    path.write_bytes(data)
    return 0


if __name__ == "__main__":
    sys.exit(main())
