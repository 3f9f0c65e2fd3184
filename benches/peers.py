#!/usr/bin/env python3
"""Compares other packages with this one: `./run peers [PACKAGE ...] [published]`.

The program exports a model at degrees 20 and 100; the package reads it with its own reader and evaluates it with its
own code. The largest difference from `spharm reconstruct`, relative to the largest value, must be below 1e-13 for
degree 20 and 1e-12 for degree 100. `published` takes the packages' published tests: peers_published.py.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import peers_published

ROOT = Path(__file__).resolve().parent.parent
BARS = {20: 1e-13, 100: 1e-12}


class Model:
    """A folder with a model, whose values at any directions the program computes."""

    def __init__(self, program, folder, degree, channels):
        self.program, self.folder, self.degree = program, Path(folder), degree
        self.folder.mkdir(exist_ok=True)
        self.path = self.folder / f"model{channels}.spharm.npz"
        rows = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
        a = np.random.default_rng(degree).normal(size=((degree + 1) ** 2, channels)) / (1 + rows[:, None]) ** 1.5
        a[0] += 20
        # Stored as a signal rather than a surface, because `reconstruct` writes signals as a table.
        np.savez(self.path, coefficients=a, convention=CONVENTION, provenance='{"surface": false}')

    def run(self, *arguments):
        done = subprocess.run([self.program, *map(str, arguments)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(done.stderr)

    def export(self, format, name):
        self.run("export", self.path, "--to", format, "-o", self.folder / name, "--force", "-q")
        return self.folder / name

    def values(self, theta, phi):
        """Returns the program's values at colatitudes and azimuths, (n, c)."""
        angles, out = self.folder / "angles.csv", self.folder / "values.csv"
        np.savetxt(angles, np.column_stack([np.ravel(theta), np.ravel(phi)]), fmt="%.17g", delimiter=",")
        self.run("reconstruct", "--model", self.path, "--sphere", angles, "-o", out, "--force", "-q")
        return np.loadtxt(out, delimiter=",", ndmin=2)


CONVENTION = "real orthonormal, no Condon-Shortley phase, row l^2 + l + m, sin(m phi) for negative m"


def relative(found, known):
    return np.abs(found - known).max() / np.abs(known).max()


def scattered(count=300):
    z = np.random.default_rng(1).uniform(-0.999, 0.999, count)
    return np.arccos(z), np.random.default_rng(2).uniform(0, 2 * np.pi, count)


def grid(thetas, phis):
    return np.meshgrid(thetas, phis, indexing="ij")


def harmonics(theta, phi, degree):
    """Returns SciPy's complex harmonics, (n, K)."""
    from scipy.special import sph_harm_y

    return np.stack([sph_harm_y(l, m, theta, phi) for l in range(degree + 1) for m in range(-l, l + 1)], 1)


def ktch(model):
    from ktch.harmonic import SphericalHarmonicAnalysis
    from ktch.io import read_spharmpdm_coef, spharmpdm_to_sha_coeffs

    thetas, phis = np.linspace(0.1, 3, 9), np.linspace(0, 6, 11)
    known = model.values(*grid(thetas, phis))
    for name, read in [
        ("ktch .coef", lambda: spharmpdm_to_sha_coeffs(read_spharmpdm_coef(model.export("pdm", "x.coef")))),
        ("ktch array", lambda: np.load(model.export("ktch", "x.npy")).reshape(1, -1)),
    ]:
        analysis = SphericalHarmonicAnalysis(n_harmonics=model.degree)
        found = analysis.inverse_transform(np.reshape(read(), (1, -1)), theta_range=thetas, phi_range=phis)
        yield name, relative(np.asarray(found).reshape(-1, 3), known)


def pyshtools(model):
    import pyshtools as sh

    theta, phi = scattered()
    known, degrees = model.values(theta, phi), {"colat": np.degrees(theta), "lon": np.degrees(phi)}
    model.export("pyshtools", "x.sh")
    files = [model.folder / f"x.{axis}.sh" for axis in "xyz"]
    read = [sh.SHCoeffs.from_file(str(file), normalization="ortho", csphase=1) for file in files]
    yield "pyshtools text", relative(np.stack([c.expand(**degrees) for c in read], 1), known)


def healpy(model):
    import healpy as hp

    file = model.export("healpy", "x.fits")
    nside = 16
    known = model.values(*hp.pix2ang(nside, np.arange(12 * nside**2)))
    alms = [np.asarray(hp.read_alm(str(file), hdu=k + 1), complex) for k in range(3)]
    yield "healpy FITS", relative(np.stack([hp.alm2map(alm, nside, lmax=model.degree) for alm in alms], 1), known)


def s2fft(model):
    import jax

    jax.config.update("jax_enable_x64", True)
    import s2fft

    size = model.degree + 1
    theta, phi = s2fft.sampling.s2_samples.thetas(size, "mw"), s2fft.sampling.s2_samples.phis_equiang(size, "mw")
    known = model.values(*grid(theta, phi))
    flm = np.load(model.export("s2fft", "x.npy"))
    found = [np.real(s2fft.inverse(f, size, sampling="mw", method="numpy")).ravel() for f in flm]
    yield "s2fft array", relative(np.stack(found, 1), known)


def scipy(model):
    import scipy.io

    theta, phi = scattered()
    read = scipy.io.loadmat(model.export("mat", "x.mat"))
    found = (harmonics(theta, phi, model.degree) @ read["fvec"]).real
    yield "SPHARM-MAT by SciPy", relative(found, model.values(theta, phi))
    model.export("afni", "x.1D")
    matrices = [np.loadtxt(model.folder / f"x.{axis}.1D") for axis in "xyz"]
    # Chung's SPHARMsmooth uses cosines, then sines, of the azimuth plus pi, with normalised Legendre functions.
    y = harmonics(theta, phi + np.pi, model.degree)
    found = np.zeros((len(theta), 3))
    for l in range(model.degree + 1):
        positive = y[:, l * l + l : (l + 1) ** 2]
        signs = np.sqrt(2) * (-1.0) ** np.arange(l + 1)
        signs[0] = 1
        basis = np.hstack([(positive * signs).real, (positive * signs).imag[:, 1:]])
        found += np.stack([basis @ matrix[l, : 2 * l + 1] for matrix in matrices], 1)
    yield "weighted SPHARM's formula", relative(found, model.values(theta, phi))


def flowshape(model):
    import scipy.special

    if not hasattr(scipy.special, "sph_harm"):
        # FlowShape 0.1 calls a function that SciPy 1.17 no longer has.
        scipy.special.sph_harm = lambda m, l, azimuth, polar: scipy.special.sph_harm_y(l, m, polar, azimuth)
    import flowshape as fs

    theta, phi = scattered()
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
    found = fs.get_Y_mat(directions, model.degree + 1) @ np.load(model.export("flowshape", "x.npy"))
    yield "FlowShape array", relative(found, model.values(theta, phi))


def aics(model):
    from aicsshparam import shtools

    radius = Model(model.program, model.folder, model.degree, 1)
    named = json.loads(radius.export("aics", "x.json").read_text())
    size = radius.degree + 1
    coefficients = np.array(
        [[[named[f"shcoeffs_L{l}M{m}{s}"] for m in range(size)] for l in range(size)] for s in "CS"]
    )
    found = shtools.get_even_reconstruction_from_coeffs(coefficients, npoints=64)[1]
    # The Driscoll-Healy grid of pyshtools. Its longitudes are the azimuths plus pi.
    n = 2 * size
    known = radius.values(*grid(np.arange(n) * np.pi / n, np.arange(2 * n) * np.pi / n - np.pi)).reshape(n, 2 * n)
    # aics-shparam 0.1 returns the grid with or without its last row and column.
    rows, columns = min(n, found.shape[0]), min(2 * n, found.shape[1])
    yield "aics-shparam", relative(found[:rows, :columns], known[:rows, :columns])


PEERS = {"scipy": scipy, "pyshtools": pyshtools, "healpy": healpy, "ktch": ktch, "s2fft": s2fft, "flowshape": flowshape,
         "aicsshparam": aics}  # fmt: skip


def report_exported(names, program):
    """Prints the errors of exported models and returns the number of those that miss their bar."""
    missed = 0
    print(f"{'package':<28}{'degree':>7}{'error':>11}{'bar':>9}")
    for name in names:
        for degree, bar in BARS.items():
            with tempfile.TemporaryDirectory() as folder:
                try:
                    rows = list(PEERS[name](Model(program, folder, degree, 3)))
                except ImportError as error:
                    print(f"{name:<28}{degree:>7}  can't be imported: {error}")
                    missed += 1
                    continue
                for what, error in rows:
                    missed += not error <= bar
                    met = "met" if error <= bar else "MISSED"
                    print(f"{what:<28}{degree:>7}{error:>11.1e}{bar:>9.0e}  {met}", flush=True)
    return missed


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("peers", nargs="*", help=f"of {', '.join(PEERS)}, published; all by default")
    parser.add_argument("--program", default=ROOT / "target" / "release" / "spharm")
    arguments = parser.parse_args()
    names = arguments.peers or [*PEERS, "published"]
    exported = [name for name in names if name != "published"]
    missed = report_exported(exported, arguments.program) if exported else 0
    if "published" in names:
        missed += peers_published.report()
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
