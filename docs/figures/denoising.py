"""Power by degree of a surface with noise at its vertices: data, plain fit and denoised fit, and the gains."""

import matplotlib.pyplot as plt
import numpy as np

import spharm_rs as sp

L = 60
surface, sphere = sp.example_surface(5)
noise = np.random.default_rng(1).normal(scale=2.0, size=surface.vertices.shape)
noisy = sp.Surface(surface.vertices + noise, surface.faces)
settings = {"max_degree": L, "objective": "vertices"}
true = sp.fit(surface, sphere, **settings)
plain, denoised = sp.fit(noisy, sphere, **settings), sp.fit(noisy, sphere, denoise=True, **settings)


def power(coefficients):
    return np.array([(coefficients[l**2 : (l + 1) ** 2] ** 2).sum() for l in range(1, L + 1)])


degrees = np.arange(1, L + 1)
figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3))
left.semilogy(degrees, power(true.coefficients), "k", label="without noise")
left.semilogy(degrees, power(plain.coefficients), label="plain fit")
left.semilogy(degrees, power(denoised.coefficients), label="denoised fit")
left.set(xlabel="degree", ylabel="power of the coefficients, mm²")
left.legend(fontsize=8)
for model, name in ((plain, "plain fit"), (denoised, "denoised fit")):
    right.semilogy(degrees, power(model.coefficients - true.coefficients), color=f"C{int(model is denoised)}", label=name)
right.set(xlabel="degree", ylabel="power of the error, mm²")
right.legend(fontsize=8)
figure.tight_layout()
