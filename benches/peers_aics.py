"""Tests of aics-shparam, reproduced through spharm_rs: examples in its package, and tests of AllenCell/aics-shparam.

aics-shparam samples the radius of a surface around its centre at 128 x 256 points, and expands it with the quadrature
of Driscoll and Healy, which is least squares with that quadrature's weights. Its coefficients are 4 pi-normalised,
without the Condon-Shortley phase; its azimuths begin at -x.
"""

import warnings

import numpy as np
import spharm_rs as sp
from aicsshparam import shparam, shtools
from peers_common import compare, driscoll_healy, fit, grid_directions
from peers_pyshtools import canonical
from scipy.interpolate import griddata
from skimage import morphology, transform
from sklearn.decomposition import PCA
from spharm_rs import convert
from vtk.util import numpy_support

ROWS, COLUMNS = 128, 256


def named(coefficients):
    """Returns canonical coefficients, (K,), under the package's names, which include orders above the degree."""
    cilm = convert.to_pyshtools(coefficients)[0] / np.sqrt(4 * np.pi)
    return {f"shcoeffs_L{l}M{m}{'CS'[s]}": value for (s, l, m), value in np.ndenumerate(cilm)}


def radii(image, dtype):
    """Samples the radius of the surface of an image, as `shparam.get_shcoeffs` does, computed in float32 or float64."""
    mesh, _, _ = shtools.get_mesh_from_image(image)
    points = numpy_support.vtk_to_numpy(mesh.GetPoints().GetData()).astype(dtype)
    radius = np.sqrt((points**2).sum(axis=1))
    longitude = np.pi + np.arctan2(points[:, 1], points[:, 0])
    at = np.column_stack([longitude, np.arccos(points[:, 2] / radius)])
    grid = np.meshgrid(np.linspace(0, 2 * np.pi, COLUMNS), np.linspace(0, np.pi, ROWS))
    return griddata(at, radius, tuple(grid), method="nearest").astype(float)


def fitted(radius, degree):
    directions, weights = driscoll_healy(ROWS, COLUMNS)
    return fit(directions, radius.ravel(), degree, weights)


def synthesis(coefficients, degree):
    """Returns the radius on pyshtools' smallest grid for a degree, (2 L + 2, 4 L + 4)."""
    rows = 2 * degree + 2
    at = grid_directions(np.arange(rows) * np.pi / rows, np.arange(2 * rows) * np.pi / rows)
    model = sp.Model(coefficients[:, np.newaxis], surface=False)
    return model.evaluate(at, degree=min(degree, model.max_degree)).reshape(rows, 2 * rows)


#: Coefficients and error that the docstring prints; its other coefficients are 0.
CUBE = {
    "shcoeffs_L0M0C": 18.31594310878251, "shcoeffs_L1M0C": 0.020438775421611564,
    "shcoeffs_L1M1C": -0.0030960466571801513, "shcoeffs_L2M0C": -0.0185688727281408,
    "shcoeffs_L2M1C": -2.9925077712704384e-05, "shcoeffs_L2M2C": -0.009087503958673892,
    "shcoeffs_L1M1S": 3.799611612562637e-05, "shcoeffs_L2M1S": 3.672543904347801e-07,
    "shcoeffs_L2M2S": 0.0002230857005948496,
}  # fmt: skip
CUBE_ERROR = 2.3738182456948795


def cube():
    """aicsshparam/shparam.py: example of get_shcoeffs (0.1.11)

    The numbers that the docstring prints come from radii in float64; version 0.1.11 computes them in float32.
    """
    image = np.ones((32, 32, 32), dtype=np.uint8)
    (coefficients, grid), (prepared, _, given, _) = shparam.get_shcoeffs(image=image, lmax=2)
    radius = radii(prepared, np.float64)
    found = fitted(radius, 2)
    yield compare("coefficients printed", [named(found)[name] for name in CUBE], list(CUBE.values()))
    modelled = synthesis(found, 2)
    small = transform.resize(radius, modelled.shape, preserve_range=True)
    yield compare("error printed", ((small - modelled) ** 2).mean(), CUBE_ERROR)
    found = fitted(radii(prepared, np.float32), 2)
    rounded = [named(found)[name] for name in CUBE]
    yield compare("coefficients printed, float32", rounded, list(CUBE.values()), 1e-8, "radii rounded as by 0.1.11")
    yield compare("coefficients returned", list(named(found).values()), list(coefficients.values()))
    yield compare("grid returned", synthesis(found, 2), grid)
    known = shtools.get_reconstruction_error(given, grid)
    yield compare("error returned", ((given - synthesis(found, 2)) ** 2).mean(), known)


def random_shapes(count):
    """Yields the README's shapes: balls, cubes and octahedra of random sizes, rotated about z."""
    generator = np.random.RandomState(42)
    for _ in range(count):
        kind = generator.choice([0, 1, 2], 1)[0]
        size = 10 + int(10 * generator.rand())
        # scikit-image has no `cube` any more.
        make = (morphology.ball, lambda width: np.ones((width,) * 3, dtype=np.uint8), morphology.octahedron)[kind]
        image = np.pad(make(size), 1)[np.newaxis]
        yield ("ball", "cube", "octahedron")[kind], shtools.rotate_image_2d(image, 360 * generator.rand()).squeeze()


def shapes():
    """README.md: How to use (0.1.11)

    The README's seed: 30 shapes at degree 4, then two principal components, whose signs are arbitrary.
    """
    kinds, ours, theirs, modelled, grids = [], [], [], [], []
    for kind, image in random_shapes(30):
        (coefficients, grid), (prepared, *_) = shparam.get_shcoeffs(image=image, lmax=4)
        found = fitted(radii(prepared, np.float32), 4)
        kinds.append(kind)
        ours.append(list(named(found).values()))
        theirs.append(list(coefficients.values()))
        modelled.append(synthesis(found, 4))
        grids.append(grid)
    ours, theirs = np.array(ours), np.array(theirs)
    for kind in ("ball", "cube", "octahedron"):
        rows = np.array(kinds) == kind
        yield compare(f"coefficients, {kind} ({rows.sum()} images)", ours[rows], theirs[rows])
    yield compare("grids of the models", modelled, grids)
    scores = [abs(PCA(2, svd_solver="full").fit_transform(table)) for table in (ours, theirs)]
    yield compare("PC1 and PC2", *scores)


def random_coefficients(count, degree, seed):
    """Returns the tests' random coefficients, with 5 at degree 0, (count, 2, L + 1, L + 1)."""
    found = np.tril(np.random.default_rng(seed).normal(size=(count, 2, degree + 1, degree + 1)))
    found[:, 1, :, 0] = 0
    found[:, 0, 0, 0] = 5
    return found


def reconstructions():
    """aicsshparam/tests/test_shapespace.py: random_shcoeffs_dataframe (4c1ee977)

    The tests' coefficients, of degree 16, through the reconstructions of `shtools`. `get_reconstruction_from_coeffs`
    rounds coefficients to float32; so they are rounded here. Its `lrec` is a number of degrees.
    """
    exact = random_coefficients(1, 16, 16)[0]
    rounded = exact.astype(np.float32).astype(float)
    for lrec in (17, 8, 32):
        _, known = shtools.get_reconstruction_from_coeffs(exact, lrec=lrec)
        yield compare(f"get_reconstruction_from_coeffs, lrec={lrec}", synthesis(canonical(rounded), lrec - 1), known)
    _, known = shtools.get_even_reconstruction_from_coeffs(exact, npoints=64)
    yield compare("get_even_reconstruction_from_coeffs", synthesis(canonical(exact), 16), known)


def shape_space():
    """aicsshparam/tests/test_shapespace.py: test_shapespace, test_shapespace_transform (4c1ee977)

    `shapespace` isn't in the package; what it computes is scikit-learn's PCA of the coefficients. `shape.pca` leaves
    out degree 0, which is constant in the test. Signs are arbitrary.
    """
    members, others = random_coefficients(100, 16, 1), random_coefficients(100, 16, 2)
    pca = PCA(8, svd_solver="full").fit(members.reshape(100, -1))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the surfaces are not aligned", sp.SpharmWarning)
        modes = sp.shape.pca([along_x(cilm) for cilm in members], modes=8)
    yield compare("variances", modes.variances, pca.explained_variance_)
    yield compare("scores", abs(modes.scores), abs(pca.transform(members.reshape(100, -1))))
    found = [modes.project(along_x(cilm))[0] for cilm in others]
    yield compare("scores of other shapes", np.abs(found), abs(pca.transform(others.reshape(100, -1))))


def along_x(cilm):
    """Returns a surface whose x is the radius, since `shape.pca` is for surfaces."""
    coefficients = canonical(cilm)
    return sp.Model(np.column_stack([coefficients, np.zeros((len(coefficients), 2))]))


TESTS = [cube, shapes, reconstructions, shape_space]
