"""Any argument gives a result or one of the documented exceptions, and arguments are never modified."""

from __future__ import annotations

import warnings
from typing import Any, Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import spharm_rs as sp

BALL = sp.icosphere(1)
TRANSFORM = sp.Transform(BALL.vertices, 3)
CUBE = sp.Model(np.sin(np.arange(48.0)).reshape(16, 3))

dtypes = st.sampled_from(["f8", "f4", "i4", "u1", "c16", "?", "O", "U3", "i8"])
shapes = hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=6) | st.sampled_from([(42, 3), (42,), (16, 3), (80, 3)])


@st.composite
def arrays(draw: Any) -> Any:
    dtype = draw(dtypes)
    elements = None if dtype != "O" else st.none() | st.integers(-3, 50) | st.text(max_size=2)
    array = draw(hnp.arrays(np.dtype(dtype), draw(shapes), elements=elements))
    return draw(st.sampled_from([array, np.asfortranarray(array), array[::-1] if array.ndim else array]))


anything = arrays() | st.none() | st.integers() | st.floats() | st.text(max_size=3) | st.just(BALL) | st.just(BALL.vertices)

CALLS: dict[str, Callable[[Any, Any], Any]] = {
    "surface": lambda a, b: sp.Surface(a, b),
    "fit": lambda a, b: sp.fit(a, b, 2),
    "fit pair": lambda a, b: sp.fit((BALL.vertices, a), b, 2),
    "fit bare": lambda a, b: sp.fit((a, b), max_degree=2),
    "fit weights": lambda a, b: sp.fit(BALL, BALL, 2, weights=a, smoothness=b),
    "fit degree": lambda a, b: sp.fit(BALL, BALL, a if not isinstance(a, int) or a < 40 else 40, hold_out=b),
    "fit many": lambda a, b: sp.fit_many([a], b, 2) if not isinstance(a, str) else None,
    "solve": lambda a, b: sp.solve(a, b, 2),
    "synthesis": lambda a, b: TRANSFORM.synthesis(a),
    "adjoint": lambda a, b: TRANSFORM.adjoint(a),
    "normal": lambda a, b: TRANSFORM.normal(a, b),
    "transform": lambda a, b: sp.Transform(a, 2, accuracy=b),
    "model": lambda a, b: sp.Model(a, sphere=b),
    "evaluate": lambda a, b: sp.Model(np.ones((9, 3))).evaluate(a, degree=b),
    "parametrize": lambda a, b: sp.parametrize((a, b)),
    "volume": lambda a, b: sp.parametrize_volume(a, affine=b),
    "resample": lambda a, b: sp.resample(BALL, a, b if not isinstance(b, str) else "icosphere:1"),
    "rotate": lambda a, b: sp.shape.rotate(CUBE, parameters=a, object=b),
    "move": lambda a, b: sp.shape.rotate(CUBE, translation=a, scale=b),
    "align": lambda a, b: sp.shape.align(CUBE, sp.Model(a), degree=b),
    "group": lambda a, b: sp.shape.pca([CUBE, CUBE, sp.Model(a, surface=True)], modes=b).shape(b),
    "measure group": lambda a, b: sp.shape.measure_group([CUBE, CUBE], 3 if isinstance(a, int) else a, degree=b),
    "test": lambda a, b: sp.shape.test(a, b, permutations=9),
    "test values": lambda a, b: sp.shape.test(BALL.vertices, effect=a, covariates=b, permutations=9),
    "test design": lambda a, b: sp.shape.test(BALL.vertices, design=a, contrast=b, permutations=9),
    "compare": lambda a, b: sp.compare(a, b, surface_distance=True, samples=10),
}


@pytest.mark.parametrize("name", CALLS)
@given(a=anything, b=anything)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_only_documented_exceptions_come_out(name: str, a: Any, b: Any) -> None:
    before = [np.copy(x) if isinstance(x, np.ndarray) else x for x in (a, b)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            CALLS[name](a, b)
        except (ValueError, TypeError, sp.SpharmError, OSError):
            pass
    for x, y in zip((a, b), before):
        if isinstance(x, np.ndarray) and x.dtype != object:
            np.testing.assert_array_equal(x, y)


def test_shapes_are_named() -> None:
    with pytest.raises(ValueError, match=r"vertices: expected shape \(n, 3\), found \(4, 2\)"):
        sp.Surface(np.zeros((4, 2)), BALL.faces)
    with pytest.raises(ValueError, match=r"weights: expected shape \(42,\), found \(41,\)"):
        sp.fit(BALL, BALL, 2, weights=np.ones(41))
    with pytest.raises(ValueError, match="found 42 rows|42"):
        sp.fit(np.ones(41), BALL, 2)
    with pytest.raises(sp.MeshError, match="vertex"):
        sp.fit((BALL.vertices[:10], BALL.faces), max_degree=2)


def test_unaligned_arrays_are_copied() -> None:
    """Buffers from other processes, such as Dask's workers, may be unaligned."""

    def unaligned(array: Any) -> Any:
        buffer = bytearray(array.nbytes + 1)
        moved = np.frombuffer(buffer, array.dtype, array.size, offset=1).reshape(array.shape)
        moved.flags.writeable = True
        moved[...] = array
        assert not moved.flags.aligned
        return moved

    surface = sp.Surface(unaligned(BALL.vertices), unaligned(BALL.faces))
    found = sp.fit(surface, unaligned(BALL.vertices), 3, weights=unaligned(np.ones(len(BALL.vertices))))
    assert np.allclose(found.coefficients, sp.fit(BALL, BALL, 3).coefficients, rtol=0, atol=1e-14)
    volume = np.zeros((9, 9, 9), np.int32)
    volume[3:6, 3:6, 3:6] = 1
    assert sp.parametrize_volume(unaligned(volume)).sphere is not None
