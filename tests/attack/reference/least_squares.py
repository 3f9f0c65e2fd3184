"""Least squares with spherical harmonics in 50 decimal digits: the reference for `numerics.py`.

Harmonics are real and orthonormal, without the Condon-Shortley phase, in row l^2 + l + m, with sin(|m| phi) for
negative m. They are computed by recurrences of Legendre functions in x, y and z. Problems are solved by Householder's
QR with column pivoting. Uses Python's standard library only.
"""

from decimal import Decimal, getcontext

getcontext().prec = 50
ZERO, ONE, TWO = Decimal(0), Decimal(1), Decimal(2)
PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
# Columns whose norm is below this share of the largest are treated as zero; that is far below the rounding errors of
# f64.
NOTHING = Decimal(10) ** -40


def sine_cosine(angle: float) -> tuple[Decimal, Decimal]:
    """Returns sine and cosine of an angle of a few radians, by their series."""
    x = Decimal(angle)
    sine, cosine, term, k = ZERO, ZERO, ONE, 0
    while k < 20 or abs(term) > NOTHING * NOTHING:
        part = term if k % 4 < 2 else -term
        if k % 2:
            sine += part
        else:
            cosine += part
        k += 1
        term = term * x / k
    return sine, cosine


def harmonics(theta: float, phi: float, degree: int) -> list[Decimal]:
    """Returns all harmonics up to a degree at a direction, in canonical order."""
    (st, ct), (sp, cp) = sine_cosine(theta), sine_cosine(phi)
    row = [ZERO] * (degree + 1) ** 2
    cosines, sines = [ONE], [ZERO]
    for _ in range(degree):
        cosines.append(cosines[-1] * cp - sines[-1] * sp)
        sines.append(sines[-1] * cp + cosines[-2] * sp)
    start = ONE  # P_mm without the phase
    for m in range(degree + 1):
        below, legendre = ZERO, start
        factorials = ONE  # (l - m)! / (l + m)!
        for k in range(1, 2 * m + 1):
            factorials /= k
        for l in range(m, degree + 1):
            norm = (Decimal(2 * l + 1) / (4 * PI) * factorials * (ONE if m == 0 else TWO)).sqrt()
            row[l * l + l + m] = norm * legendre * cosines[m]
            if m:
                row[l * l + l - m] = norm * legendre * sines[m]
            below, legendre = legendre, ((2 * l + 1) * ct * legendre - (l + m) * below) / (l + 1 - m)
            factorials = factorials * (l + 1 - m) / (l + 1 + m)
        start = start * (2 * m + 1) * st
    return row


def dot(a: list[Decimal], b: list[Decimal]) -> Decimal:
    return sum((x * y for x, y in zip(a, b)), ZERO)


class Problem:
    """The problem min sum w (f - A x)^2 + sum p x^2: rows of A, weights w, targets f, and penalty p of each column."""

    def __init__(self, rows: list[list[Decimal]], weights: list[float], targets: list[float], penalty: list[Decimal]):
        self.rows, self.penalty = rows, penalty
        self.weights = [Decimal(w) for w in weights]
        self.targets = [Decimal(f) for f in targets]

    def residual(self, x: list[Decimal]) -> list[Decimal]:
        return [f - dot(row, x) for f, row in zip(self.targets, self.rows)]

    def objective(self, x: list[Decimal]) -> Decimal:
        squares = sum((w * r * r for w, r in zip(self.weights, self.residual(x))), ZERO)
        return squares + sum((p * a * a for p, a in zip(self.penalty, x)), ZERO)

    def gradient(self, x: list[Decimal]) -> list[Decimal]:
        """Returns A^T W (f - A x) - P x."""
        found = [-p * a for p, a in zip(self.penalty, x)]
        for w, r, row in zip(self.weights, self.residual(x), self.rows):
            for k, s in enumerate(row):
                found[k] += w * r * s
        return found

    def optimality(self, x: list[Decimal]) -> Decimal:
        """Returns |gradient| / |A^T W f|, the quantity that the program's tolerance limits."""
        scale = norm(self.gradient([ZERO] * len(x)))
        return norm(self.gradient(x)) / scale if scale else ZERO

    def solve(self, columns: range | None = None) -> tuple[list[Decimal], Decimal, int]:
        """Solves the problem in some of the columns; returns the solution (a basic one if the problem is singular), its
        condition and its rank."""
        chosen = list(columns) if columns is not None else list(range(len(self.penalty)))
        roots = [w.sqrt() for w in self.weights]
        matrix = [[root * row[k] for k in chosen] for root, row in zip(roots, self.rows) if root]
        right = [root * f for root, f in zip(roots, self.targets) if root]
        for at, k in enumerate(chosen):
            if self.penalty[k]:
                matrix.append([self.penalty[k].sqrt() if at == j else ZERO for j in range(len(chosen))])
                right.append(ZERO)
        solution, condition, rank = least_squares(matrix, right)
        x = [ZERO] * len(self.penalty)
        for k, value in zip(chosen, solution):
            x[k] = value
        return x, condition, rank


def norm(vector: list[Decimal]) -> Decimal:
    return dot(vector, vector).sqrt()


def least_squares(matrix: list[list[Decimal]], right: list[Decimal]) -> tuple[list[Decimal], Decimal, int]:
    """Solves by Householder's QR with column pivoting: returns solution, |R_11 / R_rr| and the rank r."""
    columns = [list(column) for column in zip(*matrix)]
    right, order = list(right), list(range(len(columns)))
    rank, diagonal = 0, []
    for step in range(min(len(right), len(columns))):
        sizes = [dot(column[step:], column[step:]) for column in columns[step:]]
        best = step + max(range(len(sizes)), key=sizes.__getitem__)
        size = sizes[best - step].sqrt()
        if not size or (diagonal and size < NOTHING * diagonal[0]):
            break
        columns[step], columns[best] = columns[best], columns[step]
        order[step], order[best] = order[best], order[step]
        pivot = columns[step]
        reflector = pivot[step:]
        reflector[0] += size if reflector[0] >= 0 else -size
        square = dot(reflector, reflector)
        for column in [*columns[step:], right]:
            factor = 2 * dot(reflector, column[step:]) / square
            for k, value in enumerate(reflector):
                column[step + k] -= factor * value
        diagonal.append(abs(pivot[step]))
        rank += 1
    solution = [ZERO] * len(columns)
    for step in reversed(range(rank)):
        known = sum((columns[k][step] * solution[order[k]] for k in range(step + 1, rank)), ZERO)
        solution[order[step]] = (right[step] - known) / columns[step][step]
    condition = diagonal[0] / diagonal[-1] if diagonal else ZERO
    return solution, condition, rank
