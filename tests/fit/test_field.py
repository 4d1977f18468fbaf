"""One camera from several regions of the field: what changes from place to place, and how sure that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.fit import Measured, fit_camera
from lfcal.fit._summary import summarised
from lfcal.fit.field import FieldFit, Regional, _changes, _Laid, fit_field, regional_of
from lfcal.fit.fit import problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Local
from lfcal.fit.parameters import ScanScales, Vector, field_of
from lfcal.fit.setup import RegionPlace, Setup, described_effects, starting_effects
from lfcal.simulate.effects import FieldAberrations, FieldCurvature, Zernike
from tests.fit.common import measured, some_index
from tests.fit.field_common import ANCHORS, LAW, ON_AXIS, camera, plan_at, recorded, true_setup, unlike

PLACES = (RegionPlace(), RegionPlace(0.2, -0.1), RegionPlace(-0.1, 0.15))
WAVES = ("geometry", "focal_lengths", "iris", "wavefront")
THREE = ("centre", "edge", "corner")
FRAME = ScanScales.over([plan_at(name) for name in THREE])


def few(count: int = 4) -> Regional:
    return regional_of(of_three(true_setup(PLACES), 0, count, cutout=15))


def of_three(true: Setup, seed: int, count: int = 16, **how: object) -> dict[str, Measured]:
    """Return noisy patterns of three regions."""
    rng = np.random.default_rng(seed)
    return {name: recorded(true, name, count, rng, **how) for name in THREE}


def described(planes: int = 2) -> Setup:
    return Setup(camera(), described_effects(camera()), (0.0,) * planes)


def test_predictions_are_those_of_each_region_alone() -> None:
    measured = few()
    problem = problem_of(measured, described(), ("geometry", "field_wavefront", "region_places"), 1)
    names = [one.name for one in problem.vector.unknowns]
    u = np.zeros(len(names))
    for name, value in {"field_coma": 2.0, "region_1_y_px": 1.0, "region_2_x_px": -0.5}.items():
        u[names.index(name)] = value
    offsets = np.random.default_rng(1).normal(0, 0.1, (len(measured), 2))
    found = problem.model(u, offsets, Fineness.coarse).reshape(-1, 15, 15)
    setup = problem.vector.setup_at(u)
    places = [(0.0, 0.0), (0.2, 0.0), (0.0, -0.1)]
    for k, name in enumerate(THREE):
        own = measured.region == k
        alone = replace(setup, regions=())
        moved = offsets[own] + places[k]
        wanted = predict(alone, plan_at(name, 15), measured.index[own], moved, Fineness.coarse)
        np.testing.assert_allclose(found[own], wanted, atol=1e-6 * wanted.max())
    # light and background are each region's and plane's own
    light = np.array([100.0, 200.0, 400.0])[measured.region, None, None] * found
    own = replace(measured, patterns=light.astype(np.float32) + 3)
    point = problem_of(own, setup, ("geometry",), 1).point(np.zeros(4), Local(offsets), Fineness.coarse)
    np.testing.assert_allclose(point.levels.gains, np.repeat([100.0, 200.0, 400.0], 2), rtol=1e-3)
    np.testing.assert_allclose(point.levels.backgrounds, 3, atol=0.01)


def test_unknowns_over_the_field_are_effects_of_the_simulator() -> None:
    vector = Vector(described(), FRAME, ("field_wavefront", "field_curvature", "region_places", "region_depths"))
    assert vector.setup_at(np.zeros(len(vector))).effects == described().effects
    changes = {"field_coma": 0.2, "field_astigmatism_x": -0.1, "field_sag_um": 5.0, "region_2_farther_um": 30.0}
    setup = vector.setup_at(vector.at(changes))
    far = max(np.hypot(*at) for at in FRAME.fields_um)
    assert setup.effect(FieldAberrations) == FieldAberrations(0.2, 0.0, 0.0, -0.1, 0.0, far)
    curved = setup.effect(FieldCurvature)
    assert curved is not None and far**2 / (2 * curved.radius_um) == pytest.approx(5.0)
    assert setup.of_region(2).depth_errors_um == (30.0, 30.0) and setup.of_region(0).depth_errors_um == (0.0, 0.0)
    # a setup that has them already starts there
    again = Vector(setup, FRAME, ("field_wavefront", "field_curvature"))
    assert again.setup_at(np.zeros(len(again))).effect(FieldAberrations) == setup.effect(FieldAberrations)
    # one region, or two, do not tell all of it
    one, two = (ScanScales.of(plan_at("edge")), ScanScales.over([plan_at("centre"), plan_at("edge")]))
    assert len(Vector(described(), one, ("field_wavefront", "region_places"))) == 0
    names = [u.name for u in Vector(described(), two, ("field_wavefront",)).unknowns]
    assert names == ["field_coma", "field_astigmatism", "field_spherical"]


def test_parts_of_a_tilted_target_have_their_own_depths() -> None:
    assert len(Vector(described(), FRAME, ("plane_tilt",))) == 0
    parts = replace(described(), regions=tuple(RegionPlace(farther_um=d) for d in (0.0, 10.0, 20.0)))
    vector = Vector(parts, FRAME, ("plane_tilt", "region_places"))
    setup = vector.setup_at(vector.at({"plane_tilt_x_um": 100.0, "region_1_y_px": 0.5}))
    far = max(np.hypot(*at) for at in FRAME.fields_um)
    for k, (x, _) in enumerate(FRAME.fields_um):
        wanted = 10.0 * k + 100.0 * (x - FRAME.middle_um[0]) / far
        assert setup.of_region(k).depth_errors_um == pytest.approx((wanted, wanted))
    assert setup.regions[1].rows_px == pytest.approx(0.5)


def test_rotation_and_pitch_are_estimated_from_all_regions() -> None:
    """A turn of a milliradian and a growth of 2e-4 displace it by pixels over the field."""
    turn, grow, places = 1e-3, 2e-4, np.array(FRAME.fields_um)
    aside = [np.array([1.0 - turn * y + grow * x, -2.0 + turn * x + grow * y]) for x, y in places]
    seen = [_Laid(at, by, turn + 2e-4) for at, by in zip(places, aside, strict=True)]
    first = _changes(seen[:1], places[1], described())
    assert abs(first["offset_y_um"] - aside[1][1]) < 0.4 * abs(aside[1][1] - aside[0][1])
    every = _changes(seen, np.array([300.0, -4000.0]), described())
    # each region by itself tells the turn by 2e-4 too large; where they lie says otherwise
    assert every["rotation_rad"] == pytest.approx(turn, abs=1e-4)
    assert every["pitch_um"] == pytest.approx(grow * camera().lattice.pitch_um, rel=0.1)
    wanted = (1.0 + turn * 4000 + grow * 300, -2.0 + turn * 300 - grow * 4000)
    assert (every["offset_x_um"], every["offset_y_um"]) == pytest.approx(wanted, abs=0.5)


def test_regions_that_do_not_belong_together_are_refused() -> None:
    rng = np.random.default_rng(0)
    own = recorded(true_setup(), "edge", 3, rng, cutout=15)
    smaller, deeper = (
        recorded(true_setup(), "far", 3, rng, **how) for how in ({"cutout": 17}, {"cutout": 15, "depths": (2.2, 2.8)})
    )
    for regions, what in (
        ({"edge": own}, "at least two"),
        ({"a": own, "b": own}, r"region 'b': expected a distance of at least 30 px from region 'a', got 0 px"),
        ({"edge": own, "far": smaller}, "region 'far', pixels of a pattern"),
        ({"edge": own, "far": deeper}, "region 'far', depths"),
    ):
        with pytest.raises(InputError, match=what):
            regional_of(regions)


@pytest.mark.long
def test_the_wavefront_over_the_field_is_found() -> None:
    """Coma grows with the field and astigmatism with its square, also where no pattern was recorded."""
    true, patterns = true_setup(PLACES), of_three(true_setup(PLACES), 3)
    fit = fit_field(patterns, unknowns=(*WAVES, "field_wavefront"), workers=1)
    first = fit.first
    assert first.complete and not first.outliers, first.verdict
    by = np.hypot(*FRAME.fields_um[2]) / LAW.radius_um
    wanted = {
        "field_coma": LAW.coma * by,
        "field_astigmatism": LAW.astigmatism * by**2,
        "field_astigmatism_y": LAW.astigmatism_y * by,
        "field_astigmatism_x": LAW.astigmatism_x * by,
        "field_spherical": 0.0,
        "zernike_4_0": 0.15,
        "zernike_3_1": 0.05,
        "zernike_2_2": -0.08,
        "region_1_y_px": 0.2,
        "region_2_x_px": 0.15,
        "gap_um": true.camera.lattice.gap_um,
    }
    for name, value in wanted.items():
        own = first.parameters[name]
        assert abs(own.value - value) < 4 * own.sigma, (name, own, value)
        assert own.sigma < 0.05 or own.unit != "waves"
    far = plan_at("far")
    elsewhere = unlike(true_setup(), fit.setup_at(far), far)
    inside = {name: unlike(true.of_region(k), fit.fits[name].setup, plan_at(name)) for k, name in enumerate(THREE)}
    assert max(inside.values()) < 5e-3 and elsewhere < 0.01, (inside, elsewhere)
    # the wavefront at a place is that of the law, within its sigma
    place = field_of(far)
    law = {t[:2]: t[2] for t in LAW.terms_at(place[::-1])}
    axis = {(n, m): w for n, m, w in ON_AXIS.terms}
    for term in fit.wavefront_at(place):
        key = (term.n, term.m)
        assert abs(term.waves - law.get(key, 0.0) - axis.get(key, 0.0)) < 4 * term.sigma < 0.3
    # one wavefront for the whole field is incomplete, and so is a fit of the middle alone, used elsewhere
    naive = fit_field(patterns, unknowns=WAVES, workers=1)
    assert not naive.first.complete and unlike(true_setup(), naive.setup_at(far), far) > 5 * elsewhere
    alone = fit_camera(patterns["centre"], unknowns=WAVES, workers=1)
    assert unlike(true_setup(), replace(alone.setup, stage_scale=0.0), far) > 5 * elsewhere


@pytest.mark.long
def test_only_what_changes_over_the_field_is_fitted() -> None:
    true = true_setup(PLACES)
    without = replace(true, effects=tuple(e for e in true.effects if e != LAW))
    for setup, changes in ((true, True), (without, False)):
        fit: FieldFit = fit_field(of_three(setup, 4), workers=1)
        assert ("field_wavefront" in fit.first.groups) == changes, fit.first.groups
        assert fit.first.complete and "field_curvature" in fit.first.unhelpful


def test_h_of_another_place_is_that_of_its_wavefront() -> None:
    measured = few(3)
    problem = problem_of(measured, described(), ("pitch",), 1)
    assert problem.vector.frame == ScanScales.over(measured.plans)
    point = problem.point(np.zeros(1), Local(np.zeros((len(measured), 2))), Fineness.coarse)
    columns = drain(problem.columns(point, [0], "", displaced=False))
    fits = summarised(problem, point, columns, groups=("pitch",), tried=(), outliers=())
    fit = FieldFit(dict(zip(THREE, fits, strict=True)))
    assert [len(own.residuals) for own in fits] == [3, 3, 3] and fits[2].planned == plan_at("corner", 15)
    law = replace(fit.first.setup, effects=(*fit.effects, LAW), aside_px=(0.3, 0.0))
    whole = FieldFit({name: replace(own, setup=law) for name, own in fit.fits.items()})
    plan = replace(plan_at("far", 15), period=(2, 3))
    at = whole.fit_at(plan)
    H = at.model(workers=1)
    alone = replace(law, aside_px=(0.0, 0.0))
    wanted = predict(alone, plan, np.array([[1, 1, 2]]), np.zeros((1, 2)), Fineness.finest)[0]
    np.testing.assert_allclose(H[1, 1, 2], at.levels.gains[1] * wanted, atol=1e-4 * float(np.max(H[1, 1, 2])))
    assert H.anchor == ANCHORS["far"] and H.period == (2, 3)


def microscope_plan(name: str, cutout: int = 15) -> ScanPlan:
    found = preset("lfm_20x05")
    found = replace(found, sensor=replace(found.sensor, shape=(2000, 2400)))
    return ScanPlan.for_camera(found, depths_um=(-6.0, 9.0), cutout=cutout, anchor=ANCHORS[name])


def test_an_objective_has_the_symmetric_part_of_the_law() -> None:
    """It is simulated with what is symmetric about a source's chief ray; the rest of the law is refused there."""
    plan, edge = microscope_plan("centre"), microscope_plan("edge")
    start = Setup(plan.camera, starting_effects(plan), (0.0, 0.0))
    frame = ScanScales.over([microscope_plan(name) for name in THREE])
    vector = Vector(start, frame, ("field_wavefront", "field_curvature"))
    assert [one.name for one in vector.unknowns] == ["field_spherical", "field_sag_um"]
    setup = vector.setup_at(vector.at({"field_spherical": 0.2, "field_sag_um": 400.0}))
    at = np.array([[0, 3, 5]])
    plain, changed = (predict(one, edge, at, np.zeros((1, 2)), Fineness.coarse) for one in (start, setup))
    assert np.linalg.norm(changed - plain) > 0.05 * np.linalg.norm(plain)


@pytest.mark.long
def test_the_field_of_a_microscope_is_found() -> None:
    """Spherical aberration and the image's distance grow with the square of the field, also where no one scanned."""
    law, plan = FieldAberrations(0.0, 0.0, spherical=0.3, radius_um=12000.0), microscope_plan("centre")
    lattice = replace(plan.camera.lattice, gap_um=1.01 * plan.camera.lattice.gap_um, rotation_rad=5e-4)
    effects = (*starting_effects(plan), Zernike(((4, 0, 0.05),)), law, FieldCurvature(12000.0**2 / 800))
    true = Setup(replace(plan.camera, lattice=lattice), effects, (0.0, 0.0))
    rng, patterns = np.random.default_rng(0), {}
    for name in THREE:
        own = microscope_plan(name)
        index = some_index(own, 6)
        light = predict(true, own, index, np.zeros((6, 2)), Fineness.finest)
        clean = 16e3 * np.maximum(light, 0) / light.max()
        patterns[name] = measured(own, rng.poisson(clean) + rng.standard_normal(clean.shape), index, (1.0, 1.0))
    names = ("geometry", "wavefront", "field_wavefront", "field_curvature")
    fit = fit_field(patterns, unknowns=names, workers=1)
    radius = max(np.hypot(*at) for at in ScanScales.over([microscope_plan(name) for name in THREE]).fields_um)
    by = (radius / 12000.0) ** 2
    wanted = {"field_spherical": 0.3 * by, "field_sag_um": 400.0 * by, "zernike_4_0": 0.05, "gap_um": lattice.gap_um}
    for name, value in wanted.items():
        found = fit.first.parameters[name]
        assert abs(found.value - value) < 4 * found.sigma, (name, found, value)
    far = microscope_plan("far")
    naive = fit_field(patterns, unknowns=names[:2], workers=1)
    off, one = (unlike(true, which.setup_at(far), far) for which in (fit, naive))
    assert fit.first.complete and off < 0.01 and one > 5 * off and not naive.first.complete
