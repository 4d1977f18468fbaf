"""Waves through single lenslets against brute force in the native, pupil and sensor planes; levels and their errors."""

from __future__ import annotations

import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.camera import Camera, Draft, Microscope, NoLatticeError, PupilLenslets, ScanPlan, Sensor, preset
from lfcal.simulate import (
    PlaneResponse,
    Sampling,
    SimulatedCamera,
    iter_assumed_effects,
    iter_expected_light,
    plan_effects,
    predict_bytes,
    predict_seconds,
    simulate_psf,
)
from lfcal.simulate.effects import Bandwidth, Crosstalk, FiniteSource, Quantisation, catalogue, find_effects
from lfcal.simulate.sensor.session import _write_png
from tests.simulate.common import long
from tests.simulate.fourier_oracle import light_on_sensor

CENTRES = ((-310.0, 20.0), (250.0, -260.0), (180.0, 330.0))
OPTICS = (20.0, 0.4, 1.0, 0.55)


def _camera(gap=1e4, focal=(1e4,), aperture="round"):
    lenslets = PupilLenslets(CENTRES, 30e3, gap, focal, 400.0, aperture)
    return Camera("small", Microscope(*OPTICS[:3]), lenslets, Sensor((281, 281), 5.5, 12, 20e3, 5.0), OPTICS[3])


def _plan(camera, z, cutout=161):
    return ScanPlan.for_camera(camera, depths_um=(z,), cutout=cutout)


def _pattern(camera, z, level="reference", **how):
    return PlaneResponse(_plan(camera, z), 0, (), level=level, **how).rows([0], [0])[0, 0].astype(float)


def _apart(one, other):
    return np.abs(one - other).sum() / other.sum()


@pytest.mark.long
@pytest.mark.parametrize(
    ("z", "gap", "focal", "aperture"),
    [(40.0, 1e4, (1e4,), "round"), long(-60.0, 9.8e3, (1e4, 1.1e4, 0.9e4), "square"), long(0.0, 1e4, (1e4,), "square")],
)
def test_the_pattern_is_that_of_brute_force(z, gap, focal, aperture):
    lenslets = {"centres": CENTRES, "focal": focal if len(focal) == 3 else focal * 3, "gap": gap, "width": 400.0}
    pixels = {"pixel": 5.5, "pixels": 161, "pad": 49, "square": aperture == "square"}
    truth = light_on_sensor(z, optics=OPTICS, fourier=30e3, **lenslets, **pixels)
    found = _pattern(_camera(gap, focal, aperture), z)
    assert _apart(found, truth) < 0.007
    # a mirrored, turned or reversed pattern is far off: three lenslets at unlike places
    assert _apart(found[::-1], truth) > 1
    assert _apart(found.T, truth) > 1
    assert _apart(_pattern(_camera(gap, focal, aperture), -z if z else 30.0), truth) > 0.2


@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.01])
@pytest.mark.parametrize("z", [0.0, 35.0])
def test_the_error_reported_bounds_the_true_one(z, tolerance):
    camera = _camera()
    response = PlaneResponse(_plan(camera, z), 0, (), tolerance=tolerance)
    found = response.rows([0], [0])[0, 0].astype(float)
    assert response.level == "wave"
    assert response.reached <= tolerance
    assert _apart(found, _pattern(camera, z)) < 1.2 * response.reached


def test_the_light_is_the_share_of_the_pupil_that_the_lenslets_cover():
    # in the focal plane of a low NA the pupil is evenly lit: the areas of the discs decide
    camera = replace(_camera(), optics=Microscope(20.0, 0.4, 1.5))
    assert _pattern(camera, 0.0).sum() == pytest.approx(3 * 200**2 / 600**2, rel=0.02)


def test_single_precision_is_enough_and_a_pattern_elsewhere_is_the_same_moved():
    camera = _camera()
    one, two = (
        _pattern(camera, 40.0, sampling=Sampling(nodes_per_px=3, double=double), tolerance=0.01)
        for double in (False, True)
    )
    assert _apart(one, two) < 2e-6
    response = PlaneResponse(_plan(camera, 20.0, 121), 0, (), tolerance=0.02)
    ((row, column, moved),) = response.point(7.0, -4.0)
    assert (row, column) == (7, -4)
    # fields of different lenslets interfere in another phase: 1e-3 of the light
    assert _apart(moved, response.rows([0], [0])[0, 0]) < 5e-3


def test_levels_and_effects_that_do_not_apply_are_refused_by_name():
    plan = _plan(_camera(), 10.0)
    with pytest.raises(InputError, match=r"auto, wave or reference .* got 'grid'"):
        simulate_psf(plan, (), level="grid")
    kinds = find_effects()
    with pytest.raises(NoLatticeError, match="effect lenslet_gap"):
        simulate_psf(plan, (kinds.get("lenslet_gap")(),))
    with pytest.raises(NoLatticeError, match="effect coma"):
        plan_effects(plan, overrides={"coma": "on"})


def test_every_effect_that_applies_can_be_planned_and_simulated():
    camera = replace(_camera(), bandwidth_um=0.05)
    plan = _plan(camera, 30.0)
    given = (Bandwidth(0.05), FiniteSource(1.0), Crosstalk(0.01))
    chosen = plan_effects(plan, effects=given, overrides={e.name: "on" for e in given}, frames=True)
    names = {row.name for row in chosen.rows}
    assert names == {e.name for e in catalogue() if e.applies_to(camera)}
    assert {"finite_source", "bandwidth", "crosstalk"} <= {e.name for e in chosen.effects}
    H = simulate_psf(plan, chosen)
    plain = simulate_psf(plan, ())
    assert H.plane(0).sum() == pytest.approx(plain.plane(0).sum(), rel=0.02)
    assert H.plane(0).max() < plain.plane(0).max()


def test_estimates_of_source_and_bandwidth_are_right_within_a_factor_of_two():
    camera = replace(_camera(), bandwidth_um=0.1)
    plan = _plan(camera, 40.0)
    plain = simulate_psf(plan, (), tolerance=0.005).plane(0)[0, 0].astype(float)
    for effect in (FiniteSource(1.2), Bandwidth(0.1)):
        estimate = plan_effects(plan, effects=(effect,)).row(effect.name).estimate.error
        truth = _apart(plain, simulate_psf(plan, (effect,), tolerance=0.005).plane(0)[0, 0].astype(float))
        assert truth / 2 < estimate < 2 * truth, effect


def test_noise_time_and_memory_are_forecast():
    plan = _plan(_camera(), 30.0)
    light = drain(iter_expected_light(plan))
    pattern = simulate_psf(plan, (), tolerance=0.02).plane(0)[0, 0]
    assert light.brightest[0] == pytest.approx(float(pattern.max()), rel=0.05)
    assert light.noise(plan, 0.8)[0] < light.noise(plan, 0.2)[0]
    assert 0 < predict_seconds(plan, ()) < 20 and 2**18 < predict_bytes(plan, ()) < 2**30
    assumed = Draft("FourierMicroscope", {}).camera("assumed")
    assert assumed.marks.paths("assumed"), "assumed values are not estimated by rays"
    assert drain(iter_assumed_effects(ScanPlan.for_camera(assumed, depths_um=(0.0,)))) == ()


def test_frames_hold_the_pattern_and_white_frames_a_disc_behind_each_lenslet():
    camera = _camera()
    plan = _plan(camera, 20.0)
    source = SimulatedCamera(plan, (Quantisation(),))
    frame = source.read(0).astype(float) - camera.sensor.black_level
    pattern = simulate_psf(plan, ()).plane(0)[0, 0]
    part = frame[60:221, 60:221]
    assert np.corrcoef(part.ravel(), pattern.ravel())[0, 1] > 0.999
    white = source.white_frame()
    for x, y in CENTRES:
        row, column = (round(v) for v in camera.pixels((x, y)))
        assert white[row, column] == white.max()
    assert white[3, 3] == 0


def test_a_frame_of_megapixels_is_stored_in_a_few_times_the_least_time(tmp_path):
    """Most of a frame of such a microscope is dark: the highest compression takes 50 times the least time."""
    frame = np.random.default_rng(0).normal(100, 2, (1024, 1024)).astype(np.uint16)

    def seconds(store):
        start = time.process_time()
        store()
        return time.process_time() - start

    runs = (lambda: _write_png(tmp_path / "a.png", frame), lambda: cv2.imencode(".png", frame))
    stored, least = (min(one) for one in zip(*([seconds(run) for run in runs] for _ in range(3)), strict=True))
    assert stored < 15 * least
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED), frame)


def test_the_preset_passes_the_light_of_its_lenslets():
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=(-30.0, 30.0))
    H = simulate_psf(plan, (), tolerance=0.03)
    assert H.shape == (2, 1, 1, *plan.cutout)
    assert H.plane(0).sum() == pytest.approx(7 / 9, rel=0.03)
