from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor, preset
from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lens_types import classify_lens_types, expected_blur
from tests.lattice.white_frames import WhiteFrame, draw_pupils, draw_white

# about the r29 camera's: half the blur d |1/vf + B/b| at a pitch of 16 px
EDGES = (3.9, 2.6, 1.6)
BLUR = (0.50, 0.34, 0.20)


def drawn(**options: Any) -> tuple[WhiteFrame, LatticeFit]:
    truth = draw_white((330, 400), **{"pitch": 16.0, "edges": EDGES, "fill": 0.85, **options})
    return truth, fit_lattice(truth.frame, dark=100.0)


def true_types(fit: LatticeFit, origin: Any, basis: Any, step: int, phase: int) -> np.ndarray:
    places = fit.centres_px(fit.index[:, 0], fit.index[:, 1])[:, ::-1] - np.array(origin)[::-1]
    index = np.rint(places @ np.linalg.inv(basis)).astype(int)
    return np.mod(step * (index[:, 0] - index[:, 1] - phase), 3)


@pytest.mark.few(1)
@pytest.mark.parametrize(("step", "phase"), [*product((1, 2), (0, 1, 2))])
def test_all_six_assignments_of_types_are_found(step: int, phase: int) -> None:
    truth, fit = drawn(step=step, phase=phase, seed=10 * step + phase)
    found = classify_lens_types(truth.frame, fit, BLUR, dark=100.0)
    assert np.array_equal(found.type_of(*fit.index.T), true_types(fit, truth.origin, truth.basis, step, phase))
    assert found.type_step == step
    assert found.confidence > 0.999 and found.agreement > 0.9
    assert found.sharpness[0] < found.sharpness[1] < found.sharpness[2]
    # counter-test: with sharp and blurred types exchanged, types 0 and 2 change places
    wrong = classify_lens_types(truth.frame, fit, BLUR[::-1], dark=100.0)
    assert np.array_equal(wrong.type_of(*fit.index.T), 2 - found.type_of(*fit.index.T))


@pytest.mark.few(1)
@pytest.mark.parametrize(("step", "phase", "pupil"), [(1, 0, 1.0), (2, 1, 1.0), (1, 2, 0.6), (2, 0, 0.6)])
def test_overlapping_micro_images_of_the_photographic_camera(step: int, phase: int, pupil: float) -> None:
    """Wide open, each micro-image reaches into its neighbours: edges there belong to several lenslets."""
    blur = expected_blur(preset("r29"))
    frame, origin, basis = draw_pupils((blur[0], blur[1], blur[2]), pupil=pupil, step=step, phase=phase)
    fit = fit_lattice(frame)
    assert fit.pitch_px == pytest.approx(21.7, abs=0.005)
    found = classify_lens_types(frame, fit, blur)
    assert np.array_equal(found.type_of(*fit.index.T), true_types(fit, origin, basis, step, phase))
    assert found.sigmas > 10


def test_the_camera_gets_a_type_0_lenslet_at_its_offset() -> None:
    truth, fit = drawn(step=2, phase=1)
    types = tuple(LensType(f) for f in (700.0, 900.0, 1500.0))
    lattice = LensletLattice("hexagonal", 80.0, 400.0, types, offset_um=(60.0, 25.0))
    camera = Camera("c", MainLens(), lattice, Sensor(truth.frame.shape, 5.0))
    made = classify_lens_types(truth.frame, fit, BLUR).to_lattice(fit, camera)
    measured = replace(camera, lattice=made)
    q, r = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5))
    places = measured.pixels(made.centres_um(q.ravel(), r.ravel()))[:, ::-1] - np.array(truth.origin)[::-1]
    index = np.rint(places @ np.linalg.inv(truth.basis)).astype(int)
    want = np.mod(2 * (index[:, 0] - index[:, 1] - 1), 3)
    assert np.array_equal(made.type_of(q.ravel(), r.ravel()), want)
    assert np.hypot(made.offset_um[0] - 60.0, made.offset_um[1] - 25.0) < 80.0 * 1.01


def test_a_frame_of_a_point_determines_the_types() -> None:
    """Spots of three widths below the lenslets of one shadow, as a point off the array gives them."""
    truth, fit = drawn(step=1, phase=2, dead=0.0)
    q, r = fit.index.T
    types = true_types(fit, truth.origin, truth.basis, 1, 2)
    places = fit.centres_px(q, r)
    middle = (np.array(truth.frame.shape) - 1) / 2
    y, x = np.mgrid[: truth.frame.shape[0], : truth.frame.shape[1]]
    frame = np.random.default_rng(3).normal(0, 3, truth.frame.shape) + 100
    for (row, column), kind in zip(places, types, strict=True):
        if np.hypot(row - middle[0], column - middle[1]) < 70:
            sigma = (2.6, 1.3, 1.9)[kind]
            frame += 3000 / sigma**2 * np.exp(-((y - row) ** 2 + (x - column) ** 2) / (2 * sigma**2))
    found = classify_lens_types(frame, fit, (2.6, 1.3, 1.9), content="spots", dark=100.0)
    assert np.array_equal(found.type_of(q, r), types)
    assert found.triangles < 80


@pytest.mark.long
def test_undecidable_frames_are_refused() -> None:
    truth, fit = drawn(edges=(1.5, 1.5, 1.5))
    same, noise = truth.frame, np.random.default_rng(0).normal(500, 20, fit.shape)
    dot = np.full(fit.shape, 100.0)
    dot[160:170, 200:210] = 1000
    square = draw_white(kind="square").frame
    spots = {"content": "spots", "dark": 100.0}
    for frame, found, blur, more, what in (
        (same, fit, BLUR, {}, "lens types: expected an assignment"),
        (noise, fit, BLUR, {}, "lens types"),
        (same, fit, (0.5, 0.3, 0.3), {}, "values that differ"),
        (same, fit, (0.5, 0.3), {}, "3 numbers"),
        (same[:-1], fit, BLUR, {}, "expected"),
        (dot, fit, BLUR, spots, "lit triangles"),
        (square, fit_lattice(square), BLUR, {}, "hexagonal"),
    ):
        with pytest.raises(InputError, match=what):
            classify_lens_types(frame, found, blur, **more)


def test_expected_blur_follows_the_defocus() -> None:
    camera = preset("r29")
    assert expected_blur(camera, 3.0) == pytest.approx((1 / 2 - 1 / 3, 0.0, 1 / 3 - 1 / 5))
    # the pupil lies far before the lenslets: close to infinity, where 1/v = 0
    pupil = 871.75 / 250e3
    assert expected_blur(camera) == pytest.approx((0.5 + pupil, 1 / 3 + pupil, 0.2 + pupil))
    assert expected_blur(preset("lfm_20x05")) == (0.0,)
    with pytest.raises(InputError, match="virtual depth"):
        expected_blur(camera, 0)
