"""What a fit starts from: effects that the description holds, that show, and that are given."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.fit.setup import Setup, described_effects, starting_effects, with_given
from lfcal.simulate.effects import Crosstalk, IndexMismatch, Spherical, VectorialPupil
from tests.fit.common import small_camera


@pytest.mark.parametrize(("name", "z_um", "vectorial"), [("bench", None, False), ("lfm_60x12", 2.0, True)])
def test_light_is_a_vector_field_where_it_shows(name: str, z_um: float | None, vectorial: bool) -> None:
    where = {"virtual_depths": (3.0,)} if z_um is None else {"depths_um": (z_um,)}
    plan = ScanPlan.for_camera(small_camera(name), cutout=45, **where)
    assert any(isinstance(e, VectorialPupil) for e in starting_effects(plan)) == vectorial
    assert set(described_effects(plan.camera)) <= set(starting_effects(plan))


def test_one_plane_in_which_it_shows_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = ScanPlan.for_camera(small_camera("bench"), cutout=45, virtual_depths=(3.0, 4.0, 5.0))
    errors = iter([0.0, 0.5, 0.0])
    monkeypatch.setattr(VectorialPupil, "estimate", lambda *_: SimpleNamespace(error=next(errors)))
    assert any(isinstance(e, VectorialPupil) for e in starting_effects(plan))


def test_given_effects_take_the_places_of_others() -> None:
    described = described_effects(preset("bench"))
    found = with_given(described, {"exact_angles": "off", "spherical": "on"}, (Crosstalk(0.03),))
    names = [e.name for e in found]
    assert "exact_angles" not in names and Crosstalk(0.03) in found and Spherical() in found
    with pytest.raises(InputError, match="effects of a fit: expected effects on the light of a point, got shot_noise"):
        with_given(described, {"shot_noise": "on"}, ())
    with pytest.raises(InputError, match="nonsense"):
        with_given(described, {"nonsense": "off"}, ())


def test_the_depth_in_a_specimen_is_unknown_where_there_is_one() -> None:
    camera = preset("lfm_20x05")
    frame, plain = ScanScales(1, 20.0), described_effects(camera)
    assert len(Vector(Setup(camera, plain, (0.0,)), frame, ("specimen",))) == 0
    vector = Vector(Setup(camera, (*plain, IndexMismatch(1.38, 20.0)), (0.0,)), frame, ("specimen",))
    (one,) = vector.unknowns
    assert one.start == 20.0 and "1.38" in one.gauge
    changed = vector.setup_at(vector.clipped(vector.prior()[1] + 1.0)).effect(IndexMismatch)
    assert changed == IndexMismatch(1.38, 20.0 + one.scale)


def test_a_scan_lies_where_it_is_said_to_unless_said_otherwise() -> None:
    setup = Setup(small_camera("bench"), (), (0.0,))
    assert setup.aside_px == (0.0, 0.0) and setup.stage_scale == 0 and not setup.regions and setup.hole_um is None
