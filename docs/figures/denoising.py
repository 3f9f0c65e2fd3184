"""Power by degree of a surface without noise, and of its fits with noise: plain and denoised; and the errors."""

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

degrees = np.arange(1, L + 1)
figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3))
left.semilogy(degrees, true.spectrum()[1:], "k", label="without noise")
left.semilogy(degrees, plain.spectrum()[1:], label="plain fit")
left.semilogy(degrees, denoised.spectrum()[1:], label="denoised fit")
left.set(xlabel="degree", ylabel="power of the coefficients, mm²")
left.legend(fontsize=8)
for model, name in ((plain, "plain fit"), (denoised, "denoised fit")):
    right.semilogy(degrees, (model - true).spectrum()[1:], label=name)
right.set(xlabel="degree", ylabel="power of the error, mm²")
right.legend(fontsize=8)
figure.tight_layout()
