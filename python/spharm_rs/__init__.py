"""Large-scale spherical-harmonic (SPHARM) models of surfaces.

A closed surface is x, y and z as functions on the sphere, each a sum of spherical harmonics to a degree:

>>> import spharm_rs as sp
>>> surface, sphere = sp.example_surface(4)
>>> model = sp.fit(surface, max_degree=15)
>>> smooth = model.surface(5, degree=10)
>>> distance = sp.compare(surface, model.surface())

`fit` accepts a mesh as a path, as arrays, or as an object of trimesh, pyvista, meshio, nibabel or nilearn. Values on vertices
and masks may be images of nibabel and nilearn.
Conventions: degrees are inclusive; theta is the colatitude and phi the azimuth, in radians; coefficients are those of the real
orthonormal harmonics without the Condon-Shortley phase, row ``l**2 + l + m``. `spharm_rs.convert` converts them from and to the
conventions of other packages.

Two modules are imported by name, because they need other packages: ``spharm_rs.sklearn`` has estimators of scikit-learn, whose
X is a sequence of surfaces, and ``spharm_rs.dask`` distributes moments and fits of cohorts.
"""

from . import _load, convert, errors, reports  # noqa: F401  (first, for the kernels)
from . import shape, spectra
from ._cohort import CohortFit, CohortFits, fit_cohort
from ._compare import Distances, compare
from ._core import __version__
from ._fit import choose_degree, fit, solve
from ._fit_labels import LabelFit, fit_labels
from ._fit_many import fit_each, fit_many
from ._landmarks import Landmarks, read_landmarks, write_landmarks
from ._model import Model
from ._moments import Moments
from ._parametrize import Parametrization, labels, parametrize, parametrize_volume, resample
from ._picture import Picture, picture
from ._repair import Repair, repair
from ._store import Store
from ._surface import (
    Surface,
    as_surface,
    example_surface,
    icosphere,
    read_signal,
    read_surface,
    write_signal,
    write_surface,
)
from ._transform import Transform
from .errors import (
    MemoryBudgetError,
    MeshError,
    NotConverged,
    NotDetermined,
    Oscillation,
    SpharmError,
    SpharmWarning,
    StoreError,
)

__all__ = [
    "CohortFit",
    "CohortFits",
    "Distances",
    "LabelFit",
    "Landmarks",
    "MemoryBudgetError",
    "MeshError",
    "Model",
    "Moments",
    "NotConverged",
    "NotDetermined",
    "Oscillation",
    "Parametrization",
    "Picture",
    "Repair",
    "SpharmError",
    "SpharmWarning",
    "Store",
    "StoreError",
    "Surface",
    "Transform",
    "__version__",
    "as_surface",
    "choose_degree",
    "compare",
    "convert",
    "errors",
    "example_surface",
    "fit",
    "fit_cohort",
    "fit_each",
    "fit_labels",
    "fit_many",
    "icosphere",
    "labels",
    "parametrize",
    "parametrize_volume",
    "picture",
    "read_landmarks",
    "read_signal",
    "read_surface",
    "repair",
    "reports",
    "resample",
    "shape",
    "solve",
    "spectra",
    "write_landmarks",
    "write_signal",
    "write_surface",
]
