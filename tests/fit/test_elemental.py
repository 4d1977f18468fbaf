"""Fourier light-field microscopes: lenslets, axis, focal lengths and tilt from a z stack of a point."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache

import numpy as np
import pytest
from scipy.ndimage import fourier_shift

from lfcal.base import InputError
from lfcal.camera import Camera, Microscope, PupilLenslets, ScanPlan, Sensor
from lfcal.fit import Fit, Measured, Setup, fit_camera, fit_field
from lfcal.fit._elemental import elemental_of
from lfcal.fit.model import Fineness, predict
from lfcal.simulate import PlaneResponse, simulate_psf
from lfcal.simulate.effects import Crosstalk, FiniteSource
from tests.simulate.fourier_oracle import light_on_sensor

CENTRES = np.array([(-470.0, 20.0), (250.0, -290.0), (200.0, 350.0), (0.0, 10.0)])
FOURIER, GAP, FOCAL, NA, PIXEL, SIDE = 30e3, 1e4, 1e4, 0.4, 5.5, 251
DEPTHS = (-40.0, -20.0, 0.0, 20.0, 40.0)
TILT = np.radians((0.6, -0.8))
ASKED = ("lens_centres", "optical_axis", "fourier_lens", "lenslet_gap", "travel_tilt", "focal_lengths", "iris")
TRUE = {f"lenslet_{k}_{axis}_um": c for k, one in enumerate(CENTRES) for axis, c in zip("xy", one, strict=True)} | {
    "axis_x_um": 0.0,
    "axis_y_um": 0.0,
    "fourier_um": FOURIER,
    "gap_um": GAP,
    "focal_um": FOCAL,
    "numerical_aperture": NA,
    "travel_rows_rad": TILT[0],
    "travel_columns_rad": TILT[1],
}


def camera_of(centres=CENTRES, fourier=FOURIER, gap=GAP, focal=FOCAL, na=NA) -> Camera:
    lenslets = PupilLenslets(tuple(map(tuple, np.asarray(centres).tolist())), fourier, gap, (focal,), 400.0)
    return Camera("small", Microscope(20.0, na, 1.0), lenslets, Sensor((281, 281), PIXEL, 12, 20e3, 5.0), 0.55)


def described(seed: int) -> Camera:
    """Return a description that is wrong everywhere: turned by 1°, centres off by pixels, 1 to 5 % in the rest."""
    turn, rng = np.radians(1.0), np.random.default_rng(seed)
    turned = CENTRES @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return camera_of(turned + rng.normal(0, 8, CENTRES.shape), FOURIER * 1.02, GAP * 0.99, FOCAL * 1.02, NA * 1.05)


def measured(camera: Camera, light: np.ndarray, seed=0, peak=12e3, depths=DEPTHS, held=1, valid=None) -> Measured:
    n, rng = len(light), np.random.default_rng(seed)
    clean = peak * light / light.max()
    data = rng.poisson(clean) + 5.0 * rng.standard_normal(clean.shape)
    plan = ScanPlan.for_camera(camera, depths_um=depths, cutout=light.shape[1])
    index = np.stack([np.arange(n), np.zeros(n, int), np.zeros(n, int)], axis=1)
    good = np.ones(data.shape, bool) if valid is None else valid
    noise = np.tile([25.0, 1.0], (n, 1))
    return Measured(plan, index, data.astype(np.float32), noise, np.zeros((n, 2)), good, np.isin(np.arange(n), [held]))


@cache
def brute_force() -> np.ndarray:
    """Return the light of the true camera, simulated by code that shares nothing with lfcal."""
    found = []
    for z in DEPTHS:
        down, right = np.tan(TILT) * z * 20.0 * GAP / FOURIER
        how = {"centres": CENTRES.tolist(), "focal": (FOCAL,) * 4, "gap": GAP, "width": 400.0, "pad": 99}
        how |= {"pixel": PIXEL, "pixels": SIDE, "aside": (right, down)}
        found.append(light_on_sensor(z, optics=(20.0, NA, 1.0, 0.55), fourier=FOURIER, **how))
    return np.stack(found)


@cache
def simulated(lenslets: int = 4) -> np.ndarray:
    """Return the light of the true camera, or of its first lenslets, without tilt, by the simulator."""
    plan = ScanPlan.for_camera(camera_of(CENTRES[:lenslets]), depths_um=DEPTHS, cutout=SIDE)
    H = simulate_psf(plan, (), tolerance=0.005)
    return np.stack([H.plane(z)[0, 0] for z in range(len(DEPTHS))]).astype(float)


def pulls(fit: Fit, true=TRUE) -> dict[str, float]:
    return {name: (one.value - true[name]) / one.sigma for name, one in fit.parameters.items()}


@pytest.mark.long
def test_every_parameter_is_recovered_from_brute_force_within_its_error() -> None:
    found = [pulls(fit_camera(measured(described(seed), brute_force(), seed), unknowns=ASKED)) for seed in range(4)]
    every = np.array([list(one.values()) for one in found])
    assert np.abs(every).max() < 4.5
    assert 0.5 < np.sqrt(np.square(every).mean()) < 1.5


def test_displaced_lenslets_and_a_tilted_travel_are_found() -> None:
    centres = np.array(described(0).lattice.lens_centres_um[:2])
    off = np.tan(TILT) * 40.0 * 20.0 * GAP / FOURIER / PIXEL
    # the travel moves the whole pattern, by part of a pixel
    moved = [
        np.abs(np.fft.ifft2(fourier_shift(np.fft.fft2(light), share * off)))
        for light, share in zip(simulated(2)[::2], (-1, 0, 1), strict=True)
    ]
    given = measured(camera_of(centres), np.stack(moved), peak=4e3, depths=DEPTHS[::2], held=[])
    fit = fit_camera(given, unknowns=["lens_centres", "travel_tilt"])
    far = pulls(fit)
    assert max(map(abs, far.values())) < 4.5, far
    assert fit.parameters["travel_rows_rad"].sigma < 5e-3 and fit.parameters["lenslet_1_x_um"].sigma < 1.0
    assert len(fit.residuals) == 3 and fit.residual(1, 0, 0).shape == (SIDE, SIDE)


@pytest.mark.long
def test_a_wrong_description_is_corrected() -> None:
    fit = fit_camera(measured(described(0), simulated(), peak=4e3), unknowns=ASKED)
    off = pulls(fit, {**TRUE, "travel_rows_rad": 0.0, "travel_columns_rad": 0.0})
    assert max(map(abs, off.values())) < 4.5, off
    assert fit.complete and fit.held_out_error.limit < 0.1
    # the errors are much smaller than those of the description
    sigma = {name: one.sigma for name, one in fit.parameters.items()}
    assert sigma["fourier_um"] < 1e-3 * FOURIER and sigma["focal_um"] < 5e-3 * FOCAL
    assert sigma["numerical_aperture"] < 0.01 * NA and sigma["lenslet_3_x_um"] < 0.2
    assert any("objective" in words for words in fit.held)
    # H of the fitted camera is without noise, and as measured
    own, wanted = np.asarray(fit.model()[2, 0, 0], float), simulated()[2]
    assert np.abs(own / own.sum() - wanted / wanted.sum()).sum() < 0.03


def test_elemental_images_have_the_light_of_the_whole_pattern() -> None:
    camera = camera_of()
    own, changes = elemental_of(measured(camera, simulated(), peak=1e6))
    assert own.patterns.shape[1] < SIDE**2 / 3
    assert abs(changes["fourier_um"]) < 0.01 * FOURIER
    setup = Setup(camera, (Crosstalk(0.02), FiniteSource(0.8)), (0.0,) * 5)
    windows = own.predicted(setup, np.full((5, 2), 0.3), Fineness.finest)
    whole = predict(setup, own.plan, own.index, np.full((5, 2), 0.3), Fineness.finest)
    images = own.images(windows)
    where = own.images(np.ones_like(windows)) > 0
    assert np.abs(images - whole)[where].sum() < 0.02 * whole[where].sum()
    assert whole[~where].sum() < 0.03 * whole.sum()


def test_a_box_has_the_light_of_the_reference() -> None:
    plan = ScanPlan.for_camera(camera_of(), depths_um=(20.0,), cutout=SIDE)
    whole = PlaneResponse(plan, 0, (), level="reference").rows([0], [0])[0, 0].astype(float)
    engine = PlaneResponse(plan, 0, (), level="wave", tolerance=0.01).engine()
    box = (slice(105, 150), slice(100, 150))
    assert np.abs(engine.light_in(box, (0.0, 0.0)) - whole[box]).sum() < 0.005 * whole[box].sum()


def test_unusable_stacks_and_groups_are_refused_with_one_message() -> None:
    camera, light = camera_of(), simulated()
    dark = replace(measured(camera, light), patterns=measured(camera, 0 * light + 1e-9, peak=1e-9).patterns)
    elsewhere = camera_of([*CENTRES.tolist(), (-480.0, 500.0)])
    near = (-0.02, -0.01, 0.0, 0.01, 0.02)
    for given, unknowns, what in (
        (measured(camera, light[:2], depths=DEPTHS[:2]), ASKED, "at least 3 planes .* got 2; record more planes"),
        (
            measured(camera, light, depths=near),
            ASKED,
            r"2 px or more, got a range of 0\.04 µm, .*; record planes farther",
        ),
        (measured(camera, light[::-1]), ASKED, r"sign of the depths.*reverse the sign of the depths"),
        (dark, ASKED, "light of the patterns: expected more light than noise"),
        (
            measured(elsewhere, light),
            ASKED,
            r"at \(-480, 500\) µm: .* in 0 of 5 planes; correct the lenslet centres in the",
        ),
        (measured(camera, light), ["geometry"], "geometry, which needs a periodic lenslet array"),
        (measured(camera_of(na=0.6), light), ["iris"], "iris, which needs lenslets that the edge of the pupil cuts"),
    ):
        with pytest.raises(InputError, match=what):
            fit_camera(given, unknowns=unknowns)
    own = measured(camera, light)
    with pytest.raises(InputError, match="fit of several regions of the field: expected a camera with a periodic"):
        fit_field({"a": own, "b": own})


def test_the_reason_of_invalid_pixels_is_named() -> None:
    camera, light = camera_of(CENTRES[:2]), simulated(2)
    bright, far, gone = light > 0.02 * light.max(), np.zeros(light.shape, bool), light.copy()
    far[:, :, 230:], gone[:, :, :100] = True, 0.0
    for invalid, values, words in (
        (bright, light, "shorten the exposure, because pixels of these images are saturated"),
        (bright, np.where(bright, np.nan, light), "record these planes again, because pixels of these images are NaN"),
        (bright, np.where(bright, 0.0, light), "correct the mask of defective pixels.* these images are masked"),
        (far, gone, r"correct the lenslet centres in the description"),
    ):
        given = measured(camera, light, valid=~invalid)
        given = replace(given, patterns=(12e3 * values / light.max()).astype(np.float32))
        match = rf"lenslet at .* expected a usable image at .* got one in [01] of 5 planes; {words}"
        with pytest.raises(InputError, match=match):
            fit_camera(given, unknowns=ASKED)


def test_the_work_for_29_lenslets_is_limited_to_their_elemental_images() -> None:
    """One window per lenslet and plane is computed. A change of one lenslet computes only its windows again."""
    grid = [(1500 * (i + j / 2), 1500 * j * np.sqrt(0.75)) for i in range(-5, 6) for j in range(-5, 6)]
    centres = tuple(sorted(grid, key=lambda place: np.hypot(*place))[:29])
    lenslets = PupilLenslets(centres, 154e3, 36e3, (36e3,), 1300.0)
    camera = Camera("xlfm", Microscope(25.0, 1.05, 1.33), lenslets, Sensor((1024, 1024), 13.0), 0.525)
    side, depths = 701, (-100.0, 0.0, 100.0)
    y, x = np.mgrid[:side, :side] - side // 2
    light = np.zeros((3, side, side))
    for k, z in enumerate(depths):
        for cx, cy in centres:
            far = 1 + lenslets.spread(camera.optics, z)
            light[k] += np.exp(-((x - far * cx / 13) ** 2 + (y - far * cy / 13) ** 2) / 8)
    own, _ = elemental_of(measured(camera, light, depths=depths, held=[]))
    boxes = []

    def counted(scene, box, chief, nodes):
        boxes.append(box)
        return np.zeros((box[1] - box[0], box[3] - box[2]), np.float32)

    own = replace(own, light_in=lru_cache(maxsize=4096)(counted))
    own.predicted(Setup(camera, (), (0.0,) * 3), np.zeros((3, 2)), Fineness.coarse)
    assert len(boxes) == 3 * 29 and all(len(image.lenslets) == 1 for images in own.boxes for image in images)
    area = sum((bottom - top) * (right - left) for top, bottom, left, right in boxes)
    assert area < 0.01 * len(boxes) * side**2
    moved = replace(camera, lattice=replace(lenslets, lens_centres_um=((5.0, 0.0), *centres[1:])))
    own.predicted(Setup(moved, (), (0.0,) * 3), np.zeros((3, 2)), Fineness.coarse)
    assert len(boxes) == 3 * 29 + 3
