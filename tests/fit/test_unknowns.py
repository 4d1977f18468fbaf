"""Unknowns of a fit: groups, starting values, what each changes, and what each group needs."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import MainLens, ScanPlan, preset
from lfcal.fit import fit_camera, measured_of
from lfcal.fit.design import next_positions
from lfcal.fit.groups.array import about
from lfcal.fit.parameters import GROUPS, ScanScales, Unknown, Vector, check_groups, find_groups, lacking
from lfcal.fit.setup import Setup, described_effects, starting_effects, with_given
from lfcal.simulate.effects import (
    CATALOGUE,
    Crosstalk,
    IndexMismatch,
    LensletSpherical,
    MechanicalVignetting,
    Spherical,
    VectorialPupil,
    Zernike,
)
from tests.distribution import install
from tests.fit.common import few_patterns, setup_of, small_camera, small_plan, vector_of


def vector(name: str, groups: tuple[str, ...] | None = None, **extra: object) -> Vector:
    camera = preset(name)
    effects = (*described_effects(camera), *extra.get("effects", ()))  # type: ignore[misc]
    setup = Setup(camera, effects, (0.0, 0.0))
    return Vector(setup, ScanScales(2, 27.0, (900.0, -700.0)), groups or GROUPS.names())


def test_the_start_is_the_description() -> None:
    for name in ("bench", "r29", "lfm_20x05", "lfm_60x12"):
        found = vector(name)
        start = found.setup_at(np.zeros(len(found)))
        assert start.camera == preset(name) and start.depth_errors_um == (0.0, 0.0), name
        assert start.aside_px == (0.0, 0.0) and start.stage_scale == 0 and not start.regions and start.hole_um is None
        names = [one.name for one in found.unknowns]
        types = len(preset(name).lattice.types)
        assert sum(n.startswith("focal_") for n in names) == sum(n.startswith("lenslet_waves_") for n in names) == types
        assert ("f_number" in names) != ("numerical_aperture" in names)


@pytest.mark.parametrize("name", ["bench", "lfm_20x05"])
def test_every_unknown_changes_the_setup_and_only_its_own_value(name: str) -> None:
    found = vector(name, effects=(MechanicalVignetting(),) if name == "bench" else ())
    start, starts = found.setup_at(np.zeros(len(found))), {one.name: one.start for one in found.unknowns}
    for one, u in zip(found.unknowns, 0.5 * np.eye(len(found)), strict=True):
        values = found.values(u)
        assert [n for n in starts if values[n] != starts[n]] == [one.name]
        assert found.setup_at(u) != start, one.name


def test_values_are_set_in_the_setup() -> None:
    found = vector("bench")
    places = {one.name: k for k, one in enumerate(found.unknowns)}
    u = np.zeros(len(found))
    u[[places["gap_um"], places["focal_1_um"], places["lenslet_waves_2"], places["zernike_3_m1"]]] = 1.0
    setup, values = found.setup_at(u), found.values(u)
    assert setup.camera.lattice.gap_um == values["gap_um"] != preset("bench").lattice.gap_um
    focal = [t.focal_length_um for t in setup.camera.lattice.types]
    assert focal[1] == values["focal_1_um"] and focal[0] == preset("bench").lattice.types[0].focal_length_um
    assert setup.effect(LensletSpherical) == LensletSpherical(0.0, 0.0, 0.0, values["lenslet_waves_2"])
    wavefront = setup.effect(Zernike)
    assert wavefront is not None and (3, -1, values["zernike_3_m1"]) in wavefront.terms


def test_unknowns_start_at_the_values_of_the_setup() -> None:
    found = vector("bench", effects=(LensletSpherical(0.1, type_1=0.2), Zernike(((2, 2, 0.3), (7, 1, 0.05)))))
    start = {one.name: one.start for one in found.unknowns}
    assert start["lenslet_waves_1"] == pytest.approx(0.3) and start["zernike_2_2"] == 0.3
    wavefront = found.setup_at(np.zeros(len(found))).effect(Zernike)
    assert wavefront is not None and (7, 1, 0.05) in wavefront.terms, "terms that are no unknowns stay"


def test_rotation_and_pitch_keep_the_region_in_place() -> None:
    lattice = replace(preset("bench").lattice, offset_um=(13.0, -4.0), rotation_rad=0.02)
    index = (12, -7)
    point = tuple(lattice.centres_um(*index))
    for turn, grow in ((0.01, 0.0), (0.0, 0.02), (-0.02, -0.01)):
        changed = about(lattice, point, turn, grow)
        np.testing.assert_allclose(changed.centres_um(*index), point, atol=1e-9)
        assert changed.rotation_rad == pytest.approx(0.02 + turn)
        assert changed.pitch_um == pytest.approx((1 + grow) * lattice.pitch_um)
    assert np.hypot(*(replace(lattice, rotation_rad=0.03).centres_um(*index) - point)) > 5, "else it moves far"


def test_a_width_is_fitted_by_its_square() -> None:
    one = Unknown("source_um", "source", "µm", 3.0, 4.0, None, 0.0, 20.0, squared=True)
    assert one.value(1.0) == pytest.approx(5.0) and one.value(-9 / 16) == 0.0 and one.value(-9.0) == 0.0
    assert one.clipped(-9.0) == pytest.approx(-9 / 16) and one.value(one.clipped(1e6)) == pytest.approx(20.0)
    assert one.sigma_of(1.0, 0.01) == pytest.approx(0.01 * 16 / 10)
    assert math.isfinite(one.sigma_of(-9 / 16, 0.01))


def test_wrong_unknowns_are_refused() -> None:
    for make, what in (
        (lambda: vector("bench", ("gap",)), r"unknowns: expected geometry, .*, got 'gap'; choose one of these"),
        (lambda: vector("bench", ("geometry", "geometry")), "gap_um twice"),
        (lambda: Unknown("f", "iris", "", 2.0, 1.0, low=0.0, high=1.0), "starting value of f: expected 0 to 1, got 2"),
    ):
        with pytest.raises(InputError, match=what):
            make()


def test_groups_of_other_distributions_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = """
from lfcal.fit.parameters import Group, Unknown
class Own(Group):
    name, title = "own", "something else"
    def unknowns(self, setup, frame):
        return (Unknown("own_one", self.name, "", 0.0, 1.0),)
    def applied(self, setup, values, frame):
        return setup
OWN, BAD = Own(), object()
"""
    entries = {"lfcal.unknowns": "own = others_unknowns:OWN\nbad = others_unknowns:BAD"}
    install(monkeypatch, tmp_path, "others_unknowns", source, entries)
    found = find_groups()
    assert "own" in found and "bad" in found.failures()
    of_fourier = ["lens_centres", "optical_axis", "fourier_lens", "lenslet_gap", "travel_tilt"]
    assert [group.name for group in found if group.core] == ["geometry", *of_fourier, "focal_lengths", "iris"]


def test_light_is_a_vector_field_where_it_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, where, vectorial in (
        ("bench", {"virtual_depths": (3.0,)}, False),
        ("lfm_60x12", {"depths_um": (2.0,)}, True),
    ):
        plan = ScanPlan.for_camera(small_camera(name), cutout=45, **where)
        assert any(isinstance(e, VectorialPupil) for e in starting_effects(plan)) == vectorial
        assert set(described_effects(plan.camera)) <= set(starting_effects(plan))
    # one plane in which it matters is enough
    plan = ScanPlan.for_camera(small_camera("bench"), cutout=45, virtual_depths=(3.0, 4.0, 5.0))
    errors = iter([0.0, 0.5, 0.0])
    monkeypatch.setattr(VectorialPupil, "estimate", lambda *_: SimpleNamespace(error=next(errors)))
    assert any(isinstance(e, VectorialPupil) for e in starting_effects(plan))


def test_given_effects_replace_others() -> None:
    described = described_effects(preset("bench"))
    found = with_given(described, {"exact_angles": "off", "spherical": "on"}, (Crosstalk(0.03),))
    assert "exact_angles" not in [e.name for e in found] and Crosstalk(0.03) in found and Spherical() in found
    for wrong, what in (
        ({"shot_noise": "on"}, "effects of a fit: expected effects on the light of a point, got shot_noise"),
        ({"nonsense": "off"}, "nonsense"),
    ):
        with pytest.raises(InputError, match=what):
            with_given(described, wrong, ())


def test_the_depth_in_a_specimen_is_unknown_where_there_is_one() -> None:
    camera = preset("lfm_20x05")
    frame, plain = ScanScales(1, 20.0), described_effects(camera)
    assert len(Vector(Setup(camera, plain, (0.0,)), frame, ("specimen",))) == 0
    vector = Vector(Setup(camera, (*plain, IndexMismatch(1.38, 20.0)), (0.0,)), frame, ("specimen",))
    (one,) = vector.unknowns
    assert one.start == 20.0 and "1.38" in one.gauge
    changed = vector.setup_at(vector.clipped(vector.prior()[1] + 1.0)).effect(IndexMismatch)
    assert changed == IndexMismatch(1.38, 20.0 + one.scale)


PLAN = small_plan()


def microscope() -> ScanPlan:
    return ScanPlan.for_camera(small_camera("lfm_20x05"), depths_um=(5.0, 12.0), cutout=45)


def test_every_group_has_unknowns_or_states_what_it_needs() -> None:
    for plan in (PLAN, small_plan(depths=(2.2,)), microscope()):
        without = lacking(setup_of(plan), plan)
        names = {one.group for one in vector_of(plan, GROUPS.names()).unknowns}
        assert names | set(without) == set(GROUPS.names()) and not names & set(without)
        # each group states its own need, not the default text
        assert all(needs and needs != "a camera that has them" for needs in without.values())
        named = [name for needs in without.values() for name in re.findall(r"effect (\w+)", needs)]
        assert named and all(name in CATALOGUE for name in named)


def test_a_group_is_available_once_the_camera_has_what_it_needs() -> None:
    setup = setup_of(PLAN)
    assert {"specimen", "cats_eye"} <= set(lacking(setup, PLAN)) and "blades" not in lacking(setup, PLAN)
    assert "depths" in lacking(setup_of(small_plan(depths=(2.2,))), small_plan(depths=(2.2,)))
    deep = setup_of(microscope()).with_effect(IndexMismatch(1.38, 20.0))
    assert "specimen" in lacking(setup_of(microscope()), microscope()) and "specimen" not in lacking(deep, microscope())
    lens = PLAN.camera.optics
    assert isinstance(lens, MainLens)
    round_one = replace(PLAN, camera=replace(PLAN.camera, optics=replace(lens, blades=0)))
    assert lacking(setup_of(round_one), round_one)["blades"] == "an iris with blades"
    aside = replace(PLAN, anchor=(20.0, 20.0))
    far = replace(aside, camera=replace(aside.camera, sensor=replace(aside.camera.sensor, shape=(900, 900))))
    assert "cats_eye" not in lacking(setup_of(far).with_effect(MechanicalVignetting()), far)


def test_unavailable_groups_are_refused() -> None:
    what = (
        "expected groups that the camera .* has, got specimen, which needs the effect index_mismatch; choose from geo"
    )
    with pytest.raises(InputError, match=what) as raised:
        fit_camera(measured_of(few_patterns()), unknowns=("geometry", "specimen"))
    assert "cats_eye" not in str(raised.value).partition("choose from")[2]
    with pytest.raises(InputError, match=what):
        next_positions(PLAN, 6, groups=("geometry", "specimen"))
    check_groups(setup_of(PLAN), PLAN, ("geometry", "depths"))
