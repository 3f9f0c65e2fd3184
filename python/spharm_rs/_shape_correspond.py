"""Makes groups of surfaces correspond, with one template and one sphere."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Iterable, Literal, Mapping, Sequence, overload

import numpy as np
from numpy.typing import ArrayLike

from . import _arrays, _core
from ._arrays import Floats
from ._landmarks import Landmarks, matched
from ._model import Model
from ._progress import Progress, callback
from ._shape_modes import Modes, pca
from ._shape_poses import SimilarityTransform
from ._shape_quality import GroupQuality, LandmarkErrors, quality
from ._shape_register import Flags, given
from ._surface import Path, Surface, as_surface, icosphere, read_signal
from ._warnings import warn


def _names(surfaces: Sequence[Any], first: int = 0) -> list[str]:
    """Returns names: for paths their stems if these are unique, otherwise the paths; for other surfaces numbers."""
    paths = [os.fspath(item) if isinstance(item, (str, os.PathLike)) else None for item in surfaces]
    stems = [None if path is None else _core.stem(path) for path in paths]
    known = [stem for stem in stems if stem is not None]
    if len(set(known)) < len(known):
        stems = paths
    return [str(first + index) if stem is None else stem for index, stem in enumerate(stems)]


@dataclass(frozen=True, eq=False)
class Carried:
    """Points carried from one member to another.

    Attributes
    ----------
    points : ndarray of float, (n, 3)
        Points on the target, in its own coordinates.
    off_surface : ndarray of float, (n,)
        Distance of each point from the source's surface, in its unit.
    reached : ndarray of bool, (n,)
        Whether both members have a counterpart of the point; if not, its position is a guess.
    """

    points: Floats
    off_surface: Floats
    reached: Flags


@dataclass(frozen=True, eq=False)
class Member:
    """A surface added to a group; the group isn't changed.

    Attributes
    ----------
    name : str
    model : Model
        The member's model, in the group's frame and over the group's sphere.
    transform : SimilarityTransform
        Transform from the member's own frame to the group's.
    places : ndarray of float, (n, 3)
        Points on the member's surface at the sphere's directions, in the group's frame.
    reached : ndarray of bool, (n,)
        Whether each place has a counterpart on the member's surface.
    report : dict
        ``pose_distance``: median distance from the group's mean, in the pose found. ``cover_rms``, ``cover_most`` (the
        99th percentile) and ``cover_farthest``: distances of the surface from the places. ``unreached``: share of the
        surface's area without places. ``without_counterpart``: number of places without a counterpart on the surface.
        ``turned``: number of triangles turned over. ``model_rms``: distance between model and places. ``area`` and
        ``volume`` of the surface, in its own unit; 0 in groups of earlier versions.
    warnings : tuple of str
        Reasons to check the surface: another kind or unit, a mirror image, parts without a counterpart, the surface of
        an existing member. Each has also been issued as a `SpharmWarning`.
    """

    name: str
    model: Model = field(repr=False)
    transform: SimilarityTransform = field(repr=False)
    places: Floats = field(repr=False)
    reached: Flags = field(repr=False)
    report: dict[str, Any] = field(repr=False)
    warnings: tuple[str, ...] = field(default=(), repr=False)


class Group:
    """N corresponding surfaces, from `spharm_rs.shape.correspond`: over one sphere of n directions, in one frame.

    Lengths are in the surfaces' unit. Groups are immutable.

    Attributes
    ----------
    names : tuple of str
        Names of the members: the stems of paths, otherwise numbers from 0.
    """

    _inner: _core.Group
    _landmarks: tuple[tuple[str, ...] | None, list[Floats]] | None
    names: tuple[str, ...]

    def __init__(self) -> None:
        raise TypeError("groups are made by spharm_rs.shape.correspond, or read by Group.load")

    @classmethod
    def _of(
        cls, inner: _core.Group, names: Sequence[str], landmarks: tuple[tuple[str, ...] | None, list[Floats]] | None
    ) -> Group:
        group = cls.__new__(cls)
        group._inner, group.names, group._landmarks = inner, tuple(names), landmarks
        return group

    def __reduce__(self) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            # Files are named by numbers, because names of members may be invalid as file names.
            self._inner.write(folder, [f"m{index}" for index in range(len(self))], True)
            files = [path for path in pathlib.Path(folder).rglob("*") if path.is_file()]
            data = {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
        return _unpickled, (data, self.names, self._landmarks)

    def __repr__(self) -> str:
        return f"Group({len(self)} members, degree {self.mean.max_degree}, {len(self.masked)} directions)"

    def save(self, folder: Path, *, overwrite: bool = False) -> None:
        """Writes the group into a folder, atomically, as ``spharm shape correspond -o`` does; ``--to`` can read it.

        Parameters
        ----------
        folder : str or os.PathLike
            Created if it doesn't exist.
        overwrite : bool
            Replace existing files.
        """
        self._inner.write(os.fspath(folder), self.names, bool(overwrite))

    @classmethod
    def load(cls, folder: Path, *, landmarks: Sequence[Landmarks | ArrayLike | Path] | None = None) -> Group:
        """Reads a group that was written by `save` or ``spharm shape correspond -o``.

        The folder has no record of guiding landmarks and of the refinement, so `report` doesn't contain them.

        Parameters
        ----------
        folder : str or os.PathLike
        landmarks : sequence of Landmarks, of array_like of float, (p, 3), or of paths, optional
            As for `correspond`.

        Returns
        -------
        Group
        """
        inner, names = _core.Group.read(os.fspath(folder), None)
        return cls._of(inner, names, None if landmarks is None else matched(landmarks, len(names)))

    def __len__(self) -> int:
        """Number of members, N."""
        return len(self.names)

    @cached_property
    def models(self) -> list[Model]:
        """Models of the members, in the group's frame and over its sphere."""
        return [Model._of(model) for model in self._inner.models]

    @cached_property
    def transforms(self) -> list[SimilarityTransform]:
        """Transforms from each member's own frame to the group's."""
        return [SimilarityTransform._of(found) for found in json.loads(self._inner.transforms)]

    @cached_property
    def mean(self) -> Model:
        """The group's mean, in its frame and over its sphere."""
        return Model._of(self._inner.mean)

    @cached_property
    def places(self) -> Floats:
        """Corresponding places on the members' surfaces, (N, n, 3), in the group's frame."""
        return self._inner.places

    @cached_property
    def reached(self) -> Flags:
        """Whether each place has a counterpart on its member, (N, n); if not, the place is a guess."""
        return self._inner.reached

    @cached_property
    def masked(self) -> Flags:
        """Directions without a counterpart on members, (n,): lids of holes and of cut handles of the first template."""
        return self._inner.masked

    @cached_property
    def sphere(self) -> Surface:
        """The sphere of all members, n directions with triangles."""
        return Surface(*self._inner.sphere)

    @property
    def directions(self) -> Floats:
        """Unit vectors at which places correspond, (n, 3)."""
        return self.sphere.vertices

    @cached_property
    def warnings(self) -> list[str]:
        """Doubts about the result, each with the member's name.

        They concern doubtful poses and kinds, mirror images, parts without counterpart, equal surfaces, landmarks far
        from their surface, and landmarks that seem to be swapped or misplaced.
        """
        return [*self._inner.warnings, *self._far(), *self._misplaced()]

    @cached_property
    def report(self) -> dict[str, Any]:
        """Report of how the group was made.

        ``template``: name of the first template, None if it isn't a member. ``changes``: repairs of the template.
        ``spread``: root mean square distance of members from the mean. ``members``: the fields of `Member.report` for
        each member. ``guide``, None without guiding landmarks: ``guided``, the distances of guiding landmarks from
        their places, and ``left_out``, the distance of each landmark when it is left out of guiding. ``refinement``,
        None without refinement: ``stages``, each with steps, cost, variance and ``log_area``, the change of areas on
        the sphere (``rms``, ``most``, and ``within_eight``, the share of triangles within a factor of 8); and
        ``moved``, the root mean square angle in radians by which each member's directions moved. ``seconds``: the time
        of each step.
        """
        found: dict[str, Any] = json.loads(self._inner.report)
        for name, member in zip(self.names, found["members"]):
            member["name"] = name
        return found

    @cached_property
    def modes(self) -> Modes:
        """Modes of variation, as computed by `pca`; needs three members or more."""
        return pca(self.models, names=self.names)

    @cached_property
    def quality(self) -> GroupQuality:
        """Quality of the correspondence, as measured by `quality` outside the mask; needs three members or more.

        It is computed on first access.
        """
        return quality(self.models, landmarks=self._placed(), mask=self._inner.kept_at(icosphere(4).vertices))

    @cached_property
    def landmark_errors(self) -> LandmarkErrors | None:
        """Distances between the given landmarks over all pairs of members; needs three members or more. None if none
        were given."""
        placed = self._placed()
        if placed is None:
            return None
        return quality(self.models, modes=1, samples=1, surfaces=False, landmarks=placed).landmarks

    def _own_places(self, index: int) -> tuple[Floats, float]:
        """Returns a member's places in its own coordinates, (n, 3), and the distance above which points count as far
        from them: a twentieth of their extent."""
        places = self.transforms[index].inverse().apply(self.places[index])
        return places, 0.05 * float(np.linalg.norm(np.ptp(places, axis=0)))

    def _far(self) -> list[str]:
        """Returns a warning for each member with a landmark farther from its surface than a twentieth of the surface's
        extent."""
        if self._landmarks is None:
            return []
        found = []
        for index, (name, points) in enumerate(zip(self.names, self._landmarks[1])):
            off = self.carried(points, index, index).off_surface
            if far := int((off > self._own_places(index)[1]).sum()):
                found.append(f"{name}: {far} of {len(points)} landmarks are far from the surface, up to {off.max():.4g} away")
        return found

    def _misplaced(self) -> list[str]:
        """Returns a warning for each member with landmarks that aren't at their places on the other members."""
        if self._landmarks is None:
            return []
        labels, points = self._landmarks
        found = self._inner.misplaced_landmarks(points, [] if labels is None else list(labels))
        return [f"{self.names[member]}: {text}" for member, text in found]

    def _placed(self) -> list[Landmarks] | list[Floats] | None:
        """Returns the landmarks in the group's frame."""
        if self._landmarks is None:
            return None
        names, points = self._landmarks
        moved = [transform.apply(own) for transform, own in zip(self.transforms, points)]
        return moved if names is None else [Landmarks(names, own) for own in moved]

    def index(self, member: int | str) -> int:
        """Returns the number of a member that is given by its name or its number.

        Parameters
        ----------
        member : int or str
        """
        if isinstance(member, str):
            if member not in self.names:
                raise ValueError(f"member: expected one of {', '.join(self.names)}; found {member!r}")
            return self.names.index(member)
        number = _arrays.whole("member", member)
        if number >= len(self):
            raise ValueError(f"member: expected 0 to {len(self) - 1}, found {number}")
        return number

    @overload
    def carry(self, points: Landmarks, source: int | str, target: int | str) -> Landmarks: ...
    @overload
    def carry(self, points: ArrayLike, source: int | str, target: int | str) -> Floats: ...
    def carry(self, points: Any, source: int | str, target: int | str) -> Any:
        """Carries points on one member to the same places on another member's surface.

        Warns of points without a counterpart on both members, because their places are guesses; `carried` returns which
        they are.

        Parameters
        ----------
        points : Landmarks or array_like of float, (n, 3)
            On the source, in its own coordinates; a point at a distance from the source's surface gets the same
            distance from the target's.
        source, target : int or str
            Members, by number or name.

        Returns
        -------
        Landmarks or ndarray of float, (n, 3)
            In the target's own coordinates.
        """
        found = self.carried(points, source, target)
        if guesses := int((~found.reached).sum()):
            of = f"{self.names[self.index(source)]} to {self.names[self.index(target)]}"
            warn([f"{of}: {guesses} of {len(found.points)} points have no counterpart on a member; their positions are guesses"])
        return Landmarks(points.names, found.points, points.frame) if isinstance(points, Landmarks) else found.points

    def carried(self, points: Landmarks | ArrayLike, source: int | str, target: int | str) -> Carried:
        """Carries points as `carry` does; also returns their distance from the surface, and whether both members have
        them.

        Parameters
        ----------
        points : Landmarks or array_like of float, (n, 3)
        source, target : int or str

        Returns
        -------
        Carried
        """
        values = points.points if isinstance(points, Landmarks) else _arrays.positions("points", points)
        places, off, reached = self._inner.carry(values, self.index(source), self.index(target))
        return Carried(places, off, reached)

    def carry_values(
        self,
        surfaces: Sequence[Any],
        values: Sequence[Any],
        *,
        interpolation: Literal["linear", "nearest"] | None = None,
    ) -> Floats:
        """Carries values at the vertices of each member's own mesh, such as its thickness, to the group's directions.

        Parameters
        ----------
        surfaces : sequence of Surface or what `spharm_rs.as_surface` takes, N
            The members' own meshes, in the coordinates in which they were brought into correspondence.
        values : sequence of array_like of float, (vertices,) or (vertices, c), of images, or of paths, N
            Images are nibabel's ``GiftiImage``, or nilearn's ``SurfaceImage`` of one hemisphere.
        interpolation : {"linear", "nearest"}, optional
            Within triangles: linear, or the value of the nearest vertex, as labels need. By default nearest for integers,
            booleans and ``.label.gii`` files, and linear for all others.

        Returns
        -------
        ndarray of float, (N, n) or (N, n, c)
            The value at the nearest point of the member's mesh to each of its places; NaN where the member has no
            counterpart (`reached`). `group_test` takes them as ``subjects``, with
            ``mask=~np.isnan(values).any(axis=0)``, or for c channels ``.any(axis=(0, 2))``.

        Examples
        --------
        >>> import numpy as np, spharm_rs as sp
        >>> surfaces = [sp.example_surface(3, seed=k)[0] for k in range(3)]
        >>> group = sp.shape.correspond(surfaces, 6, subdivisions=3)
        >>> heights = group.carry_values(surfaces, [surface.vertices[:, 2] for surface in surfaces])
        >>> heights.shape
        (3, 642)
        """
        if interpolation is not None:
            _arrays.choice("interpolation", interpolation, ("linear", "nearest"))
        meshes, own = list(surfaces), list(values)
        for what, found in (("surfaces", meshes), ("values", own)):
            if len(found) != len(self):
                raise ValueError(f"{what}: expected one for each of {len(self)} members, found {len(found)}")
        carried = [self._values_of(index, *pair, interpolation) for index, pair in enumerate(zip(meshes, own))]
        if len({found.shape for found in carried}) > 1:
            raise ValueError(
                f"values: expected equal numbers of channels, found {[found.shape[1:] or (1,) for found in carried]}"
            )
        return np.stack(carried)

    def _values_of(self, index: int, surface: Any, values: Any, interpolation: str | None) -> Floats:
        """Returns the values of a member, (n,) or (n, c)."""
        mesh = as_surface(surface)
        if isinstance(values, (str, os.PathLike)):
            labels = os.fspath(values).lower().endswith((".label.gii", ".label.gii.gz"))
            array = read_signal(values)
            flat = array.shape[1] == 1
        else:
            values = _arrays.unwrapped(f"values[{index}]", values)
            labels = np.asarray(values).dtype.kind in "iub"
            array, flat = _arrays.channels(f"values[{index}]", values), np.ndim(values) == 1
        if len(array) != len(mesh.vertices):
            raise ValueError(f"values[{index}]: expected a row for each of {len(mesh.vertices)} vertices, found {len(array)}")
        places, far = self._own_places(index)
        labels = labels if interpolation is None else interpolation == "nearest"
        found, off = _core.values_at(mesh.vertices, mesh.faces, array, places, labels=labels)
        reached = self.reached[index]
        if reached.any() and np.median(off[reached]) > far:
            raise ValueError(
                f"surfaces[{index}]: expected the mesh of member {self.names[index]} that was brought into correspondence, "
                f"found a mesh at a distance of {np.median(off[reached]):.4g} from it"
            )
        found[~reached] = np.nan
        return found[:, 0] if flat else found

    @overload
    def add(
        self,
        surface: Path | Surface | Model,
        *,
        mirrored: bool = False,
        threads: int | None = None,
        progress: Progress = None,
    ) -> Member: ...
    @overload
    def add(
        self,
        surface: Sequence[Any],
        *,
        mirrored: bool = False,
        threads: int | None = None,
        progress: Progress = None,
    ) -> list[Member] | Member: ...
    def add(
        self, surface: Any, *, mirrored: bool = False, threads: int | None = None, progress: Progress = None
    ) -> Any:
        """Registers surfaces to the group without changing its mean, sphere and members.

        Surfaces added together share their preparation; the results are the same as one by one.

        Parameters
        ----------
        surface : str, os.PathLike, Surface, Model or what `spharm_rs.as_surface` takes; or a list of them
        mirrored : bool
            Mirror the surfaces first, x to -x. Their transforms include the reflection.
        threads : int, optional
        progress : bool or callable, optional

        Returns
        -------
        Member, or list of Member
        """
        several = isinstance(surface, list)
        surfaces = surface if several else [surface]
        names = _names(surfaces, len(self))
        found = self._inner.add(
            [given(item) for item in surfaces],
            names,
            mirrored=bool(mirrored),
            threads=_arrays.threads(threads),
            progress=callback(progress),
        )
        members = [
            Member(
                name, Model._of(model), SimilarityTransform._of(json.loads(transform)), places, reached, json.loads(report),
                tuple(doubts),
            )
            for name, (model, transform, places, reached, report, doubts) in zip(names, found)
        ]
        warn(f"{member.name}: {text}" for member in members for text in member.warnings)
        return members if several else members[0]


def _unpickled(
    data: dict[str, bytes], names: tuple[str, ...], landmarks: tuple[tuple[str, ...] | None, list[Floats]] | None
) -> Group:
    with tempfile.TemporaryDirectory() as folder:
        for name, content in data.items():
            path = pathlib.Path(folder, name)
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        inner, _ = _core.Group.read(folder, names)
    return Group._of(inner, names, landmarks)


def _signals(given: Any, count: int, refine: bool) -> tuple[list[list[Floats]], list[float]]:
    """Returns the signals of each member, and their weights."""
    values: list[list[Floats]] = [[] for _ in range(count)]
    weights = []
    for index, pair in enumerate(given):
        what = f"signals[{index}]"
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise ValueError(f"{what}: expected a pair (values, weight), found {type(pair).__name__}")
        of_members, weight = pair
        if len(of_members) != count:
            raise ValueError(f"{what}: expected one array for each of {count} surfaces, found {len(of_members)}")
        for member, own in enumerate(of_members):
            own = _arrays.real(f"{what}[{member}]", own, "(vertices,)")
            if own.ndim != 1:
                raise ValueError(f"{what}[{member}]: expected one value per vertex, found an array of shape {own.shape}")
            values[member].append(own)
        weights.append(float(weight))
    if weights and not refine:
        raise ValueError("signals: expected refine=True, because signals are channels of the refinement")
    return values, weights


def correspond(
    surfaces: Iterable[Any] | Mapping[str, Any],
    max_degree: int,
    *,
    template: Any = None,
    landmarks: Sequence[Landmarks | ArrayLike | Path] | None = None,
    guide: bool = False,
    signals: Sequence[tuple[Sequence[ArrayLike], float]] = (),
    rounds: int = 2,
    refine: bool = True,
    pose: Literal["any", "near", "given"] = "any",
    scale: bool = False,
    mirror: bool = False,
    mirrored: Sequence[bool] | None = None,
    subdivisions: int | None = None,
    memory: int | str | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Group:
    """Makes surfaces of any poses and topology correspond, so that a direction is the same place on every surface.

    One template is mapped to the sphere and registered in space to every surface. All surfaces are fitted over the
    template's sphere; then the group's own statistics refine the directions. Results are identical bit for bit
    with any number of threads.

    Parameters
    ----------
    surfaces : iterable, or dict of names and surfaces
        Two or more: paths of meshes or of volumes of one label, `Surface`, `Model` (evaluated on an icosphere) or what
        `spharm_rs.as_surface` takes. Each path is read when its surface is needed.
    max_degree : int
        Highest degree L of the models, inclusive.
    template : int, str, or a surface as in ``surfaces``, optional
        First template: a member, given by number or name, or another surface; by default the most typical member.
    landmarks : sequence of Landmarks, of array_like of float, (p, 3), or of paths, optional
        The same places on each member, in the member's own coordinates, for checks; landmarks with names are matched by
        name.
    guide : bool
        Also let the landmarks guide the registration: the template's landmarks are drawn to those of each surface, and
        held in the refinement. ``report["guide"]`` has their distances from their places, with each landmark guiding
        and with each left out. The template has to be a member.
    signals : sequence of (values, weight)
        Signals on the surfaces, such as thickness, to match in the refinement: for each member an array with a value per vertex.
        One standard deviation of the signal counts as a distance of ``weight`` times the square root of the area;
        normals have weight 0.12.
    rounds : int
        Rounds of registration; from the second round on, the group's mean is the template.
    refine : bool
        Refine directions by the group's statistics.
    pose : {"any", "near", "given"}
        Poses to consider. "any" tries every rotation of a surface; a surface that looks nearly the same after a half turn
        may then be turned over. "near" only improves the surfaces' own poses; use it for surfaces in one coordinate
        system, such as scans in template space. "given" leaves the surfaces where they are, so no alignment spreads a
        local change over the whole surface. It can't be combined with ``scale`` or ``mirror``.
    scale : bool
        Scale members to one size.
    mirror : bool
        Also match mirror images.
    mirrored : sequence of bool, optional
        Whether each surface is mirrored first, x to -x, such as right hemispheres in a group of left ones. Transforms
        to the group's frame include the reflection.
    subdivisions : int, optional
        Subdivisions of the icosphere whose directions are registered, 2 to 8; by default 4 up to degree 15, 5 up to
        degree 40, and 6 above.
    memory : int or str, optional
        Memory budget of the fits in bytes, or text such as ``"2GiB"``.
    threads : int, optional
    progress : bool or callable, optional

    Returns
    -------
    Group

    Raises
    ------
    MeshError
        If a surface can't be used; the message names the surface.

    Examples
    --------
    >>> import numpy as np, spharm_rs as sp
    >>> ball = sp.icosphere(3)
    >>> eggs = [sp.Surface(ball.vertices * [9 + k, 6, 5], ball.faces) for k in range(3)]
    >>> group = sp.shape.correspond(eggs, 6, subdivisions=3)
    >>> tip = group.carry([[9.0, 0.0, 0.0]], 0, 2)
    >>> bool(np.linalg.norm(tip - [11, 0, 0]) < 0.5 or np.linalg.norm(tip + [11, 0, 0]) < 0.5)
    True
    """
    if isinstance(surfaces, (str, os.PathLike, Surface, Model)) or not hasattr(surfaces, "__iter__"):
        raise ValueError(f"surfaces: expected a sequence of surfaces, found {surfaces!r}")
    for what, one in (("landmarks", landmarks), ("signals", signals), ("mirrored", mirrored)):
        if isinstance(one, Mapping):
            raise ValueError(f"{what}: expected a sequence, in the order of the surfaces; found a dict")
    if isinstance(surfaces, Mapping):
        names, surfaces = list(surfaces), list(surfaces.values())
        if not all(isinstance(name, str) and name for name in names):
            raise ValueError(f"surfaces: expected names that are text as keys, found {names}")
    else:
        surfaces = list(surfaces)
        names = _names(surfaces)
    marks = None if landmarks is None else matched(landmarks, len(surfaces))
    template_member = None
    if isinstance(template, str) and template in names:
        template = names.index(template)
    if isinstance(template, (int, np.integer)) and not isinstance(template, bool):
        if not 0 <= template < len(surfaces):
            raise ValueError(f"template: expected 0 to {len(surfaces) - 1}, found {template}")
        template_member = int(template)
        template = surfaces[template_member]
    if guide and marks is None:
        raise ValueError("guide: expected landmarks, found None")
    if guide and template is not None and template_member is None:
        raise ValueError("template: expected the number or name of a member with guide=True; found another surface")
    values, weights = _signals(signals, len(surfaces), refine)
    reflected = [] if mirrored is None else [bool(one) for one in mirrored]
    if mirrored is not None and len(reflected) != len(surfaces):
        raise ValueError(f"mirrored: expected a bool for each of {len(surfaces)} surfaces, found {len(reflected)}")
    settings = {
        "guide": [own.tolist() for own in marks[1]] if guide and marks is not None else None,
        "template_member": template_member,
        "weights": weights,
        "max_degree": _arrays.whole("max_degree", max_degree),
        "rounds": _arrays.whole("rounds", rounds),
        "refine": bool(refine),
        "pose": _arrays.choice("pose", pose, ("any", "near", "given")),
        "scale": bool(scale),
        "mirror": bool(mirror),
        "mirrored": reflected,
        "subdivisions": None if subdivisions is None else min(_arrays.whole("subdivisions", subdivisions), 2**31),
        "memory": _arrays.size(memory),
    }
    found = _core.shape_correspond(
        [given(surface) for surface in surfaces],
        names,
        None if template is None else given(template),
        settings=settings,
        signals=values,
        threads=_arrays.threads(threads),
        progress=callback(progress),
    )
    group = Group._of(found, names, marks)
    warn(group.warnings)
    return group
