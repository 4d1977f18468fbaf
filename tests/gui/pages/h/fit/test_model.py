"""The fit without its widgets: choices, what an H offers, what is shown of a fit, what it changes."""

from __future__ import annotations

import json
import math
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.camera import ScanPlan, preset
from lfcal.fit import GROUPS, ScanScales
from lfcal.psf import Facts, PSFMatrix
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate.effects import Crosstalk, Zernike
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.h.model_fit import FitSettings, group_rows, offer_of, stamp_of, use_of
from lfcal_gui.pages.h.model_fit_run import (
    FitRun,
    FoundFit,
    asked_of,
    detail_of,
    findings_of,
    iter_fit,
    merit_of,
    parameter_rows,
    place_words,
    verdict_of,
)
from lfcal_gui.pages.simulate.model import SimulateSettings
from tests.fit.common import few_patterns
from tests.gui.pages.h.fit.common import GEOMETRY, project_of, saved


@pytest.fixture
def found(known: FitRun) -> FoundFit:
    assert known.found is not None
    return known.found


@pytest.fixture
def found_outlier(known_outlier: FitRun) -> FoundFit:
    assert known_outlier.found is not None
    return known_outlier.found


def test_choices_come_back_from_project_files_of_all_versions() -> None:
    groups = ("geometry", "not_installed")
    settings = FitSettings("window", False, groups, 0, (64.0, 1.0), ("crosstalk=0.01", "more.json"), True)
    state = ProjectState()
    text = replace(state, settings=settings.into(state)).to_json()
    assert FitSettings.of(ProjectState.from_json(text)) == settings
    # what is not installed is kept, and not asked for
    assert settings.unknowns == ("geometry",) and settings.noise == (64.0, 1.0)
    assert FitSettings().auto and FitSettings().noise is None
    earlier = {"camera": "psf", "positions": 40, "auto": False, "groups": ["iris"], "constant": 64.0, "slope": 1}
    assert FitSettings.read(earlier) == (FitSettings(auto=False, groups=("iris",), positions=40, noise=(64, 1)), ())
    kept, refused = FitSettings.read({**earlier, "slope": None, "effects": ["coma=0.1"]})
    assert kept == FitSettings(auto=False, groups=("iris",), positions=40, effects=("coma=0.1",))
    assert len(refused) == 1 and refused[0].startswith("settings of fit: noise: Noise: expected CONSTANT,SLOPE")
    assert FitSettings.read({"constant": None, "slope": None}) == (FitSettings(), ())


WRONG: tuple[dict[str, object], ...] = (
    *({"camera": "other"}, {"positions": -1}, {"positions": True}, {"noise": (-1.0, 1.0)}, {"noise": (1.0, math.nan)}),
    *({"noise": (0.0, 0.0)}, {"noise": "64"}, {"effects": (3,)}, {"groups": (3,)}),
)


def test_wrong_choices_are_refused() -> None:
    for wrong in WRONG:
        with pytest.raises(InputError):
            FitSettings(**wrong)  # type: ignore[arg-type]
        assert FitSettings.from_dict(json.loads(json.dumps(wrong))) == FitSettings(), wrong


def test_an_h_without_noise_or_camera_is_refused_in_words_of_the_page(tmp_path: Path) -> None:
    noise = replace(GEOMETRY, noise=(64.0, 1.0))
    other = replace(few_plan(), period=(2, 3))
    no_camera = bare(camera=False)
    for k, (H, settings, plan, words) in enumerate(
        (
            (bare(), GEOMETRY, None, r"^0\.h5: H does not state its noise"),
            (no_camera, noise, None, r"1\.h5: H states no camera: make a plan of its shape .* in Set up"),
            (no_camera, noise, other, r"make a plan of its shape \(1, 2, 4, 15, 15\)"),
        )
    ):
        project = replace(project_of(saved(tmp_path / f"{k}.h5", H), settings), plan=plan)
        with pytest.raises(InputError, match=words) as refused:
            drain(iter_fit(asked_of(project, settings), FitRun()))
        assert "\n" not in str(refused.value) and "--" not in str(refused.value)


def test_every_group_can_be_chosen_and_nothing_to_fit_is_one_line(tmp_path: Path) -> None:
    rows = group_rows()
    assert [name for name, _, _ in rows] == list(GROUPS.names())
    assert {name for name, _, core in rows if core} >= set(FitSettings().groups), "others are of Fourier cameras"
    with pytest.raises(InputError, match="expected an H file"):
        asked_of(ProjectState(), FitSettings())
    gone = project_of(tmp_path / "gone.h5")
    assert stamp_of(gone) is None
    none = FitSettings(auto=False, groups=("not_installed",))
    with pytest.raises(InputError, match="one group or more"):
        asked_of(project_of(saved(tmp_path / "H.h5"), none), none)


# -- what an H offers --------------------------------------------------------------------------------------
def test_an_h_says_what_it_has() -> None:
    offer = offer_of(few_patterns())
    assert (offer.recorded, offer.shape) == (6, (1, 2, 4, 15, 15))
    assert offer.noise == pytest.approx((64.0, 1.0)) and offer.camera == "bench"
    assert offer.source_words("H.h5") == "H.h5: 6 of 8 positions recorded, 1 plane"
    assert offer.use_words(40) == "6 are used, 1 of them held out to test the fit."
    assert offer.use_words(0) == offer.use_words(6) == offer.use_words(None)
    many = replace(offer, recorded=100)
    assert [many.use_words(asked).split()[0] for asked in (None, 0, 30)] == ["40", "100", "30"]
    chosen = replace(many, aside=25)
    assert chosen.use_words(None) == "100 are used, 25 of them held out to test the fit."
    assert offer.noise_words(FitSettings()) == ("Noise as stated in H: variance about 64 + 1 × value.", "hint")
    given = FitSettings(noise=(1.0, 2.0))
    assert offer.noise_words(given) == ("Noise as given here, not as stated in H.", "hint")
    mine = replace(preset("bench"), name="mine")
    assert offer.camera_words(FitSettings("window"), mine, None) == (
        "The fit starts from mine, the camera of this window.",
        "hint",
    )
    small = replace(mine, sensor=replace(mine.sensor, shape=(10, 12)))
    words, role = offer.camera_words(FitSettings("window"), small, None)
    assert role == "error" and words.startswith("H does not match mine, the camera of this window: cutout of position")
    assert offer.lacking(FitSettings("window"), small, None) == {}
    assert offer.lacking(FitSettings("window"), mine, None) == offer.lacking(FitSettings(), small, None)


def test_ht_offers_what_its_h_does() -> None:
    assert offer_of(few_patterns().T) == offer_of(few_patterns())


def bare(noise: np.ndarray | None = None, *, camera: bool = True) -> PSFMatrix:
    H = few_patterns()
    facts = Facts.of(H.shape[:3], H.cutout, recorded=H.recorded, noise=noise)
    owner = H.camera if camera else None
    return PSFMatrix(np.array(H), depths=H.depths, camera=owner, anchor=H.anchor, facts=facts)


def test_an_h_without_noise_or_camera_says_so() -> None:
    offer = offer_of(bare(camera=False))
    words, role = offer.noise_words(FitSettings())
    assert (offer.noise, role) == (None, "error") and "does not state its noise" in words
    camera = preset("bench")
    words, role = offer.camera_words(FitSettings(), camera, None)
    assert role == "error" and "make a plan of its shape (1, 2, 4, 15, 15)" in words
    words, role = offer.camera_words(FitSettings(), camera, few_plan())
    assert role == "hint" and "of the plan" in words
    dark = np.tile([-5.0, 1.0], (*bare().shape[:3], 1))
    words, role = offer_of(bare(dark)).noise_words(FitSettings())
    assert role == "error" and "black level" in words
    assert offer_of(bare(np.full((*bare().shape[:3], 2), np.nan))).noise is None


def few_plan() -> ScanPlan:
    """Return the plan of the tiny H."""
    H = few_patterns()
    assert H.camera is not None
    return ScanPlan(H.camera, H.period, H.cutout, tuple(H.depths), H.anchor)


# -- what is shown -----------------------------------------------------------------------------------------
def test_pictures_belong_together(found: FoundFit) -> None:
    assert found.places == tuple(sorted((int(z), int(y), int(x)) for z, y, x in found.measured.index))
    for place in found.places:
        np.testing.assert_array_equal(found.patterns[place], few_patterns()[place])
        sigma = np.sqrt(64.0 + np.maximum(found.model[place], 0))
        off = (found.patterns[place] - found.model[place]) / sigma
        np.testing.assert_allclose(found.residual[place], off, atol=0.05)
        assert 0.6 < found.chi2[place] < 1.5
    assert found.unit == "counts" and len(found.aside) == 1
    assert {found.fate(place) for place in found.places} == {"fitted", "held out"}


def test_a_pattern_that_was_left_out_is_shown_all_the_same(found_outlier: FoundFit) -> None:
    (place,) = [place for place in found_outlier.places if found_outlier.fate(place) == "left out"]
    assert place == tuple(int(v) for v in np.argwhere(few_patterns().recorded > 0)[2])
    # the model is what would have been measured: the pattern before it was moved
    right = few_patterns()[place]
    sigma = np.sqrt(64.0 + np.maximum(found_outlier.model[place], 0))
    assert np.sqrt(np.mean(((right - found_outlier.model[place]) / sigma) ** 2)) < 1.3
    assert found_outlier.chi2[place] > 10 and found_outlier.worst() == place
    whole, brief = place_words(found_outlier, place)
    assert brief.startswith("left out, χ²") and whole.endswith(brief), "χ² was cut in a narrow header"
    (finding,) = [one for one in findings_of(found_outlier.fit) if one.place is not None]
    assert finding.place == place and "chi²" in finding.text
    assert "1 left out as outliers" in detail_of(found_outlier)


def test_rows_of_parameters_are_what_was_found(found: FoundFit) -> None:
    rows = parameter_rows(found.fit)
    assert [one.name for one in found.fit.parameters.values()][:2] == ["gap_um", "rotation_rad"]
    assert [row.texts[0] for row in rows][:3] == ["gap", "rotation", "offset y"] and len(rows) == len(
        found.fit.parameters
    )
    gap, own = rows[0], found.fit.parameters["gap_um"]
    assert gap.numbers[1:4] == (own.value, own.sigma, own.start) and gap.far
    assert float(gap.texts[5]) == pytest.approx((own.value - own.start) / own.sigma, abs=0.06)
    for row in rows:
        value, sigma, start = row.texts[1:4]
        decimals = [len(text.partition(".")[2]) for text in (value, sigma, start)]
        assert len(set(decimals)) == 1 and len(sigma.replace(".", "").lstrip("0")) == 2
        assert abs(float(value) - row.numbers[1]) <= 0.06 * row.numbers[2]
        assert row.texts[6] == GROUPS.get("geometry").title
    known = replace(found.fit, parameters={"gap_um": replace(own, sigma=0.0)})
    assert parameter_rows(known)[0].texts[5] == "–"


def test_the_verdict_says_how_far_to_trust(found: FoundFit) -> None:
    fit = found.fit
    assert merit_of(fit) == "good"
    assert re.fullmatch(
        r"The model explains the patterns: χ² [\d.]+\. H .* has an error below [\d.]+ %\.", verdict_of(fit)
    )
    assert detail_of(found).startswith("H.h5: 5 patterns fitted, error from 1 held out")
    worse = replace(fit, chi_square=replace(fit.chi_square, lit=3.0, sigma=0.05))
    known = replace(worse, held_out_error=replace(fit.held_out_error, squared=4e-4, squared_sigma=1e-5))
    assert merit_of(known) == "bad"
    assert verdict_of(known).startswith(
        "The model is incomplete: χ² 3.000, 40 σ above 1. H of this camera has an error of 2 % ±"
    )
    assert merit_of(replace(fit, answers={"order of lens types": "1, 0, 2 of the description"})) == "fair"


# -- what it changes ---------------------------------------------------------------------------------------
def test_the_camera_and_its_effects_are_used_everywhere(found: FoundFit) -> None:
    fit = found.fit
    more = fit.setup.with_effect(Crosstalk(0.012)).with_effect(Zernike(((4, 0, 0.1), (3, 1, -0.05))))
    fit = replace(fit, setup=more)
    before = SimulateSettings(
        tolerance=0.02,
        overrides=(("lenslet_gap", "on"), ("read_noise", "off")),
        magnitudes=(("coma", "waves", 0.3, "stated"),),
    )
    state = ProjectState(plan=found.measured.plan)
    state = replace(state, settings=before.into(state))
    use = use_of(state, fit)
    after = replace(state, **use.changes)
    assert after.camera == fit.camera and after.camera.marks["lattice.gap_um"] == "measured"
    assert after.plan is not None and state.plan is not None
    assert after.plan.camera == fit.camera and after.plan.depths_um == state.plan.depths_um
    settings = SimulateSettings.of(after)
    assert settings.tolerance == 0.02
    effects = {effect.name: effect for effect in settings.effects()}
    assert effects["crosstalk"] == Crosstalk(0.012)
    assert effects["zernike"] == Zernike(((4, 0, 0.1), (3, 1, -0.05)))
    # effects on H that the fit does not have would make another H; those on frames stay
    assert {name: one for name, one in settings.overrides if one == "on"}.keys() == {e.name for e in fit.effects}
    assert dict(settings.overrides)["read_noise"] == "off" and "coma" not in effects
    assert use.holds(after) and not use.holds(state)


@pytest.mark.parametrize("name", GROUPS.names())
def test_what_any_group_finds_goes_into_simulate(found: FoundFit, name: str) -> None:
    """Through the project's file: each effect comes out as it was found."""
    group, setup = GROUPS.get(name), found.fit.setup
    frame = ScanScales(found.measured.plan.shape[0], 7.0)
    unknowns = group.unknowns(setup, frame)
    values = {one.name: one.value(one.clipped(0.5)) for one in unknowns}
    fit = replace(found.fit, setup=group.applied(setup, values, frame) if unknowns else setup)
    state = ProjectState(plan=found.measured.plan)
    after = ProjectState.from_json(replace(state, **use_of(state, fit).changes).to_json())
    settings = SimulateSettings.of(after)
    mine = {effect.name: effect for effect in settings.effects()}
    for effect in fit.effects:
        assert dict(settings.overrides)[effect.name] == "on"
        given = any(getattr(effect, f.name) is not None for f in fields(effect))  # type: ignore[arg-type]
        assert mine.get(effect.name) == effect if given else effect.name not in mine
    assert after.camera == fit.camera


def test_simulate_then_computes_the_h_of_the_fit(found: FoundFit) -> None:
    """Against the fit's own H: the same optics by the planner's settings, up to the tolerance."""
    state = ProjectState(plan=found.measured.plan)
    after = replace(state, **use_of(state, found.fit).changes)
    assert after.plan is not None
    settings, plan = SimulateSettings.of(after), after.plan
    effects = plan_effects(plan, 0.01, settings.choices(), effects=settings.effects())
    H = np.asarray(simulate_psf(plan, effects, tolerance=0.01, workers=1))
    model = np.asarray(found.fit.model(workers=1))
    scale = float((H * model).sum() / (H * H).sum())
    assert np.abs(scale * H - model).sum() < 0.015 * model.sum()
    # the described camera differs from it
    before = np.asarray(simulate_psf(state.plan, effects, tolerance=0.01, workers=1))
    scale = float((before * model).sum() / (before * before).sum())
    assert np.abs(scale * before - model).sum() > 0.03 * model.sum()


def test_a_plan_that_does_not_go_with_the_camera_is_dropped(found: FoundFit) -> None:
    camera = replace(found.fit.camera, sensor=replace(found.fit.camera.sensor, shape=(10, 10)))
    fit = replace(found.fit, setup=replace(found.fit.setup, camera=camera))
    use = use_of(ProjectState(plan=found.measured.plan), fit)
    assert use.changes["plan"] is None and "removed" in use.words
    # where there is none, none is made up
    none = use_of(ProjectState(), found.fit)
    assert none.changes["plan"] is None and "plan" not in none.words
