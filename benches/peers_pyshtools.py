"""Tests of pyshtools, reproduced through spharm_rs: the programs in examples/ of SHTOOLS/SHTOOLS, which are its tests.

Most of them draw random inputs without a seed; here all have one. Some read MarsTopo719.shape, which isn't in the wheel
of pyshtools: a random field replaces it.
"""

import numpy as np
import pyshtools as sh
import spharm_rs as sp
from peers_common import compare, driscoll_healy, fit, gauss_legendre, rotate, wigner
from scipy.special import gammaln
from spharm_rs import convert, spectra


def canonical(cilm, normalization="4pi", csphase=1):
    """Converts pyshtools' coefficients, (2, L + 1, L + 1), to canonical ones, (K,)."""
    l, m = np.indices(np.shape(cilm)[1:])
    exists, m = m <= l, np.minimum(l, m)
    if normalization == "unnorm":
        square = 4 * np.pi / (2 * l + 1) * np.exp(gammaln(l + m + 1) - gammaln(l - m + 1)) / np.where(m, 2, 1)
    else:
        square = {"ortho": 1, "4pi": 4 * np.pi, "schmidt": 4 * np.pi / (2 * l + 1)}[normalization]
    sign = np.where(m % 2, csphase, 1)
    return convert.from_pyshtools(np.where(exists, cilm * sign * np.sqrt(square), 0))[:, 0]


def normal(degree, generator):
    """Returns normally distributed coefficients, with zeros where there is no harmonic, (2, L + 1, L + 1)."""
    cilm = np.tril(generator.normal(size=(2, degree + 1, degree + 1)))
    cilm[1, :, 0] = 0
    return cilm


def inverse_square(degree):
    """Returns the power l^-2, with 0 at degree 0."""
    degrees = np.arange(degree + 1, dtype=float)
    degrees[0] = np.inf
    return degrees**-2


def quadrature(grid, degree):
    """Returns the directions and weights of a grid of pyshtools."""
    if grid == "GLQ":
        return gauss_legendre(degree)
    size = 2 * degree + 2
    return driscoll_healy(size, {"DH": size, "DH2": 2 * size}[grid])


def transforms():
    """examples/python/ducctest.py: test_SHT (35e52a6f)

    Uses the test's seed, and the first of its degrees.
    """
    yield from transformed(127, ("ortho", "4pi", "schmidt"))


def transforms_unnormalised():
    """examples/python/ducctest.py: test_SHT, unnorm (35e52a6f)

    Uses the test's seed, and the last of its degrees.
    """
    yield from transformed(85, ("unnorm",))


def transformed(degree, normalizations):
    """Compares grids and coefficients of a field in each normalisation, with and without the Condon-Shortley phase."""
    random = sh.SHCoeffs.from_random(inverse_square(2 * degree), seed=12345)
    conventions = [{"normalization": n, "csphase": p} for n in normalizations for p in (-1, 1)]
    fields = [random.convert(lmax=degree, **convention) for convention in conventions]
    given = np.stack([canonical(f.to_array(), **convention) for f, convention in zip(fields, conventions)], 1)
    for kind in ("GLQ", "DH", "DH2"):
        directions, weights = quadrature(kind, degree)
        grids = [field.expand(grid=kind, extend=False) for field in fields]
        values = np.stack([grid.to_array().ravel() for grid in grids], 1)
        yield compare(f"{kind} grid, degree {degree}", sp.Transform(directions, degree).synthesis(given), values)
        known = np.stack([canonical(grid.expand().to_array()) for grid in grids], 1)
        yield compare(f"{kind} coefficients, degree {degree}", fit(directions, values, degree, weights), known)


def accuracy_glq():
    """examples/python/TimingAccuracy/TimingAccuracyGLQ.py: TimingAccuracyGLQ (04de1342)

    Uses the test's first degrees, powers of 2.
    """
    degree = 128
    cilm = power_law(np.random.RandomState(0), degree)
    for lmax in (2, 16, degree):
        known, (zeros, weights) = cilm[:, : lmax + 1, : lmax + 1], sh.expand.SHGLQ(lmax)
        values = sh.expand.MakeGridGLQ(known, zeros)
        directions, ours = gauss_legendre(lmax)
        found = fit(directions, values.ravel(), lmax, ours)
        yield compare(f"SHExpandGLQ, degree {lmax}", found, canonical(sh.expand.SHExpandGLQ(values, weights, zeros)))


def accuracy_dh():
    """examples/python/TimingAccuracy/TimingAccuracyDH.py: TimingAccuracyDH (353c2d33)

    Uses the test's first degrees, powers of 2. The seed gives other coefficients than in the test, because here they
    are drawn only to a lower degree.
    """
    degree = 128
    cilm = power_law(np.random.RandomState(0), degree)
    for lmax in (2, 16, degree):
        values = sh.expand.MakeGridDH(cilm[:, : lmax + 1, : lmax + 1], sampling=2)
        directions, weights = quadrature("DH2", lmax)
        found = fit(directions, values.ravel(), lmax, weights)
        yield compare(f"SHExpandDH, degree {lmax}", found, canonical(sh.expand.SHExpandDH(values, sampling=2)))


def power_law(generator, degree):
    cilm = normal(degree, generator)
    power = 1 / (1 + np.arange(degree + 1)) ** 1.5
    return cilm * np.sqrt(power / sh.spectralanalysis.spectrum(cilm))[:, np.newaxis]


def least_squares():
    """examples/fortran/SHExpandLSQ/TestSHExpandLSQ.f95: TestSHExpandLSQ (3a7507fd)

    Uses 400 points, from a uniform distribution in a cube, and a field of degree 120 in place of the topography of
    Mars.
    """
    generator, degree = np.random.default_rng(13453), 120
    directions = generator.uniform(-1, 1, (400, 3))
    latitude, longitude = spectra.latitude_longitude(directions)
    field = sh.SHCoeffs.from_random(inverse_square(degree), seed=13453)
    values = field.expand(lat=latitude, lon=longitude)
    found = sp.Transform(directions, degree).synthesis(canonical(field.to_array()))
    yield compare("MakeGridPoint, degree 120", found, values)
    for lmax in (1, 5, 10, 15, 18):
        cilm, chi2 = sh.expand.SHExpandLSQ(values, latitude, longitude, lmax)
        found = fit(directions, values, lmax)
        yield compare(f"SHExpandLSQ, degree {lmax}", found, canonical(cilm))
        residual = values - sp.Transform(directions, lmax).synthesis(found)
        yield compare(f"sum of squared residuals, degree {lmax}", (residual**2).sum(), chi2)
    # The test's last degree; even a dense solution differs from pyshtools' by 7e-10.
    cilm, _ = sh.expand.SHExpandLSQ(values, latitude, longitude, 19)
    found = fit(directions, values, 19, tolerance=1e-12)
    note = "400 points for 400 coefficients, condition number 1.5e6, which normal equations square"
    yield compare("SHExpandLSQ, degree 19", found, canonical(cilm), 1e-5, note)


def spectral_analysis():
    """examples/python/GlobalSpectralAnalysis/SHRealSpectralAnalysis.py: test_RealSpectralAnalysis (03030ebe)"""
    generator, degree = np.random.default_rng(5), 5
    a, b = normal(degree, generator), normal(degree, generator)
    f, g = canonical(a), canonical(b)
    analysis = sh.spectralanalysis
    for unit in ("per_l", "per_lm"):
        yield compare(f"spectrum, {unit}", spectra.spectrum(f, unit=unit), analysis.spectrum(a, unit=unit))
        known = analysis.cross_spectrum(a, b, unit=unit)
        yield compare(f"cross_spectrum, {unit}", spectra.cross_spectrum(f, g, unit=unit), known)
    admittance, error, correlation = analysis.SHAdmitCorr(a, b)
    found = spectra.admittance(f, g)
    yield compare("SHAdmitCorr, admittance", found, admittance)
    # No error can be estimated from the single coefficient of degree 0.
    yield compare("SHAdmitCorr, error from degree 1", found.error[1:], error[1:])
    found = spectra.correlation(f, g)
    yield compare("SHAdmitCorr, correlation", found, correlation)
    known = [analysis.SHConfidence(l, correlation[l]) for l in range(1, degree + 1)]
    yield compare("SHConfidence from degree 1", found.confidence[1:], np.ravel(known))


def exact_power():
    """examples/python/ClassInterface/exact_power.py: example (02f2f684)"""
    degrees = np.arange(201, dtype=float)
    degrees[0] = np.inf
    field = sh.SHCoeffs.from_random(degrees**-1, exact_power=True, seed=200)
    found = spectra.spectrum(canonical(field.to_array()))
    yield compare("spectrum, per_l", found, field.spectrum(unit="per_l"))
    yield compare("power asked for", found, degrees**-1)


def in_coordinates(coefficients, alpha, beta, gamma):
    """Rotates the coordinate system, as pyshtools does: the function rotates by the inverse."""
    return rotate(coefficients, [-gamma, -beta, -alpha])


def rotations():
    """examples/python/SHRotations/SHRotations.py: test_SHRotations (cd18eb26)"""
    degree, angles = 3, (20.0, 90.0, 90.0)
    halves, cilm = sh.rotate.djpi2(degree), normal(degree, np.random.default_rng(3))
    found = np.zeros(halves.shape)
    for l in range(degree + 1):
        # Orders from 0, for a rotation of the coordinates.
        found[: l + 1, : l + 1, l] = wigner(l, [0, -90, 0])[l:, l:].real
    yield compare("djpi2", found, halves)
    known = sh.rotate.SHRotateRealCoef(cilm, np.radians(angles), halves)
    yield compare("SHRotateRealCoef", in_coordinates(canonical(cilm), *angles), canonical(known))


def rotations_of_random_fields():
    """examples/python/ducctest.py: test_rot (35e52a6f)

    Uses the test's seed and angles, and the first of its degrees.
    """
    field = sh.SHCoeffs.from_random(inverse_square(127), seed=12345)
    known = field.rotate(47, 27, 59, degrees=True)
    found = in_coordinates(canonical(field.to_array()), 47, 27, 59)
    yield compare("SHCoeffs.rotate, degree 127", found, canonical(known.to_array()))


def conversions():
    """examples/python/IOStorageConversions/SHConversions.py: test_SHConversions (f8228680)"""
    cilm = normal(10, np.random.default_rng(10))
    parts = sh.shio.SHrtoc(cilm)
    a = convert.from_pyshtools(cilm)
    degrees, orders = convert.degrees_and_orders(10)
    from_zero = orders >= 0
    # SHrtoc leaves out the Condon-Shortley phase.
    complex_values = convert.to_complex(a)[from_zero, 0] * (-1.0) ** orders[from_zero]
    known = (parts[0] + 1j * parts[1])[degrees[from_zero], orders[from_zero]]
    yield compare("SHrtoc", complex_values, known)


def legendre():
    """examples/python/TestLegendre/TestLegendre.py: test_associatedlegendre (cd18eb26)

    The test's points; its normalisations "ON" and "Bar", of which the default is unnormalised.
    """
    degree, count = 40, 200
    theta = np.linspace(np.pi / count, np.pi - np.pi / count, count)
    degrees, orders = convert.degrees_and_orders(degree)
    # At longitude 0, harmonics of cosines are the Legendre functions; pyshtools holds them in the same order.
    unit = np.eye(len(degrees))[:, orders >= 0]
    directions = spectra.directions(colatitude=theta, longitude=np.zeros(count), degrees=False)
    found = sp.Transform(directions, degree).synthesis(unit)
    for name, scale in (("PlmON", 1.0), ("PlmBar", np.sqrt(4 * np.pi))):
        known = np.stack([getattr(sh.legendre, name)(degree, z) for z in np.cos(theta)])
        yield compare(f"{name}, degree 40", found * scale, known)


def coupling(window, degree):
    """Returns the matrix of pyshtools, (degree + L + 1, degree + 1), from the powers per degree of a window, (L + 1,).

    It maps sums over the orders of a degree, and that of spharm_rs maps means.
    """
    orders = 2.0 * np.arange(degree + len(window)) + 1
    means = spectra.coupling_matrix(4 * np.pi * window / orders[: len(window)], degree + len(window) - 1)
    return (orders[:, np.newaxis] * means / orders)[:, : degree + 1]


def wigner_symbols():
    """examples/python/Other/TestOther.py: TestWigner (1c64f698)

    Compares the squares of the test's first symbols. The second ones have orders, which spharm_rs doesn't support.
    """
    symbols, least, most = sh.utils.Wigner3j(4, 2, 0, 0, 0)
    unit = np.eye(most + 1)[least:]
    found = [coupling(window, 4)[2, 4] / 5 for window in unit]
    yield compare("Wigner3j(4, 2, 0, 0, 0)^2", found, symbols[: len(unit)] ** 2)


def coupling_matrix():
    """examples/python/LocalizedSpectralAnalysis/SHMTCouplingMatrix.py: test_CouplingMatrix (9e4a57df)"""
    window = np.hanning(11)
    known = sh.spectralanalysis.SHMTCouplingMatrix(30, window[:, np.newaxis])
    yield compare("SHMTCouplingMatrix, degree 30", coupling(window, 30), known)


def tapered_spectra():
    """examples/python/LocalizedSpectralAnalysis/SHMultitaperSE.py: test_MultitaperSE (c8610545)

    spharm_rs has no spherical Slepian functions, so the tapers are computed by pyshtools, and only the steps after that
    are compared. The test gives no location; pyshtools 4.14.1 then takes latitude 0, although its documentation states
    the north pole.
    """
    analysis, count = sh.spectralanalysis, 3
    tapers, _, orders = analysis.SHReturnTapers(np.radians(20), 20)
    few = tapers[:, :count], orders[:count]
    generator = np.random.default_rng(80)
    a = normal(80, generator)
    b = 0.5 * (a + normal(80, generator))
    for latitude, place in ((0.0, {}), (90.0, {"lat": 90.0, "lon": 0.0})):
        aa, ab, bb = tapered(a, b, *few, latitude)
        for name, ours, known in (
            ("SHMultiTaperSE", aa, analysis.SHMultiTaperSE(a, *few, **place)),
            ("SHMultiTaperCSE", ab, analysis.SHMultiTaperCSE(a, b, *few, **place)),
        ):
            error = ours.std(axis=1, ddof=1) / np.sqrt(count)
            yield compare(f"{name}, latitude {latitude:.0f}", ours.mean(axis=1), known[0])
            yield compare(f"{name}, latitude {latitude:.0f}, error", error, known[1])
    admittance, correlation, *_ = analysis.SHLocalizedAdmitCorr(a, b, tapers, orders, 90.0, 0.0, k=count)
    aa, ab, bb = (powers.mean(axis=1) for powers in (aa, ab, bb))
    yield compare("SHLocalizedAdmitCorr, admittance", ab / bb, admittance)
    yield compare("SHLocalizedAdmitCorr, correlation", ab / np.sqrt(aa * bb), correlation)


def tapered(a, b, tapers, orders, latitude):
    """Returns the spectra of a, of a with b, and of b, each times each taper at longitude 0, (degrees, tapers).

    Their degrees are those to which all degrees of the fields contribute.
    """
    f, g = (np.stack(list(windowed(canonical(c), tapers, orders, latitude)), 1) for c in (a, b))
    kept = a.shape[1] - len(tapers) + 1
    return [spectra.cross_spectrum(x, y).power[:kept] for x, y in ((f, f), (f, g), (g, g))]


def windowed(coefficients, tapers, orders, latitude):
    """Yields the coefficients of a function times each taper, given as a column of coefficients of one order."""
    bandwidth = len(tapers) - 1
    degree = round(len(coefficients) ** 0.5) - 1 + bandwidth
    directions, weights = gauss_legendre(degree)
    values = sp.Transform(directions, degree - bandwidth).synthesis(coefficients)
    for taper, order in zip(tapers.T, orders):
        cilm = np.zeros((2, bandwidth + 1, bandwidth + 1))
        cilm[int(order < 0), :, abs(order)] = taper
        window = rotate(canonical(cilm), [0, 90 - latitude, 0])
        yield fit(directions, values * sp.Transform(directions, bandwidth).synthesis(window), degree, weights)


def biased_spectra():
    """examples/python/LocalizedSpectralAnalysis/SHMultitaperSE.py: test_MultitaperSE, SHBias (c8610545)"""
    analysis, power = sh.spectralanalysis, 1 / (1 + np.arange(81.0)) ** 2
    tapers, _, _ = analysis.SHReturnTapers(np.radians(20), 20)
    matrix = coupling((tapers**2).mean(axis=1), 80)
    yield compare("SHBiasK", matrix @ power, analysis.SHBiasK(tapers, power))
    # The test passes a taper's coefficients as if they were powers. Its SHBiasAdmitCorr isn't compared: the spectra are
    # proportional, and their admittance is a constant.
    yield compare("SHBias", coupling(tapers[:, 2], 80) @ power, analysis.SHBias(tapers[:, 2], power))


TESTS = [transforms, transforms_unnormalised, accuracy_glq, accuracy_dh, least_squares, spectral_analysis, exact_power,
         rotations, rotations_of_random_fields, conversions, legendre, wigner_symbols, coupling_matrix,
         tapered_spectra, biased_spectra]  # fmt: skip
