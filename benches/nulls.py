"""Simulates studies without an effect, for each design; measures the share with a family-wise p of at most 0.05.

Used by `./run bench statistics` and by the part `statistics` of `./run attack`. Values are smooth random fields at the
vertices of an icosphere, drawn anew for each study.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Callable

import numpy as np
import spharm_rs as sp

#: Number of random relabellings in a study. p values are multiples of 1 / (count + 1) = 1 / 200, so 0.05 is one of
#: them.
RELABELLINGS = 199


def smooth_fields(vertices_level: int = 3, degree: int = 12) -> Callable[[np.random.Generator, int], np.ndarray]:
    """Returns a function that draws n smooth fields, (n, V), of unit variance."""
    directions = sp.icosphere(vertices_level).vertices
    basis = sp.Transform(directions, degree).synthesis(np.eye((degree + 1) ** 2))
    l = np.floor(np.sqrt(np.arange(basis.shape[1])))
    basis = basis * np.exp(-0.02 * l * (l + 1))
    basis /= np.sqrt((basis**2).sum(1, keepdims=True))
    return lambda rng, n: rng.normal(size=(n, basis.shape[1])) @ basis.T


@dataclass
class Null:
    """A design, and the effect that is tested in it."""

    name: str
    arguments: Callable[[np.random.Generator], dict]
    n: int = 24
    components: int = 1
    #: Standard deviation of each subject's values.
    sd: np.ndarray | None = None
    #: Smallest and largest share of studies that may have a family-wise p of at most 0.05.
    bounds: tuple[float, float] = (0.03, 0.07)
    options: dict = field(default_factory=dict)


def _designs(design, contrast):
    return lambda rng: {"design": design(rng), "contrast": contrast}


def _two(a, b):
    return np.repeat(np.eye(2), [a, b], axis=0)


def _age(rng, n, centre=40.0):
    return rng.uniform(centre - 20, centre + 20, n)


def nulls() -> list[Null]:
    """Returns the fifteen designs with equal variances: five that failed in an earlier version, and ten more."""
    two = _two(12, 12)
    ones = np.ones((24, 1))
    three = np.repeat(np.eye(3), 8, axis=0)
    sign = np.repeat([[1.0], [-1.0]], 12, axis=0)

    def with_age(base, centred=True):
        def make(rng):
            age = _age(rng, len(base))[:, None]
            return np.hstack([base, age - age.mean() if centred else age])

        return make

    def interaction(rng):
        age = _age(rng, 24)[:, None]
        return np.hstack([two, two * (age - age.mean())])

    return [
        Null("means of two groups, the first", _designs(lambda rng: two, [1, 0])),
        Null("constant and +-1, the constant", _designs(lambda rng: np.hstack([ones, sign]), [1, 0])),
        Null("constant and age about 2, the constant",
             _designs(lambda rng: np.hstack([ones, rng.normal(2, 1, (24, 1))]), [1, 0])),
        Null("mean and age about its mean, the mean", _designs(with_age(ones), [1, 0])),
        Null("means of two groups, their difference", _designs(lambda rng: two, [1, -1])),
        Null("means of two groups, half of their sum", _designs(lambda rng: two, [0.5, 0.5])),
        Null("means of two groups, F of both", _designs(lambda rng: two, [[1, 0], [0, 1]])),
        Null("a mean", lambda rng: {"mean": True}),
        Null("means of three groups, the last", _designs(lambda rng: three, [0, 0, 1])),
        Null("means of three groups, F of differences", _designs(lambda rng: three, [[1, -1, 0], [0, 1, -1]])),
        Null("means of 5 and 19, the first", _designs(lambda rng: _two(5, 19), [1, 0])),
        Null("slope of age", lambda rng: {"effect": _age(rng, 24)}),
        Null("two groups with age, their difference", _designs(with_age(two), [1, -1, 0])),
        Null("two groups with slopes, the slopes' difference", _designs(interaction, [0, 0, 1, -1])),
        Null("mean and age, the mean of positions", _designs(with_age(ones), [1, 0]), components=3),
    ]  # fmt: skip


def unequal() -> list[Null]:
    """Returns pairs of groups of unequal size, with unequal variances and with equal ones, tested by Welch's test."""

    def groups(a, b):
        return lambda rng: {"groups": [0] * a + [1] * b, "welch": True}

    found = []
    cases = [(5, 15, 2, 0.08), (20, 60, 2, 0.06), (10, 30, 2, 0.08), (15, 5, 2, 0.08), (20, 20, 2, 0.08), (20, 60, 1, 0.08)]
    for a, b, ratio, most in cases:
        for components, of in [(1, "t"), (3, "T^2")]:
            sd = np.repeat([ratio, 1.0], [a, b])
            name = f"{a} and {b}, sd {ratio:g} : 1, Welch's {of}"
            found.append(Null(name, groups(a, b), n=a + b, components=components, sd=sd, bounds=(0.0, most)))
    return found


def rate(null: Null, studies: int, fields, seed: int = 0, first: int = 0) -> float:
    """Returns the share of studies, numbered from `first`, with a family-wise p of at most 0.05."""
    hits = 0
    for study in range(first, first + studies):
        rng = np.random.default_rng([seed, study])
        values = np.stack([fields(rng, null.n) for _ in range(null.components)], axis=2)
        if null.sd is not None:
            values *= null.sd[:, None, None]
        values = values[:, :, 0] if null.components == 1 else values
        found = sp.shape.group_test(values, **null.arguments(rng), permutations=RELABELLINGS, seed=study, **null.options)
        hits += found.p_fwe.min() <= 0.05
    return hits / studies


def power(a: int, b: int, welch: bool, studies: int, fields, components: int = 1, effect: float = 1.2) -> float:
    """Returns the share of studies that find an effect of this many standard deviations on a cap of the sphere."""
    directions = sp.icosphere(3).vertices
    cap = effect * np.exp(-0.5 * (np.arccos(np.clip(directions[:, 2], -1, 1)) / 0.3) ** 2)
    hits = 0
    for study in range(studies):
        rng = np.random.default_rng([17, study])
        values = np.stack([fields(rng, a + b) for _ in range(components)], axis=2)
        values[:a, :, 0] += cap
        values = values[:, :, 0] if components == 1 else values
        found = sp.shape.group_test(values, groups=[0] * a + [1] * b, welch=welch, permutations=RELABELLINGS, seed=study)
        hits += found.p_fwe.min() <= 0.05
    return hits / studies
