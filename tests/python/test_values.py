"""Models and surfaces as values: arithmetic, coefficients by degree and order, pictures, and other packages' meshes."""

import builtins
import pickle
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
import spharm_rs as sp
import trimesh
from spharm_rs import _arrays


def model(degree: int = 4, seed: int = 0, channels: int = 3) -> sp.Model:
    values = np.random.default_rng(seed).normal(size=((degree + 1) ** 2, channels))
    return sp.Model(values, sphere=sp.icosphere(3))


def test_sums_and_multiples_are_of_the_evaluated_surfaces() -> None:
    a, b = model(4, 1), model(7, 2)
    at = np.random.default_rng(3).normal(size=(20, 3))
    total = (2 * a - b / 4 + np.float64(0.5) * (-a)).evaluate(at)
    np.testing.assert_allclose(total, 1.5 * a.evaluate(at) - b.evaluate(at) / 4, atol=1e-12)
    assert (a + b).max_degree == 7 and a + b == b + a and (a + b) - b != a
    np.testing.assert_allclose(((a + b) - b).truncate(4).coefficients, a.coefficients, atol=1e-14)
    summed = sum([a, b, a])
    assert isinstance(summed, sp.Model)
    mean = summed / 3
    np.testing.assert_allclose(mean.evaluate(at), (2 * a.evaluate(at) + b.evaluate(at)) / 3, atol=1e-12)
    # The sphere is that of the first model.
    directions = (a + sp.Model(b.coefficients)).directions
    assert directions is not None and len(directions) == 642 and (sp.Model(b.coefficients) + a).directions is None


def test_multiples_and_truncations_keep_the_standard_errors() -> None:
    surface, sphere = sp.example_surface(3)
    fitted = sp.fit(surface.vertices[:, 2], sphere, 5, stderr=True)
    errors = fitted.standard_errors
    assert errors is not None
    expected: list[tuple[sp.Model, Any]] = [
        (2 * fitted, 2 * errors),
        (fitted / -4, errors / 4),
        (-fitted, errors),
        (0 + fitted, errors),
        (fitted.truncate(3), errors[:16]),
        (fitted.truncate(3) * 0.5, errors[:16] / 2),
    ]
    for found, by_hand in expected:
        assert found.standard_errors is not None and found.standard_errors is not errors
        np.testing.assert_array_equal(found.standard_errors, by_hand)
    assert (fitted + fitted).standard_errors is None and (2 * sp.Model(fitted.coefficients)).standard_errors is None
    assert sp.Model(fitted.coefficients).truncate(2).standard_errors is None


def test_a_rotated_model_is_that_of_shape() -> None:
    given = model()
    settings: dict[str, Any] = {"parameters": [10, 20, 30], "object": [40, 50, 60], "scale": 2.0, "translation": [1, 2, 3]}
    assert given.rotate(**settings) == sp.shape.rotate(given, **settings) and given.rotate() is not given
    # Rz(alpha) Ry(beta) Rz(gamma), by which pyshtools rotates with body=True; by default, it rotates by the inverse.
    cosine, sine = np.cos(np.radians([10, 20, 30])), np.sin(np.radians([10, 20, 30]))
    z0, z2 = (np.array([[cosine[k], -sine[k], 0], [sine[k], cosine[k], 0], [0, 0, 1]]) for k in (0, 2))
    y = np.array([[cosine[1], 0, sine[1]], [0, 1, 0], [-sine[1], 0, cosine[1]]])
    u, r = np.random.default_rng(1).normal(size=(9, 3)), z0 @ y @ z2
    np.testing.assert_allclose(given.rotate(parameters=[10, 20, 30]).evaluate(u @ r.T), given.evaluate(u), atol=1e-11)
    np.testing.assert_allclose(given.rotate(parameters=[-30, -20, -10]).evaluate(u @ r), given.evaluate(u), atol=1e-11)


def test_other_conventions_take_their_options() -> None:
    given = model(3)
    options: dict[str, Any] = {"normalization": "4pi", "csphase": -1}
    array = given.to("pyshtools", **options)
    np.testing.assert_array_equal(array, sp.convert.to_pyshtools(given.coefficients, **options))
    np.testing.assert_allclose(sp.Model.from_("pyshtools", array, **options).coefficients, given.coefficients, atol=1e-14)
    with pytest.raises(ValueError, match="csphase: expected no options for the format frame"):
        sp.Model.from_("frame", given.to_frame(), csphase=1)


def test_tables_have_degrees_orders_and_channels() -> None:
    for given in (model(3), model(2, channels=2), sp.Model(model(2).coefficients, surface=False)):
        frame, array = given.to_frame(), given.to_xarray()
        names = list("xyz") if given.is_surface else [str(channel) for channel in range(given.coefficients.shape[1])]
        assert list(frame.columns) == names == array.coords["channel"].values.tolist()
        np.testing.assert_array_equal(frame.loc[(2, -1)], given[2, -1])
        np.testing.assert_array_equal(array.set_index(harmonic=["degree", "order"]).sel(degree=2, order=1), given[2, 1])
        for format, table in (("frame", frame.sample(frac=1, random_state=0)), ("xarray", array[::-1].T)):
            back = sp.Model.from_(format, table, sphere=sp.icosphere(1))
            assert back == given and back.directions is not None
    frame = model(1).to_frame()
    part = sp.Model.from_("frame", frame.drop(index=(1, 0)))
    assert part[1, 0].tolist() == [0, 0, 0] and np.array_equal(part[1, 1], model(1)[1, 1])
    refused: list[tuple[Any, str]] = [
        (np.eye(3), "expected a DataFrame or a DataArray, found ndarray"),
        (frame.reset_index(drop=True), "expected an index of degree and order"),
        (frame.rename(index={1: -1}, level="degree"), "expected an order from -l to l"),
        (frame.rename(index={0: 2}, level="order"), "expected an order from -l to l for degree l, found degree 0 and order 2"),
        (frame.rename(index={-1: 1}, level="order"), "expected each degree and order once"),
        (frame.rename(index={1: 1.5}, level="degree"), "expected whole numbers in degree, found float64"),
        (model(1).to_xarray().rename(harmonic="row"), "expected the dimensions harmonic and channel, found row, channel"),
        (model(1).to_xarray().drop_vars("order"), "found no order"),
    ]
    for table, text in refused:
        with pytest.raises(ValueError, match=text):
            sp.Model.from_("frame", table)


def test_equality_is_that_of_coefficients_and_kind() -> None:
    a = model()
    assert a == sp.Model(a.coefficients) and a == pickle.loads(pickle.dumps(a)) and a != 2 * a
    assert a != sp.Model(a.coefficients, surface=False) and a != a.truncate(3) and a != "a"
    with pytest.raises(TypeError, match="unhashable"):
        hash(a)


def test_degrees_and_orders() -> None:
    a = model()
    assert len(a) == 5 and [len(rows) for rows in a] == [1, 3, 5, 7, 9]
    np.testing.assert_array_equal(a[3], a.coefficients[9:16])
    np.testing.assert_array_equal(a[3, -2], a.coefficients[10])
    np.testing.assert_array_equal(np.asarray(a), a.coefficients)
    large = model(16)
    np.testing.assert_array_equal(large[np.uint8(16)], large.coefficients[256:])
    np.testing.assert_array_equal(large[np.uint8(16), np.int8(-3)], large.coefficients[256 + 13])
    refused: list[tuple[Any, type[Exception], str]] = [
        (5, IndexError, "expected 0 to 4, found 5"),
        (-1, IndexError, "expected 0 to 4, found -1"),
        ((2, 3), IndexError, "expected -2 to 2 for degree 2, found 3"),
        ("x", TypeError, "expected whole numbers"),
        ((1, 0.5), TypeError, "expected whole numbers"),
    ]
    for index, error, text in refused:
        with pytest.raises(error, match=text):
            a[index]
    with pytest.raises(ValueError, match="read-only"):
        a[1][0] = 0


def test_what_is_no_sum() -> None:
    a = model()
    for other in (1, "x", None, np.ones(3)):
        with pytest.raises(TypeError):
            a + other
    with pytest.raises(TypeError):
        a - 0
    with pytest.raises(ZeroDivisionError):
        a / 0
    with pytest.raises(ValueError, match="finite"):
        a * np.nan
    with pytest.raises(ValueError, match="one of each"):
        a + sp.Model(a.coefficients, surface=False)
    with pytest.raises(TypeError):
        a * a
    with pytest.raises(ValueError, match="expected equal numbers of channels, found 3 and 1"):
        a + model(channels=1)


def test_points_normals_curvature_area_and_volume() -> None:
    coefficients = np.zeros((4, 3))
    coefficients[3, 0] = coefficients[1, 1] = coefficients[2, 2] = 5 * np.sqrt(4 * np.pi / 3)
    ball = sp.Model(coefficients)
    assert abs(ball.area - 100 * np.pi) < 1e-6 and abs(ball.volume - 500 / 3 * np.pi) < 1e-9
    u = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(ball.at(u), 5 * u, atol=1e-12)
    np.testing.assert_allclose(ball.at([u, -u]), [5 * u, -5 * u], atol=1e-12)
    np.testing.assert_allclose(ball.normals([u]), [u], atol=1e-12)
    np.testing.assert_allclose(ball.curvature([u, -u]), [0.2, 0.2], atol=1e-12)
    mesh = ball.surface(6)
    assert abs(mesh.area / ball.area - 1) < 1e-3 and abs(mesh.volume / ball.volume - 1) < 2e-3
    assert sp.Surface(mesh.vertices + 100, mesh.faces[:, ::-1]).volume == pytest.approx(-mesh.volume)


def test_pictures_show_the_surface_and_its_values() -> None:
    surface, sphere = sp.example_surface(4)
    plain = surface.picture(size=200, view="front")
    assert plain.png[:8] == b"\x89PNG\r\n\x1a\n" and plain._repr_png_() == plain.png
    width, height = np.frombuffer(plain.png[16:24], ">u4")
    assert (width, height) == (200, 200)
    coloured = sp.picture(surface, surface.vertices[:, 2], label="height", size=200)
    other = sp.picture(surface, surface.vertices[:, 2], label="height", size=200, limits=(-1000, 1000))
    assert len({plain.png, coloured.png, other.png}) == 3
    fitted = sp.fit(surface, sphere, 6)
    html = fitted._repr_html_()
    assert "data:image/png;base64," in html and f"{fitted.rms:.4g}" in html
    assert "degree" in (fitted - fitted)._repr_html_() and "degree" in fitted.truncate(0)._repr_html_()
    assert "img" not in sp.Model(np.ones((4, 1)))._repr_html_()
    refused: list[tuple[dict[str, Any], str]] = [
        ({"size": 10}, "size: expected 64 to 4096 pixels, found 10"),
        ({"view": "above"}, "view: expected left, right"),
        ({"values": np.ones(3)}, "values: expected shape"),
        ({"values": np.ones(2562), "limits": (1, 1)}, "limits: expected two increasing numbers"),
    ]
    for arguments, text in refused:
        with pytest.raises(ValueError, match=text):
            sp.picture(surface, **arguments)


def test_values_at_other_vertices_are_refused_with_the_sphere_to_give() -> None:
    surface, sphere = sp.example_surface(3)
    fitted = sp.fit(surface, sphere, 6)
    at_fit = fitted.curvature()
    for draw in (fitted.picture, fitted.plot):
        with pytest.raises(ValueError, match=r"vertex of the sphere at=5; found \(642,\); give at=model.sphere for values"):
            draw(at_fit)
    with pytest.raises(ValueError, match=r"vertex of the sphere at, a Surface; found \(162,\); give the values' sphere as at="):
        fitted.picture(fitted.curvature(2), at=sphere)
    drawn = fitted.picture(at_fit, at=fitted.sphere, size=64).png
    assert drawn == fitted.picture(at_fit, at=None, size=64).png
    assert drawn == fitted.picture(at_fit[:, np.newaxis], at=None, size=64).png
    signal = sp.fit(surface.vertices[:, 2], sphere, 6)
    for call in (lambda: fitted.picture(signal), lambda: fitted.to_nilearn(signal)):
        with pytest.raises(ValueError, match=r"values: expected a value for each vertex, found a Model; call its evaluate\(\)"):
            call()
    assert fitted.to_nilearn(signal.evaluate()).data.parts["left"].shape == (642, 1)


def test_a_picture_is_saved_as_png_only(tmp_path: Path) -> None:
    picture = sp.icosphere(2).picture(size=64)
    for name in ("a.jpg", "a", "png", "a.png.svg"):
        with pytest.raises(ValueError, match=f"path: expected a name that ends in .png, found .*{name}$"):
            picture.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    picture.save(tmp_path / "a.PNG")


def test_a_picture_is_not_overwritten_unasked(tmp_path: Path) -> None:
    picture = sp.icosphere(2).picture(size=64)
    picture.save(tmp_path / "a.png")
    with pytest.raises(FileExistsError):
        picture.save(tmp_path / "a.png")
    picture.save(tmp_path / "a.png", overwrite=True)
    assert (tmp_path / "a.png").read_bytes() == picture.png


def test_meshes_of_other_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    surface, _ = sp.example_surface(2)
    mesh = surface.to_trimesh()
    assert isinstance(mesh, trimesh.Trimesh) and mesh.volume == pytest.approx(surface.volume)
    assert mesh.area == pytest.approx(surface.area)
    np.testing.assert_array_equal(sp.as_surface(mesh).vertices, surface.vertices)
    mesh.vertices[0] += 1
    assert abs(sp.as_surface(mesh).vertices[0] - surface.vertices[0]).min() == 1
    image = surface.to_nibabel()
    read = nibabel.GiftiImage.from_bytes(image.to_bytes())
    np.testing.assert_allclose(sp.as_surface(read).vertices, surface.vertices, rtol=1e-6)
    np.testing.assert_array_equal(sp.as_surface(read).faces, surface.faces)
    fitted = sp.fit(*sp.example_surface(4), 6)
    for at, degree in ((None, None), (3, 4)):
        expected = fitted.surface(at, degree=degree)
        of_model = fitted.to_trimesh(at, degree=degree)
        np.testing.assert_array_equal(of_model.vertices, expected.vertices)
        np.testing.assert_array_equal(of_model.faces, expected.faces)
        np.testing.assert_array_equal(sp.as_surface(fitted.to_nibabel(at, degree=degree)).faces, expected.faces)
    assert fitted.to_nilearn(fitted.curvature(), hemisphere="right").data.parts["right"].shape == (2562,)
    load = builtins.__import__

    def without_pyvista(name: str, *rest: Any) -> Any:
        if name == "pyvista":
            raise ImportError(name)
        return load(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_pyvista)
    assert isinstance(surface.plot(), sp.Picture)
    assert isinstance(sp.fit(*sp.example_surface(3), 4).plot(), sp.Picture)


def rotation(seed: int) -> Any:
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def test_transforms_compose_and_have_a_matrix() -> None:
    a = sp.shape.SimilarityTransform(rotation(1), False, rotation(2), 2.0, np.array([1.0, 2, 3]))
    b = sp.shape.SimilarityTransform(rotation(3), True, -rotation(4), 0.5, np.array([-4.0, 5, 6]))
    points = np.random.default_rng(5).normal(size=(10, 3))
    homogeneous = np.column_stack([points, np.ones(10)])
    np.testing.assert_allclose((homogeneous @ a.matrix.T)[:, :3], a.apply(points), atol=1e-12)
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-12)
    np.testing.assert_allclose((b @ b.inverse()).matrix, np.eye(4), atol=1e-12)
    shape = model(5)
    np.testing.assert_allclose((a @ b).apply(shape).coefficients, a.apply(b.apply(shape)).coefficients, atol=1e-11)
    with pytest.raises(TypeError):
        a @ 2


def test_directions_are_given_as_numbers_of_subdivisions_and_as_spheres() -> None:
    surface, sphere = sp.example_surface(3)
    model = sp.fit(surface, sphere, 4)
    even = sp.icosphere(2)
    for at in (2, "icosphere:2", even):
        assert np.array_equal(model.evaluate(at), model.evaluate(even.vertices))
        assert np.array_equal(model.curvature(at), model.curvature(even.vertices))
        assert np.array_equal(model.normals(at), sp.shape.geometry(model, even.vertices).normals)


def test_one_surface_and_several_are_told_apart() -> None:
    surface, sphere = sp.example_surface(3)
    for several in ([surface, surface], ["a.ply", "b.ply"], (surface, surface, surface)):
        with pytest.raises(ValueError, match=f"expected one mesh, found {len(several)} meshes in a .*use fit_many for several"):
            sp.fit(several, max_degree=4)
    one: Any
    for one in (surface, "a.ply", 3):
        with pytest.raises(ValueError, match="expected several surfaces or signals, found one .*give a list"):
            sp.fit_many(one, sphere, 4)
        with pytest.raises(ValueError, match="expected several surfaces or signals"):
            sp.fit_each(one, 4)


def gifti(*arrays: Any, intent: str = "NIFTI_INTENT_SHAPE", mesh: Any = None) -> Any:
    """Returns nibabel's image of arrays of values, and of a mesh."""
    found = [nibabel.gifti.GiftiDataArray(np.asarray(one), intent=intent) for one in arrays]
    return nibabel.GiftiImage(darrays=[*found, *([] if mesh is None else mesh.to_nibabel().darrays)])


def images(values: Any) -> dict[str, Any]:
    """Returns images of nibabel and nilearn that hold values at the vertices of an icosphere."""
    image = sp.icosphere(3).to_nilearn(values)
    columns = values[:, None] if values.ndim == 1 else values
    return {"GiftiImage": gifti(*columns.T), "SurfaceImage": image, "PolyData": image.data}


def test_values_are_taken_from_images(tmp_path: Path) -> None:
    sphere = sp.icosphere(3)
    one = sphere.vertices[:, 0].astype(np.float32)
    several = (sphere.vertices**2).astype(np.float32)
    for values in (one, several):
        for name, image in images(values).items():
            path = tmp_path / f"{name}{values.ndim}.csv"
            sp.write_signal(path, image)
            np.testing.assert_array_equal(sp.read_signal(path), values.reshape(642, -1))
            coefficients, _ = sp.solve(sphere.vertices, image, 4)
            assert np.array_equal(coefficients, sp.solve(sphere.vertices, values, 4)[0])
    for name, image in images(one).items():
        assert sp.picture(sphere, image, size=80).png == sp.picture(sphere, one, size=80).png
        if name != "SurfaceImage":
            assert sp.fit(image, sphere, 4) == sp.fit(one, sphere, 4)
    # Three values of an image aren't positions.
    assert not sp.fit(images(several)["PolyData"], sphere, 4).is_surface and sp.fit(several, sphere, 4).is_surface
    # The mesh of an image has no values.
    mesh = sphere.to_nibabel()
    assert sp.fit(mesh, sphere, 4).is_surface
    both = type(sphere.to_nilearn(one))({"left": sphere.to_nilearn(), "right": sphere.to_nilearn()}, {"left": one, "right": one})
    refused: list[tuple[Any, str]] = [
        (mesh, "values: expected a GIfTI image with values on vertices, found a mesh"),
        (gifti(), "found an empty image"),
        (gifti(one, one[1:]), "values: expected a GIfTI image with arrays of equal lengths, found 641, 642"),
        (gifti(np.arange(642, dtype=np.int32), intent="NIFTI_INTENT_NODE_INDEX"), "found a GIfTI image with values for listed"),
        (both, "values: expected one hemisphere, found left and right; give one, such as image.data.parts"),
    ]
    for image, text in refused:
        with pytest.raises(ValueError, match=text):
            sp.write_signal(tmp_path / "refused.csv", image)
    assert np.array_equal(sp.solve(sphere.vertices, gifti(one, mesh=sphere), 4)[0], sp.solve(sphere.vertices, one, 4)[0])


def test_masks_are_taken_from_images(tmp_path: Path) -> None:
    sphere = sp.icosphere(3)
    kept = sphere.vertices[:, 2] < 0.5
    values = np.where(kept, sphere.vertices[:, 0], np.nan)
    right = sp.fit(values, sphere, 3, mask=kept)
    labels = gifti(np.where(kept, 2, 1).astype(np.int32), intent="NIFTI_INTENT_LABEL")
    for key, name in ((0, "???"), (1, "Medial_wall"), (2, "cortex")):
        label = nibabel.gifti.GiftiLabel(key)
        label.label = name
        labels.labeltable.labels.append(label)
    labels.to_filename(tmp_path / "lh.label.gii")
    column = sphere.to_nilearn(kept.astype(float)[:, None])
    for mask in (*images(kept.astype(np.float32)).values(), column, labels, tmp_path / "lh.label.gii"):
        assert sp.fit(values, sphere, 3, mask=mask) == right
    sp.write_signal(tmp_path / "mask.shape.gii", kept)
    assert sp.read_signal(tmp_path / "mask.shape.gii")[:, 0].tolist() == kept.astype(float).tolist()
    assert sp.fit(values, sphere, 3, mask=tmp_path / "mask.shape.gii") == right
    with pytest.raises(ValueError, match=r"mask: expected shape \(642,\), found \(162,\)"):
        sp.fit(values, sphere, 3, mask=sp.icosphere(2).to_nilearn(np.ones(162)))


def test_subjects_of_a_test_are_taken_from_images() -> None:
    values = np.random.default_rng(1).normal(size=(8, 642)).astype(np.float32)
    groups, sphere = ["a", "b"] * 4, sp.icosphere(3)
    right = sp.shape.group_test(values, groups, permutations=20)
    several: list[Any] = [
        [gifti(row) for row in values],
        tuple(sphere.to_nilearn(row) for row in values),
        [sphere.to_nilearn(row[:, None]) for row in values],
        [values[0], *(sphere.to_nilearn(row).data for row in values[1:])],
        sphere.to_nilearn(values.T),
        gifti(*values),
    ]
    for subjects in several:
        found = sp.shape.group_test(subjects, groups, permutations=20)
        assert found.statistic.tobytes() == right.statistic.tobytes()
        change = sp.shape.group_test(2 * values, groups, minus=subjects, permutations=20)
        assert np.allclose(change.statistic, right.statistic)
    refused: list[tuple[Any, str]] = [
        ([gifti(values[0]), gifti(values[1][1:])], r"subjects\[1\]: expected shape \(642,\), as in .*; found \(641,\)"),
        (gifti(values[0]), r"subjects: expected an image for each subject, or one image of shape \(V, n\); found \(642,\)"),
    ]
    for subjects, text in refused:
        with pytest.raises(ValueError, match=text):
            sp.shape.group_test(subjects, groups)


def test_a_mesh_and_values_of_one_image_are_told_apart() -> None:
    surface, sphere = sp.example_surface(3)
    height = surface.vertices[:, 2]
    image = surface.to_nilearn(height)
    with pytest.raises(ValueError, match="found a SurfaceImage, which has both; give image.mesh to fit the shape, or image.data"):
        sp.fit(image, sphere, 4)
    assert sp.fit(image.mesh, sphere, 4) == sp.fit(surface, sphere, 4)
    assert sp.fit(image.data, sphere, 4) == sp.fit(height, sphere, 4)
    # Without a sphere, only a mesh can be fitted; comparisons only read meshes.
    assert sp.fit(image, max_degree=4) == sp.fit(surface, max_degree=4)
    assert sp.compare(image, surface).rms == 0


def test_missing_values_inside_a_mask_are_named(tmp_path: Path) -> None:
    surface, sphere = sp.example_surface(3)
    kept = np.arange(642) >= 9
    values = np.where(np.arange(642) < 12, np.nan, surface.vertices[:, 0])
    inside = r"NaN at vertex 9 \(counted from 0\), which is inside the mask; .* mask=mask & ~np.isnan\(values\)$"
    without = r"NaN at vertex 0 \(counted from 0\); leave out vertices without values, for example with mask=~np.isnan\(values\)$"
    positions = np.where((np.arange(642) < 12)[:, None], np.inf, surface.vertices)
    path = tmp_path / "values.csv"
    path.write_text("x\n" + "".join(f"{value!r}\n" for value in values.tolist()))
    refused: list[tuple[Any, Any, str]] = [
        (values, kept, f"values: expected finite numbers, found {inside}"),
        (values, None, f"values: expected finite numbers, found {without}"),
        (path, kept, f"values.csv: expected finite numbers, found {inside}"),
        (path, None, f"values.csv: expected finite numbers, found {without}"),
        (positions, kept, r"surface: .*infinity at vertex 9 .*inside the mask; .*mask=mask & np.isfinite\(values\).all\(axis=-1\)$"),
        (np.where(np.isinf(positions), np.nan, positions), None, r"~np.isnan\(values\).any\(axis=-1\)$"),
    ]
    for given, mask, text in refused:
        with pytest.raises(sp.MeshError, match=text):
            sp.fit(given, sphere, 4, mask=mask)
    for mask, text in ((kept, "NaN in row 9 .*inside the mask; .* mask=mask & ~np.isnan"), (None, "NaN in row 0 .*mask=~np.isnan")):
        with pytest.raises(sp.MeshError, match=text):
            sp.solve(sphere.vertices, values, 4, mask=mask)
    # The advice helps.
    assert np.isfinite(sp.fit(values, sphere, 4, mask=kept & ~np.isnan(values)).coefficients).all()
    assert sp.fit(positions, sphere, 4, mask=np.isfinite(positions).all(axis=1)).is_surface


def test_masked_numbers_are_missing_and_outside_of_masks() -> None:
    left_out = np.arange(162) < 10
    for values in (np.ones(162), np.ones(162, bool)):
        kept = _arrays.mask(np.ma.array(values, mask=left_out), 162)
        assert kept is not None and np.array_equal(kept, ~left_out)
        missing = _arrays.channels("values", np.ma.array(values, mask=left_out))
        assert np.array_equal(np.isnan(missing[:, 0]), left_out)


def test_masks_and_weights_of_a_grid_are_of_any_array_type() -> None:
    grid = sp.spectra.grid(np.arange(16.0))
    values = grid.values.copy()
    values[2, 3] = np.nan
    kept = ~np.isnan(values)
    expected, _ = sp.solve(grid.directions, values, 3, mask=kept)
    for mask in (kept.tolist(), np.ma.array(np.ones_like(kept), mask=~kept)):
        assert np.array_equal(sp.solve(grid.directions, values, 3, mask=mask)[0], expected)
    with pytest.raises(sp.MeshError, match=r"mask=~np.isnan\(values\), or drop"):
        sp.solve(grid.directions, values, 3)
    with pytest.raises(sp.MeshError, match=r"mask=~np.isnan\(values\).any\(axis=-1\)"):
        sp.solve(grid.directions, values.reshape(-1, 1), 3)


def test_many_images_are_fitted_over_a_sphere() -> None:
    surface, sphere = sp.example_surface(3)
    maps = [surface.vertices[:, axis] for axis in (0, 1)]
    images = []
    for values in maps:
        array = nibabel.gifti.GiftiDataArray(values.astype(np.float32), intent="NIFTI_INTENT_SHAPE", datatype="NIFTI_TYPE_FLOAT32")
        images.append(nibabel.gifti.GiftiImage(darrays=[array]))
    expected = sp.fit_many([values.astype(np.float32) for values in maps], sphere, 4)
    assert sp.fit_many(images, sphere, 4) == expected
    with pytest.raises(ValueError, match="surfaces: expected a mesh or values, found a SurfaceImage, which has both"):
        sp.fit_many([surface.to_nilearn(maps[0])], sphere, 4)
