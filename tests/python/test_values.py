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
        (frame.reset_index(), "expected an index of degree and order"),
        (frame.rename(index={1: -1}, level="degree"), "expected an order from -l to l"),
        (frame.rename(index={0: 2}, level="order"), "expected an order from -l to l of degree l, found degree 0 and order 2"),
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
        with pytest.raises(ValueError, match=f"expected one mesh, found {len(several)} in a .*fit_many fits several"):
            sp.fit(several, max_degree=4)
    one: Any
    for one in (surface, "a.ply", 3):
        with pytest.raises(ValueError, match="expected several surfaces or signals, found one .*fit fits one"):
            sp.fit_many(one, sphere, 4)
        with pytest.raises(ValueError, match="expected several surfaces or signals"):
            sp.fit_each(one, 4)
