"""Effects at their limits: no NaN and no light from nowhere, or one clear line; and nothing where they are off."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lfcal.base.errors import LfcalError
from lfcal.camera import ScanPlan
from lfcal.simulate import plan_effects
from lfcal.simulate.effects import (
    CATALOGUE,
    AngularResponse,
    ArrayTilt,
    ChromaticFocus,
    CoverGlass,
    Distortion,
    Effect,
    FieldAberrations,
    FieldCurvature,
    Ghost,
    LensletDispersion,
    LensletSpherical,
    MissingLenslets,
    SensorNonlinearity,
)
from lfcal.simulate.engines import _geometric as geometric
from lfcal.simulate.engines import _wave as wave
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.simulate import simulate_psf
from lfcal.simulate.staging import scene_for
from tests.simulate.common import BASE, FAST, small_camera, small_plan

EXTREMES: list[Effect] = [
    *(FieldCurvature(r) for r in (1.0, -1.0, 3e3, -3e3, 1e12)),
    *(FieldAberrations(c, a, spherical=w) for c, a, w in ((1e-300, 0.0, 0.0), (-1.0, 0.5, 0.2))),
    *(Distortion(k, r) for k, r in ((0.5, 1.0), (-0.5, 1e9), (0.5, 1e4), (-0.01, 1e4))),
    *(ArrayTilt(a, b) for a, b in ((0.2, 0.2), (-0.2, 0.0), (0.0, -0.002))),
    *(AngularResponse(a) for a in (0.01, 1.57)),
    *(CoverGlass(*g) for g in ((1e6, 4.0, 0.0), (200.0, 4.0, 0.0), (250.0, 1.5, 1.0))),
    *(ChromaticFocus(r, w) for r, w in ((1e9, 0.1), (-2e4, 0.3))),
    *(LensletDispersion(v, w) for v, w in ((5.0, 0.4), (1e15, 0.1))),
    *(LensletSpherical(w) for w in (-4.0, 1e-300)),
    MissingLenslets(((-1_000_000, 1_000_000, 0.0), (0, 0, 1e-300), (1, 0, 1.0))),
]

NOMINAL: dict[str, Effect] = {
    "field_aberrations": FieldAberrations(0.0, 0.0),
    "field_curvature": FieldCurvature(1e15),
    "cover_glass": CoverGlass(0.0),
    "distortion": Distortion(0.0),
    "array_tilt": ArrayTilt(0.0, 0.0),
    "chromatic_focus": ChromaticFocus(0.0),
    "ghost": Ghost(0.0),
    "lenslet_dispersion": LensletDispersion(5.0, 0.0),
    "lenslet_spherical": LensletSpherical(0.0),
    "nonlinearity": SensorNonlinearity(0.0),
    "missing_lenslets": MissingLenslets(((0, 0, 1.0),)),
}
"""Effects of no size: the scene stays as it is, and so does the work."""


@cache
def plan_at(v: float, side: bool) -> ScanPlan:
    if not side:
        return small_plan(v, cutout=31)
    return small_plan(v, small_camera(160, 8000), anchor=(70.0, 7900.0), cutout=31)


@pytest.mark.few(5)
@pytest.mark.parametrize(
    "side", [pytest.param(False, id="axis", marks=pytest.mark.long), pytest.param(True, id="edge")]
)
@pytest.mark.parametrize("effect", EXTREMES, ids=repr)
def test_extremes_are_computed_or_refused(effect: Effect, side: bool) -> None:
    for v in (0.0, 4.0, -3.0):
        plan = plan_at(v, side)
        for base in ((), BASE):
            try:
                response = PlaneResponse(plan, 0, (*base, effect), sampling=FAST)
                found = response.rows([0], [3])
            except LfcalError as error:
                assert "\n" not in str(error) and len(str(error)) < 480
                continue
            assert np.isfinite(found).all() and found.min() >= -1e-6
            assert found.sum(dtype=np.float64) <= 1.005


@pytest.mark.few(2)
@pytest.mark.parametrize("name", sorted(NOMINAL))
def test_an_effect_that_is_not_called_for_costs_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not planned, not asked; and of no size, the engines do the same work, call by call, on the same scene."""
    effect, plan = NOMINAL[name], small_plan(cutout=31)
    assert not plan_effects(plan).row(name).on
    counted: list[str] = []
    for module, function in ((wave, "build_tables"), (wave, "respond"), (geometric, "draw_spots")):
        plain = getattr(module, function)
        monkeypatch.setattr(module, function, lambda *a, _f=plain, _n=function: counted.append(_n) or _f(*a))
    calls = []
    for effects in ((), BASE, (effect,), (*BASE, effect)):
        counted.clear()
        PlaneResponse(plan, 0, effects, sampling=FAST).rows([2], [3, 4])
        calls.append(list(counted))
    assert calls[:2] == calls[2:] and all(calls)
    assert scene_for(plan, 0, (*BASE, effect)) == scene_for(plan, 0, BASE)
    planned = plan_effects(plan, 0.2)  # a plan asks what each effect would cost
    methods = ("on_scene", "spread", "kernel", "on_frame")
    for method in (m for m in methods if hasattr(CATALOGUE.get(name), m)):
        monkeypatch.setattr(type(effect), method, lambda *_: pytest.fail("an effect that is off was asked"))
    simulate_psf(plan, planned, sampling=FAST)


@pytest.mark.parametrize("name", [*sorted(NOMINAL), "angular_response"])
def test_it_is_off_unless_called_for_and_then_given_or_asked(name: str) -> None:
    plan = small_plan(cutout=31)
    for frames in (False, True):
        assert not plan_effects(plan, 1e-4, frames=frames).row(name).on
    wanted = plan_effects(plan, overrides={name: "on"}, frames=True).row(name)
    assert wanted.on and wanted.effect == CATALOGUE.get(name)()
