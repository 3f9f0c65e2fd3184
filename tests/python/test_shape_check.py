"""Quality control of a group."""

from __future__ import annotations

import numpy as np
import pytest

import spharm_rs as sp


def group() -> list[sp.Model]:
    """Returns ellipsoids, one axis of which differs a little."""
    return [sp.Model(np.eye(9)[:, 1:4] * [6 + k / 10, 5, 4]) for k in range(8)]


def test_subjects_that_differ_a_little_have_no_flags() -> None:
    models = group()
    found = sp.shape.check(models, aligned=models, names=list("abcdefgh"))
    assert [one.name for one in found] == list("abcdefgh")
    for one, model in zip(found, models):
        assert one.flags == () and one.severity == 0 and one.mode == 1 and one.mode_z is not None
        assert one.measures["volume"] == pytest.approx(model.volume) and one.measures["rms"] is None
        assert one.measures["distance"] is not None and one.z["distance"] is not None and one.z["rms"] is None
    bare = sp.shape.check(models)[0]
    assert bare.name == "0" and bare.mode is None and bare.mode_z is None and bare.measures["distance"] is None


def test_unusual_and_equal_subjects_are_flagged() -> None:
    models = group()
    models[3] = models[3] * 10
    models[6] = models[5]
    found = sp.shape.check(models, aligned=models)
    assert [one.name for one in found if one.flags] == ["3", "5", "6"]
    assert found[3].severity > 1 and any("about 10 times" in flag for flag in found[3].flags)
    assert any("mode 1 is mostly due to this subject" in flag for flag in found[3].flags)
    assert found[5].flags == ("same model as 6",) and found[6].flags == ("same model as 5",)


def test_wrong_groups_are_refused() -> None:
    models = group()
    with pytest.warns(sp.SpharmWarning, match="4 subjects are too few"):
        assert all(one.flags == () for one in sp.shape.check(models[:4]))
    with pytest.raises(ValueError, match="aligned: expected 8 models, as many as in models; found 7"):
        sp.shape.check(models, aligned=models[:7])
    with pytest.raises(ValueError, match="names: expected 8 names"):
        sp.shape.check(models, names=["a"])
    with pytest.raises(ValueError, match="names: expected a different name for each subject, found 'a' twice"):
        sp.shape.check(models, names=list("abacdefg"))
    sphere = sp.icosphere(2)
    signal = sp.fit(sphere.vertices[:, 0], sphere, 2)
    with pytest.raises(ValueError, match=r"models\[1\]: expected a model of a surface, found"):
        sp.shape.check([models[0], signal])
