"""H by simulation: in memory, to a file, in units of a plane; cancelled, continued, refused."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.camera import ScanPlan, preset
from lfcal.psf import Stored, open_psf, units_of
from lfcal.simulate import (
    PlaneResponse,
    Sampling,
    iter_simulate_psf,
    outlook_of,
    plan_effects,
    resolve_level,
    scene_for,
    simulate_psf,
)
from lfcal.simulate.accuracy import step_for
from lfcal.simulate.accuracy.cost import efficient_steps
from lfcal.simulate.effects import Bandwidth, Coma, Crosstalk, LensletDiffraction, PositioningError, ReadNoise, Zernike
from lfcal.simulate.engines import engine_for
from lfcal.simulate.simulate import Simulation
from lfcal.work import RunChoice, parts_folder
from tests.psf.test_joining import contents
from tests.simulate.common import BASE, FAST, difference, long, small_camera, small_plan


def corner(plan: ScanPlan, rows: int = 3, columns: int = 4) -> ScanPlan:
    return replace(plan, period=(rows, columns))


def two_planes() -> ScanPlan:
    return corner(ScanPlan.for_camera(small_camera(), virtual_depths=[4.0, 2.5], cutout=41))


def test_h_is_what_the_engine_computes_in_memory_and_in_a_file(tmp_path: Path) -> None:
    plan, effects = two_planes(), (*BASE, Crosstalk(0.01))
    h = simulate_psf(plan, BASE, sampling=FAST)
    assert h.shape == plan.shape and h.camera == plan.camera and h.anchor == plan.anchor
    assert h.depths.tolist() == list(plan.depths_um)
    scene, level = resolve_level(scene_for(plan, 1, BASE))
    assert np.array_equal(h.plane(1), engine_for(scene, level, FAST).rows(range(3), range(4)))
    stored = simulate_psf(plan, effects, sampling=FAST, out=tmp_path / "h.h5", workers=2)
    assert np.array_equal(stored[:], simulate_psf(plan, effects, sampling=FAST, workers=1)[:])
    recorded = open_psf(tmp_path / "h.h5").provenance["simulated"]["effects"]
    assert recorded[0]["name"] == "lens_types" and recorded[-1] == {"name": "crosstalk", "share": 0.01}


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


def test_certificate_is_passed_on_and_frame_effects_do_not_enter_h() -> None:
    response = PlaneResponse(corner(small_plan(cutout=41)), 0, (*BASE, Bandwidth(0.02)), sampling=FAST)
    response.rows([0], [0, 1])
    assert response.certificate.responses >= 2 * response.runs
    assert 0 < response.certificate.energy_out <= 1.02 * response.certificate.energy_in
    plan = corner(small_plan(cutout=31))
    frames = simulate_psf(plan, (ReadNoise(), PositioningError()))
    assert np.array_equal(frames.plane(0), simulate_psf(plan, ()).plane(0))


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
    assert np.array_equal(*untouched), "a wavefront without terms needs nothing"


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


def test_the_coarsest_sampling_within_the_tolerance_is_chosen() -> None:
    outlook = outlook_of(small_plan(), 0)
    steps = efficient_steps(outlook, "wave")
    assert step_for(outlook, "wave", 10.0) == steps[0]
    assert step_for(outlook, "wave", 1e-9) == steps[-1]
    for coarse, fine in itertools.pairwise(steps):
        assert step_for(outlook, "wave", coarse.expected) == coarse
        assert step_for(outlook, "wave", 0.999 * coarse.expected) == fine


def test_bad_input() -> None:
    plan = corner(small_plan(cutout=31))
    for options, match in (
        ({"level": "fast"}, "choose one of these"),
        ({"effects": "none"}, "auto"),
        ({"effects": (1,)}, "objects derived from Effect"),
    ):
        with pytest.raises(InputError, match=match):
            simulate_psf(plan, **options)
    large = ScanPlan.for_camera(preset("r29"), virtual_depths=[2.0, 3.0, 4.0], cutout=401)
    with pytest.raises(InputError, match="out="):
        simulate_psf(large, ())


def test_effects_that_are_on_at_some_planes_name_them() -> None:
    """What H was computed with is known plane by plane."""
    plan = corner(ScanPlan.for_camera(small_camera(), virtual_depths=[6.0, 4.0, 1.2], cutout=31), 1, 1)
    found = Simulation(plan, "auto", "auto", 0.3, None)
    on = [{effect.name for effect in found.budget.at(z)[0]} for z in plan.depths_um]
    stated = found.provenance()["simulated"]
    everywhere, some = set.intersection(*on), set.union(*on) - set.intersection(*on)
    assert everywhere and some
    assert stated["effect_planes"] == {name: [z for z in range(3) if name in on[z]] for name in some}
    assert {effect["name"] for effect in stated["effects"]} == everywhere | some
    assert "effect_planes" not in Simulation(plan, BASE, "auto", 0.3, None).provenance()["simulated"]


@pytest.fixture(scope="module")
def in_units() -> ScanPlan:
    whole = ScanPlan.for_camera(small_camera(), virtual_depths=[2.5, 3.0, 4.0], cutout=31)
    return replace(whole, period=(4, 3))


@pytest.fixture(scope="module")
def direct(in_units: ScanPlan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """H file of one process."""
    path = tmp_path_factory.mktemp("direct") / "H.h5"
    simulate_psf(in_units, tolerance=0.1, out=path, workers=2).close()
    return contents(path)


@pytest.mark.parametrize("executor", ["threads", long("processes")])
def test_units_give_the_file_of_one_process(in_units, direct, tmp_path, executor):
    out = tmp_path / "H.h5"
    run = RunChoice(executor, workers=2)
    drain(iter_simulate_psf(in_units, run=run, tolerance=0.1, out=out)).close()
    assert contents(out) == direct
    assert not parts_folder(out).exists()


@pytest.mark.long
def test_units_of_an_earlier_run_are_kept_or_of_another_tolerance_replaced(in_units, direct, tmp_path):
    out = tmp_path / "H.h5"

    def work(begun: str, tolerance: float = 0.1) -> Any:
        run = RunChoice("threads", 1, begun=begun)
        return iter_simulate_psf(in_units, run=run, tolerance=tolerance, out=out)

    def stopped(tolerance: float) -> None:
        running = work("refuse", tolerance)
        next(record for record in running if record.note.startswith("1 of"))
        running.close()

    stopped(0.1)
    kept = next(parts_folder(out).glob("*.h5"))
    stamp = kept.stat().st_mtime_ns
    with pytest.raises(InputError, match="left 1 of 3 units finished; continue from them"):
        drain(work("refuse"))
    again = work("resume")
    next(again)
    assert kept.stat().st_mtime_ns == stamp
    again.close()
    drain(work("resume")).close()
    assert contents(out) == direct
    stopped(0.2)
    drain(work("resume")).close()
    assert contents(out) == direct


def test_units_are_small_and_distinguish_settings(in_units: ScanPlan, tmp_path: Path) -> None:
    def unit(z: int = 0, tolerance: float = 0.1, level: str = "auto", sampling: Sampling | None = None) -> Any:
        return units_of(Simulation(in_units, "auto", level, tolerance, sampling), Stored())[z]

    first = unit()
    assert len(pickle.dumps(first)) < 10_000
    others = [unit(1), unit(tolerance=0.11), unit(level="grid"), unit(sampling=Sampling(nodes_per_px=6))]
    assert len({first.fingerprint(), *(other.fingerprint() for other in others)}) == 5
    assert unit().fingerprint() == first.fingerprint()

    @dataclass(frozen=True)
    class Own(Crosstalk):
        pass

    with pytest.raises(InputError, match="a known effect"):
        drain(iter_simulate_psf(in_units, [Own()], run=RunChoice("threads", 1), out=tmp_path / "H.h5"))
    assert not list(tmp_path.iterdir())
