"""Tests of ktch, reproduced through spharm_rs: those of noshita/ktch at version 0.11, and the data in its package."""

import ktch.datasets
import ktch.harmonic
import ktch.io
import numpy as np
import spharm_rs as sp
from ktch.harmonic import _spherical_harmonic_analysis as private
from peers_common import compare, fit, gauss_legendre, grid_directions, wigner
from scipy.spatial.transform import Rotation
from spharm_rs import convert, spectra


def surface_model(flat):
    """Returns the model of one row of ktch's coefficients."""
    return sp.Model(convert.from_ktch(flat), surface=True)


def analysis(degree, **settings):
    return ktch.harmonic.SphericalHarmonicAnalysis(n_harmonics=degree, registration=None, **settings)


def fitted(degree, values, theta, phi, **settings):
    """Returns ktch's coefficients of samples at angles, and those of spharm_rs, both (c, K)."""
    at = np.column_stack([theta, phi])
    known = analysis(degree, **settings).transform([values], theta_phi=[at])[0].reshape(values.shape[1], -1)
    directions = spectra.directions(colatitude=theta, longitude=phi, degrees=False)
    return known, convert.to_ktch(fit(directions, values, degree))


def scattered(degree, points, seed, channels=3):
    """Returns the field of the tests' _synthetic_sphere: random coefficients, (K, c), at random angles."""
    generator = np.random.default_rng(seed)
    coefficients = generator.standard_normal(((degree + 1) ** 2, channels))
    theta = np.arccos(generator.uniform(-1, 1, points))
    phi = generator.uniform(0, 2 * np.pi, points)
    directions = spectra.directions(colatitude=theta, longitude=phi, degrees=False)
    return sp.Transform(directions, degree).synthesis(coefficients), theta, phi, coefficients


def spherical_angles():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: test_xyz2spherical_axes (0.11)"""
    half = np.sqrt(0.5)
    points = np.array([[half, half, 0], [half, -half, 0], [0, half, half], [0, half, -half]])
    latitude, longitude = spectra.latitude_longitude(points, degrees=False)
    found = np.column_stack([np.pi / 2 - latitude, longitude])
    yield compare("xyz2spherical", found, ktch.harmonic.xyz2spherical(points))


def round_trip():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: test_transform_and_inverse_roundtrip (0.11)"""
    thetas, phis = np.linspace(0, np.pi, 5), np.linspace(0, 2 * np.pi, 9)
    coefficients = np.zeros((9, 3))
    coefficients[0] = 1.0, 0.2, -0.1
    by_degree = [coefficients[l**2 : (l + 1) ** 2] for l in range(3)]
    x, y, z = ktch.harmonic.spharm(2, by_degree, theta_range=thetas, phi_range=phis)
    values = np.stack([x, y, z], -1).reshape(-1, 3)
    yield compare("spharm", sp.Model(coefficients).evaluate(grid_directions(thetas, phis)), values)
    theta, phi = (angle.ravel() for angle in np.meshgrid(thetas, phis, indexing="ij"))
    known, found = fitted(2, values, theta, phi)
    yield compare("transform", found, known)


def mixed_spectrum():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestSHARoundTripMixedSpectrum (0.11)"""
    thetas, phis = np.linspace(0.1, np.pi - 0.1, 8), np.linspace(0, 2 * np.pi, 16)
    theta, phi = (angle.ravel() for angle in np.meshgrid(thetas, phis, indexing="ij"))
    directions = spectra.directions(colatitude=theta, longitude=phi, degrees=False)
    values = directions * [2.0, 1.5, 1.0] + [0.5, -0.3, 0.2]
    known, found = fitted(2, values, theta, phi)
    yield compare("transform", found, known)
    recovered = analysis(2).inverse_transform(known.reshape(1, -1), theta_range=thetas, phi_range=phis)
    yield compare("inverse_transform", sp.Model(found.T).evaluate(directions), recovered.reshape(-1, 3))
    # ktch's default grid is of 90 colatitudes and 180 azimuths.
    known = analysis(2).inverse_transform(known.reshape(1, -1)).reshape(-1, 3)
    grid = grid_directions(np.linspace(0, np.pi, 90), np.linspace(0, 2 * np.pi, 180))
    yield compare("inverse_transform, default grid", sp.Model(found.T).evaluate(grid), known)


def uneven_surface():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestSHAFlatRoundTripAxisOrder (0.11)

    Fits a surface that needs higher degrees than the fit has, and evaluates the model at its degree and, as in
    TestSHAInverseTransformLMaxTruncation, at a lower one.
    """
    thetas, phis = np.linspace(0.01, np.pi - 0.01, 60), np.linspace(0, 2 * np.pi, 120, endpoint=False)
    theta, phi = (angle.ravel() for angle in np.meshgrid(thetas, phis, indexing="ij"))
    radius = 1 + 0.1 * np.sin(2 * theta) * np.cos(3 * phi)
    directions = spectra.directions(colatitude=theta, longitude=phi, degrees=False)
    known, found = fitted(6, radius[:, np.newaxis] * directions * [1.0, 0.5, 2.0], theta, phi)
    yield compare("transform", found, known)
    model, flat = sp.Model(found.T), known.reshape(1, -1)
    for degree in (6, 3):
        values = analysis(6).inverse_transform(flat, theta_range=thetas, phi_range=phis, l_max=degree).reshape(-1, 3)
        yield compare(f"inverse_transform, l_max={degree}", model.evaluate(directions, degree=degree), values)


def scalar_field():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestSPHARMNDim (0.11)"""
    for degree, channels in ((3, 1), (2, 4)):
        values, theta, phi, coefficients = scattered(degree, 400, 0, channels)
        known, found = fitted(degree, values, theta, phi, n_dim=channels)
        yield compare(f"transform, n_dim={channels}", found, known)
        yield compare(f"coefficients known, n_dim={channels}", found, coefficients.T)


def basis():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestRealSHOrthonormality (0.11)"""
    nodes, _ = np.polynomial.legendre.leggauss(80)
    thetas, phis = np.arccos(nodes), np.linspace(0, 2 * np.pi, 160, endpoint=False)
    theta, phi = (angle.ravel() for angle in np.meshgrid(thetas, phis, indexing="ij"))
    found = sp.Transform(grid_directions(thetas, phis), 5).synthesis(np.eye(36))
    yield compare("basis, degree 5", found, private._real_sph_harm_basis_matrix(5, theta, phi))


def complex_coefficients():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestComplexRealSphCoefRoundtrip (0.11)"""
    coefficients = np.random.RandomState(77).randn(25, 3)
    known = private._real_to_complex_sph_coef(coefficients)
    yield compare("real to complex", convert.to_complex(coefficients), known)
    yield compare("complex to real", convert.from_complex(known), private._complex_to_real_sph_coef(known))


def rotations_of_parameters():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestRotateParameterSphere (0.11)"""
    for degree, points, seed, vector in ((3, 600, 0, [0.3, -0.5, 0.8]), (8, 2000, 20, [0.6, -0.2, 0.9])):
        values, theta, phi, coefficients = scattered(degree, points, seed)
        rotation = Rotation.from_rotvec(vector).as_matrix()
        model = sp.shape.rotate(sp.Model(coefficients), parameters=rotation)
        known = private.rotate_parameter_sphere(coefficients, rotation)
        yield compare(f"rotate_parameter_sphere, degree {degree}", model.coefficients, known)
        directions = spectra.directions(colatitude=theta, longitude=phi, degrees=False) @ rotation.T
        yield compare(f"fit at rotated directions, degree {degree}", fit(directions, values, degree), known)


def rotations_in_domains():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestRotateSpharmCoeffs (0.11)"""
    rotation = Rotation.from_rotvec([0.3, -0.4, 0.8]).as_matrix()
    flat = convert.to_ktch(scattered(3, 500, 0)[3]).reshape(1, -1)
    domains = {"codomain": ["object"], "parameter": ["parameters"], "coupled": ["parameters", "object"]}
    for domain, arguments in domains.items():
        known = ktch.harmonic.rotate_spharm_coeffs(flat, rotation, domain=domain)[0]
        found = sp.shape.rotate(surface_model(flat[0]), **dict.fromkeys(arguments, rotation))
        yield compare(f"rotate_spharm_coeffs, {domain}", convert.to_ktch(found.coefficients).ravel(), known)


def wigner_matrices():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestWignerDSmall (0.11)"""
    for degree in (3, 8, 20):
        known = private._wigner_d_small(degree, 0.7)
        yield compare(f"_wigner_d_small, degree {degree}", wigner(degree, [0, np.degrees(0.7), 0]), known)


def registration():
    """ktch/harmonic/tests/test_spherical_harmonic_analysis.py: TestSPHARMRegistration (0.11)

    The first-order ellipsoid has four positions along the axes, among which ktch chooses by the signs of third moments;
    `shape.align` moves the surface into the position of the registered one.
    """
    flat = convert.to_ktch(scattered(3, 500, 3)[3]).reshape(1, -1)
    register = ktch.harmonic.SphericalHarmonicRegistration(method="first_order", scale=False)
    known, model = surface_model(register.fit_transform(flat)[0]), surface_model(flat[0])
    found = sp.shape.align(model, known, "foe").model
    yield compare("registered coefficients", found.coefficients, known.coefficients)
    lengths = [np.linalg.svd(m.coefficients[1:4], compute_uv=False) for m in (model, known)]
    yield compare("semi-axes", *lengths)
    yield compare("spectrum from degree 1", model.spectrum()[1:], known.spectrum()[1:])


def potato():
    """ktch/datasets/data/danshaku_08_allSegments_SPHARM.coef, in the package (0.11.1)

    A SPHARM-PDM file of degree 25; read, and evaluated on the default grid, as in doc/how-to/data/load_spharm.md.
    """
    path = ktch.datasets.fetch("danshaku_08_allSegments_SPHARM.coef")
    data = ktch.io.read_spharmpdm_coef(path)
    flat = ktch.io.spharmpdm_to_sha_coeffs(data)
    found = convert.read_spharm_pdm(path)
    yield compare("spharmpdm_to_sha_coeffs", convert.to_ktch(found).ravel(), flat[0])
    yield compare("complex coefficients", convert.to_complex(found), np.vstack(data.coeffs))
    grid = grid_directions(np.linspace(0, np.pi, 90), np.linspace(0, 2 * np.pi, 180))
    known = analysis(data.l_max).inverse_transform(flat).reshape(-1, 3)
    yield compare("inverse_transform, degree 25", sp.Model(found).evaluate(grid), known)
    directions, weights = gauss_legendre(data.l_max)
    refitted = fit(directions, sp.Model(found).evaluate(directions), data.l_max, weights)
    yield compare("fit of the surface, degree 25", convert.to_ktch(refitted).ravel(), flat[0])


TESTS = [spherical_angles, round_trip, mixed_spectrum, uneven_surface, scalar_field, basis, complex_coefficients,
         rotations_of_parameters, rotations_in_domains, wigner_matrices, registration, potato]  # fmt: skip
