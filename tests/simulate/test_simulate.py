"""H by simulation: in memory, to a file, cancelled, refused."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.psf import open_psf
from lfcal.simulate import iter_simulate_psf, plan_effects, simulate_psf
from lfcal.simulate.accuracy.cost import efficient_steps, step_for
from lfcal.simulate.effects import (
    Bandwidth,
    Coma,
    Crosstalk,
    LensletDiffraction,
    PositioningError,
    ReadNoise,
    Zernike,
)
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.simulate import Simulation
from lfcal.simulate.staging import outlook_of, resolve_level, scene_for
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan


def corner(plan: ScanPlan, rows: int = 3, columns: int = 4) -> ScanPlan:
    return replace(plan, period=(rows, columns))


def two_planes() -> ScanPlan:
    return corner(ScanPlan.for_camera(small_camera(), virtual_depths=[4.0, 2.5], cutout=41))


def test_h_is_what_the_engine_says() -> None:
    plan = two_planes()
    h = simulate_psf(plan, BASE, sampling=FAST)
    assert h.shape == plan.shape and h.camera == plan.camera and h.anchor == plan.anchor
    assert h.depths.tolist() == list(plan.depths_um)
    scene, level = resolve_level(scene_for(plan, 1, BASE))
    assert np.array_equal(h.plane(1), engine_for(scene, level, FAST).rows(range(3), range(4)))
    assert h.provenance["simulated"]["effects"][0]["name"] == "lens_types"


def test_streamed_file_equals_memory(tmp_path: Path) -> None:
    plan, path = two_planes(), tmp_path / "h.h5"
    effects = (*BASE, Crosstalk(0.01))
    stored = simulate_psf(plan, effects, sampling=FAST, out=path, workers=2)
    assert stored.shape == plan.shape
    kept = simulate_psf(plan, effects, sampling=FAST, workers=1)
    for z in range(2):
        assert np.array_equal(stored.plane(z), kept.plane(z))
    assert open_psf(path).provenance["simulated"]["effects"][-1] == {"name": "crosstalk", "share": 0.01}


def test_progress_and_cancel_leave_nothing(tmp_path: Path) -> None:
    plan = two_planes()
    work = iter_simulate_psf(plan, BASE, sampling=FAST, out=tmp_path / "h.h5")
    first = next(work)
    assert first.total == 3 and first.done == 0 and "plane 1 of 2" in first.stage
    next(work)
    work.close()
    assert list(tmp_path.iterdir()) == []


def test_light_samples_are_a_weighted_sum() -> None:
    plan = corner(small_plan(cutout=41))
    response = PlaneResponse(plan, 0, (*BASE, Bandwidth(0.08)), sampling=FAST)
    total = np.zeros((3, 4, 41, 41))
    for sample in response.samples:
        one = replace(plan.camera, wavelength_um=sample.wavelength_um)
        total += sample.weight * PlaneResponse(replace(plan, camera=one), 0, BASE, sampling=FAST).rows(
            range(3), range(4)
        )
    assert sum(s.weight for s in response.samples) == pytest.approx(1)
    assert difference(response.rows(range(3), range(4)), total) < 1e-5


def test_mirrored_rows_are_computed_together() -> None:
    camera = small_camera()
    plan = replace(small_plan(camera=camera), cutout=(31, 31), anchor=(70.0, 64.0))
    middle = replace(camera, lattice=replace(camera.lattice, offset_um=tuple(camera.sensor_um([79.0, 80.0]))))
    plan = replace(plan, camera=middle)
    upright = PlaneResponse(plan, 0, (*BASE[:3], BASE[4]), sampling=FAST)
    ys = np.arange(19)
    out = np.zeros((19, 2, 31, 31), np.float32)
    steps = list(upright.accumulate(out, ys, np.array([3, 20]), block=2))
    assert steps[-1] == 19
    each = np.concatenate([upright.rows([y], [3, 20]) for y in ys])
    assert difference(out, each) < 1e-5


def test_certificate_is_passed_on() -> None:
    response = PlaneResponse(corner(small_plan(cutout=41)), 0, (*BASE, Bandwidth(0.02)), sampling=FAST)
    response.rows([0], [0, 1])
    assert response.certificate.responses >= 2 * response.runs
    assert 0 < response.certificate.energy_out <= 1.02 * response.certificate.energy_in


def test_frame_and_motion_effects_do_not_enter_h() -> None:
    plan = corner(small_plan(cutout=31))
    plain = simulate_psf(plan, ())
    assert np.array_equal(simulate_psf(plan, (ReadNoise(), PositioningError())).plane(0), plain.plane(0))


def test_rays_do_not_lose_an_aberration() -> None:
    """Rays know no wavefront: with an aberration the light is followed as waves, or its share is stated as missing."""
    plan, coma = corner(small_plan()), Coma(0.5)
    waves = {"lenslet_diffraction": "off"}
    found = plan_effects(plan, 0.3, waves, effects=(coma,))
    assert found.level == "wave" and found.row("coma").on
    alone, both, none = (
        simulate_psf(plan, effects, tolerance=0.3)[:]
        for effects in ((coma,), (LensletDiffraction(), coma), (LensletDiffraction(),))
    )
    assert np.array_equal(alone, both) and difference(none, alone) > 0.1
    rays = simulate_psf(plan, (coma,), "geometric", tolerance=0.3)
    assert (rays.facts.known()["error"] > 0.99 * found.row("coma").estimate.error).all()
    untouched = (simulate_psf(plan, effects, tolerance=0.3)[:] for effects in ((Zernike(),), ()))
    assert np.array_equal(*untouched), "a wavefront without terms calls for nothing"


def test_effects_may_be_planned_or_given_as_a_plan() -> None:
    plan = corner(small_plan(cutout=31))
    planned = plan_effects(plan, 0.3)
    given = simulate_psf(plan, planned, tolerance=0.3)
    found = simulate_psf(plan, "auto", tolerance=0.3)
    assert np.array_equal(given.plane(0), found.plane(0))


def test_levels() -> None:
    plan = corner(small_plan(cutout=41), 1, 2)
    rays = simulate_psf(plan, BASE, "geometric").plane(0)
    waves = simulate_psf(plan, BASE, "wave").plane(0)
    reference = simulate_psf(plan, BASE, "reference").plane(0)
    assert difference(waves, reference) < 0.03 < 0.2 < difference(rays, reference)
    microscope = preset("lfm_20x05")
    small = replace(microscope, sensor=replace(microscope.sensor, shape=(200, 200)))
    scope = corner(ScanPlan.for_camera(small, depths_um=[10.0], cutout=61), 1, 2)
    found = PlaneResponse(scope, 0, plan_effects(scope).effects)
    assert found.level == "debye" and resolve_level(found.scene, "microscope")[1] == "debye"
    assert simulate_psf(scope, "auto", "microscope").plane(0).sum() > 1.5


@pytest.mark.parametrize("tolerances", [(0.05, 0.015), pytest.param((0.12, 0.05, 0.03, 0.015), marks=pytest.mark.long)])
def test_sampling_keeps_the_tolerance(tolerances: tuple[float, ...]) -> None:
    plan = small_plan()
    outlook = outlook_of(plan, 0)
    scene, _ = resolve_level(scene_for(plan, 0, BASE))
    fine = engine_for(scene, "reference", Sampling(samples_per_px=12)).rows([4], [5])
    for tolerance in tolerances:
        found = PlaneResponse(plan, 0, BASE, tolerance=tolerance)
        assert difference(found.rows([4], [5]), fine) <= tolerance
    steps = efficient_steps(outlook, "wave")
    assert step_for(outlook, "wave", 10.0) == steps[0]
    assert step_for(outlook, "wave", 1e-9) == steps[-1]
    for coarse, fine_one in itertools.pairwise(steps):
        assert step_for(outlook, "wave", coarse.expected) == coarse, "as asked is fine enough"
        assert step_for(outlook, "wave", 0.999 * coarse.expected) == fine_one, "and no finer than that calls for"


def test_bad_input() -> None:
    plan = corner(small_plan(cutout=31))
    for options, match in (
        ({"level": "fast"}, "choose one of these"),
        ({"effects": "none"}, "auto"),
        ({"effects": (1,)}, "objects derived from Effect"),
    ):
        with pytest.raises(InputError, match=match):
            simulate_psf(plan, **options)  # type: ignore[arg-type]
    large = ScanPlan.for_camera(preset("r29"), virtual_depths=[2.0, 3.0, 4.0], cutout=401)
    with pytest.raises(InputError, match="out="):
        simulate_psf(large, ())


def test_effects_that_are_on_at_some_planes_name_them() -> None:
    """What H was made of is known plane by plane."""
    plan = corner(ScanPlan.for_camera(small_camera(), virtual_depths=[6.0, 4.0, 1.2], cutout=31), 1, 1)
    found = Simulation(plan, "auto", "auto", 0.3, None)
    on = [{effect.name for effect in found.budget.at(z)[0]} for z in plan.depths_um]
    told = found.provenance()["simulated"]
    everywhere, some = set.intersection(*on), set.union(*on) - set.intersection(*on)
    assert everywhere and some
    assert told["effect_planes"] == {name: [z for z in range(3) if name in on[z]] for name in some}
    assert {effect["name"] for effect in told["effects"]} == everywhere | some
    assert "effect_planes" not in Simulation(plan, BASE, "auto", 0.3, None).provenance()["simulated"]
