"""Reports have the keys and types that `spharm_rs.reports` names."""

from __future__ import annotations

from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

import spharm_rs as sp
from spharm_rs import reports

from .conftest import Study


#: Keys that are absent where they don't apply. A fit's depend on what was fitted.
MAY_LACK: dict[Any, set[str]] = {
    reports.FitReport: set(get_type_hints(reports.FitReport)),
    reports.MapReport: {
        "quad_area_deviation", "handles", "sphere", "voxels", "at_border", "repair", "mesh_repair", "distance_rms",
        "distance_max", "self_intersections",
    },
    reports.RepairReport: {"problems", "wrap"},
    reports.Denoised: {"left_out"},
    reports.SolverStep: {"left"},
}  # fmt: skip


def flaws(value: Any, kind: Any, where: str) -> list[str]:
    """Returns where a value isn't of a type of `spharm_rs.reports`."""
    if kind is Any:
        return []
    if get_origin(kind) is Union:
        of_each = [flaws(value, one, where) for one in get_args(kind)]
        return min(of_each, key=len)
    if get_origin(kind) is list:
        if not isinstance(value, list):
            return [f"{where}: {value!r} isn't a list"]
        return [flaw for item in value for flaw in flaws(item, get_args(kind)[0], f"{where}[]")]
    if hasattr(kind, "__required_keys__"):
        if not isinstance(value, dict):
            return [f"{where}: {value!r} isn't a dictionary"]
        hints = get_type_hints(kind)
        always = hints.keys() - MAY_LACK.get(kind, set())
        missing = [f"{where}: no {key}" for key in always - value.keys()]
        unknown = [f"{where}: {key} isn't in the type" for key in value.keys() - hints.keys()]
        return missing + unknown + [
            flaw for key in value.keys() & hints.keys() for flaw in flaws(value[key], hints[key], f"{where}.{key}")
        ]
    kinds = (int, float) if kind is float else (kind,)
    return [] if isinstance(value, kinds) else [f"{where}: {value!r} isn't {kind}"]


def test_reports_have_the_types_keys(study: Study) -> None:
    surface, sphere = study
    signal = surface.vertices[:, 0]
    clean = sp.fit(surface, sphere, 8).evaluate()
    noisy = clean + np.random.default_rng(0).normal(0, 1.0, clean.shape)
    moments = sp.Moments(sphere.vertices, surface.vertices, max_degree=8)
    fits = {
        "surface": sp.fit(noisy, sphere, 14, hold_out=0.1, stderr=True, denoise=True).report,
        "bare": sp.fit(surface, max_degree=8).report,
        "vertices": sp.fit(surface, sphere, 8, objective="vertices", smoothness="auto").report,
        "quadrature": sp.fit(surface, sphere, 8, method="quadrature").report,
        "signal": sp.fit(signal, sphere, 8).report,
        "solve": sp.solve(sphere.vertices, signal, 8, preconditioner="factor")[1],
        "moments": moments.fit(8, smoothness="auto").report,
        "mean": sp.shape.mean([sp.fit(mesh, sphere, 4) for mesh in (sphere, surface)]).report,
    }
    for name, report in fits.items():
        assert report and flaws(report, reports.FitReport, name) == []
    assert isinstance(fits["surface"]["solver"]["steps"], list) and "surface_distance" in fits["bare"]
    mended = sp.repair((surface.vertices, surface.faces[1:]))
    assert flaws(mended.report, reports.RepairReport, "repair") == []
    wrapped = sp.repair(surface, wrap=24).report
    assert flaws(wrapped, reports.RepairReport, "wrap") == [] and wrapped["wrap"]["voxels"] == 24
    mapped = sp.parametrize(surface)
    for made in (mapped, sp.resample(surface, mapped.sphere, sp.icosphere(4))):
        assert flaws(made.report, reports.MapReport, "map") == []
    # What isn't of the types is found.
    assert flaws({"channels": None}, reports.FitReport, "") and flaws({"new": 1}, reports.FitReport, "")
    assert flaws({}, reports.Distances, "") and np.isfinite(fits["surface"]["surface_distance"]["rms"])
