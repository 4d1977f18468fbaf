from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, MainLens, Sensor, preset
from lfcal.lattice._forms import DistortionFrame
from lfcal.lattice._model import LatticeModel
from lfcal.lattice.fit import LatticeFit, check_cell, fit_lattice, start_reach, tracking_form
from tests.lattice.test_iris_centre import off_centre, white
from tests.lattice.white_frames import WhiteFrame, barrel, draw_white

REAL = Path(__file__).parents[3] / "shared/data/lfm_guv"
needs_real = pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")

FRAMES: dict[str, dict[str, Any]] = {
    "hexagonal": {},
    "square": {"kind": "square"},
    "touching": {"fill": 1.0, "edges": (0.4,)},
    "small micro-images": {"fill": 0.5},
    "three types": {"pitch": 24.3, "edges": (0.7, 2.0, 3.3), "shape": (500, 600)},
    "standing": {"rotation": math.pi / 2},
    "turned": {"rotation": 0.2},
    "fine": {"pitch": 6.3},
    "coarse": {"pitch": 47.0, "shape": (500, 600)},
    "uneven": {"kind": "square", "row_pitch": 14.9, "rotation": -0.1},
    "noisy": {"snr": 3.0},
}


def check(fit: LatticeFit, truth: WhiteFrame, tolerance: float) -> None:
    assert fit.pitch_px == pytest.approx(truth.pitch, abs=tolerance)
    assert fit.row_pitch_px == pytest.approx(truth.row_pitch, abs=tolerance)
    assert fit.rotation_rad == pytest.approx(truth.rotation, abs=1e-3)
    assert truth.distance_to_lattice(fit.origin_px) < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("name", FRAMES)
def test_the_lattice_is_found_without_a_nominal_pitch(name: str) -> None:
    truth = draw_white(**FRAMES[name])
    check(fit_lattice(truth.frame), truth, 0.005)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("wrong", [0.97, 1.03])
def test_a_nominal_pitch_wrong_by_three_percent_will_do(kind: str, wrong: float) -> None:
    truth = draw_white(kind=kind, seed=3)
    check(fit_lattice(truth.frame, pitch_px=wrong * 15.4, kind=kind), truth, 0.002)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("rotation", [0.0, 0.002])
@pytest.mark.parametrize("offset", [(0.1, -0.4), (0.3, 0.35)])
def test_a_pitch_of_whole_pixels_moves_no_lattice(kind: str, rotation: float, offset: tuple[float, float]) -> None:
    """All micro-images lie alike on their pixels: they are sampled once a pixel, wherever the grid of pixels lies."""
    soft: dict[str, Any] = {"edges": (3.0,), "fill": 0.6, "snr": 1e4, "dead": 0.0, "falloff": 0.0}
    truth = draw_white((220, 240), 14.0, kind, rotation=rotation, offset=offset, **soft)
    fit = fit_lattice(truth.frame)
    assert fit.form == "affine"
    assert np.hypot(*truth.errors(fit.centres_px(*fit.index.T)).T).max() < 0.02


@pytest.mark.long
def test_errors_are_as_large_as_stated() -> None:
    """Over eight noise draws the pitch scatters by its standard error, and is not biased by the light's fall."""
    fits = [fit_lattice(draw_white((240, 240), seed=k, dead=0.0, falloff=0.4).frame) for k in range(8)]
    errors = np.array([fit.pitch_px - 15.4 for fit in fits])
    stated = float(np.mean([fit.pitch_error_px for fit in fits]))
    assert 0.4 * stated < errors.std() < 2.5 * stated
    assert abs(errors.mean()) < 5e-4


def test_dead_lenslets_are_named() -> None:
    truth = draw_white(dead=0.05, seed=5)
    fit = fit_lattice(truth.frame)
    index = (fit.centres_px(fit.index[:, 0], fit.index[:, 1]) - truth.origin)[:, ::-1] @ np.linalg.inv(truth.basis)
    gone = np.array([tuple(pair) in truth.dead for pair in np.rint(index).astype(int).tolist()])
    assert gone.sum() > 20
    assert np.array_equal(fit.dead, gone)
    assert len(fit.dead_lenslets) == gone.sum()
    assert np.isnan(fit.measured_px[fit.dead]).all() and np.isfinite(fit.measured_px[~fit.dead]).all()


def test_measured_centres_lie_on_the_lattice_and_indices_are_consistent() -> None:
    fit = fit_lattice(draw_white(dead=0.0, snr=50).frame)
    centres = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    error = fit.measured_px - centres
    assert math.sqrt(np.nanmean(error**2)) == pytest.approx(fit.residual_rms_px, rel=1e-6)
    assert fit.residual_rms_px < 0.03
    back = fit.lenslet_at(centres[:, 0], centres[:, 1])
    assert np.allclose(back, fit.index, atol=1e-9)
    middle = (np.array(fit.shape) - 1) / 2
    distances = np.hypot(*(centres - middle).T)
    assert tuple(fit.index[np.argmin(distances)]) == (0, 0)


@pytest.mark.long
def test_a_dark_frame_or_level_is_subtracted() -> None:
    truth = draw_white(dark=3000.0, seed=2)
    plain = fit_lattice(truth.frame)
    for dark in (3000.0, np.full(truth.frame.shape, 3000, np.uint16)):
        fit = fit_lattice(truth.frame, dark=dark)
        assert fit.pitch_px == pytest.approx(plain.pitch_px, abs=1e-3)
        assert np.allclose(plain.light - fit.light, 3000.0, atol=5.0)


def test_one_thread_and_several_agree() -> None:
    frame = draw_white((200, 260)).frame
    one, three = fit_lattice(frame, workers=1), fit_lattice(frame, workers=3)
    assert one.pitch_px == pytest.approx(three.pitch_px, abs=1e-9)
    assert np.allclose(one.measured_px, three.measured_px, equal_nan=True)


@pytest.mark.few(1)
@needs_real
@pytest.mark.parametrize("nominal", [None, 15.385, 15.385 * 1.03, 15.385 * 0.97])
def test_the_real_microscope(nominal: float | None) -> None:
    from lfcal.frames import read_image

    white = read_image(REAL / "Radiometry_GUVExperim1.tif")
    dark = read_image(REAL / "DarkFrame_GUVExperim1.tif")
    fit = fit_lattice(white, dark=dark, pitch_px=nominal)
    assert fit.kind == "square"
    assert fit.pitch_px == pytest.approx(15.388, abs=0.02)
    assert fit.row_pitch_px == pytest.approx(15.410, abs=0.02)
    assert fit.residual_rms_px < 0.05 and not fit.dead.any()
    with pytest.raises(InputError, match="white image"):
        fit_lattice(dark)


def camera_of(truth: WhiteFrame, **options: Any) -> Camera:
    lattice = LensletLattice("hexagonal", pitch_um=15.0 * 5, gap_um=400.0, **options)
    return Camera("c", MainLens(), lattice, Sensor(truth.frame.shape, 5.0))


def test_the_fit_becomes_the_camera_s_lattice() -> None:
    truth = draw_white(seed=4)
    fit = fit_lattice(truth.frame)
    camera = camera_of(truth, offset_um=(33.0, -52.0), clear_um=70.0)
    lattice = fit.to_lattice(camera)
    assert lattice.pitch_um == pytest.approx(15.4 * 5, abs=0.01)
    assert lattice.row_step_um == pytest.approx(15.4 * 5 * math.sqrt(3) / 2, abs=0.01)
    assert lattice.rotation_rad == pytest.approx(0.003, abs=1e-4)
    assert (lattice.gap_um, lattice.types, lattice.clear_um) == (400.0, camera.lattice.types, 70.0)
    assert math.dist(lattice.offset_um, (33.0, -52.0)) < 15.4 * 5 * 0.6
    measured = replace(camera, lattice=lattice)
    row, column = measured.pixels(lattice.offset_um)
    assert truth.distance_to_lattice((row, column)) < 0.05
    # every centre of the new lattice is one of the frame's
    centres, _ = lattice.lenslets_within(400.0, 400.0)
    assert max(truth.distance_to_lattice((r, c)) for r, c in measured.pixels(centres)) < 0.06
    other = fit.to_lattice(camera, origin=(2, 1), type_step=2)
    assert other.type_step == 2
    assert measured.pixels(other.offset_um) == pytest.approx(fit.centres_px(2, 1))


def test_a_camera_of_another_kind_or_size_is_refused() -> None:
    truth = draw_white()
    fit = fit_lattice(truth.frame)
    with pytest.raises(InputError, match="lattice of the white image"):
        fit.to_lattice(replace(camera_of(truth), lattice=LensletLattice("square", 77.0, 400.0)))
    with pytest.raises(InputError, match="px, as the camera has"):
        fit.to_lattice(preset("r29"))


def textures() -> dict[str, np.ndarray]:
    import cv2

    rng = np.random.default_rng(0)
    n = 400
    y, x = np.mgrid[:n, :n]
    noise = rng.normal(0, 1, (n, n))
    spots = np.zeros((n, n))
    spots[tuple(rng.integers(0, n, (2, 900)))] = 1
    return {
        "zero": np.zeros((n, n)),
        "flat": np.full((n, n), 900, np.uint16),
        "saturated": np.full((n, n), 65535, np.uint16),
        "noise": 500 + 20 * noise,
        "gradient": x + 2.0 * y,
        "clouds": cv2.GaussianBlur(noise, (0, 0), 6),
        "grain of one size": cv2.GaussianBlur(noise, (0, 0), 3) - cv2.GaussianBlur(noise, (0, 0), 5),
        "spots anywhere": cv2.GaussianBlur(spots, (0, 0), 4),
        "stripes": 100 + 50 * np.sin(x / 3) + noise,
        "rings": 100 + 50 * np.cos(np.hypot(x - 200, y - 200) * 0.4) + noise,
        "bricks": 100.0 + 60 * (((x + (y // 16 % 2) * 20) % 40 < 3) | (y % 16 < 3)),
        "cloth": 100 + 20 * np.sin(x * 0.3) + 20 * np.sin(y * 0.11) + noise,
    }


@pytest.mark.parametrize("name", sorted(textures()))
def test_blank_and_textured_images_are_refused_with_a_reason(name: str) -> None:
    with pytest.raises(InputError, match="white image: expected") as caught:
        fit_lattice(textures()[name])
    assert "\n" not in str(caught.value)


@cache
def plain() -> NDArray[np.uint16]:
    return draw_white().frame


@pytest.mark.parametrize(
    ("frame", "options"),
    [
        (lambda: np.zeros((3, 400, 400)), {}),
        (lambda: np.zeros((12, 12)), {}),
        (lambda: np.full((400, 400), np.nan), {}),
        (lambda: np.array([["a"]]), {}),
        (plain, {"pitch_px": 1.0}),
        (plain, {"pitch_px": 200.0}),
        (plain, {"pitch_px": 18.0}),
        (plain, {"pitch_px": math.nan}),
        (plain, {"kind": "square"}),
        (plain, {"dark": np.zeros((3, 3))}),
        (lambda: draw_white(dead=0.6).frame, {}),
        (lambda: draw_white(pitch=15.4).frame[:40, :40], {}),
    ],
)
def test_unusable_input_is_one_clear_line(frame: Callable[[], Any], options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected") as caught:
        fit_lattice(frame(), **options)
    assert "\n" not in str(caught.value)


def test_an_iris_without_a_centre_of_symmetry_moves_the_lattice_and_adds_its_error() -> None:
    frame = white("hexagonal", 11.0, 7, 0.95, noise=60.0)
    fit = fit_lattice(frame, dark=64.0)
    off = np.abs(off_centre(fit, "hexagonal", 11.0))
    assert (off < 4 * np.array(fit.errors.origin_px)).all() and max(fit.errors.origin_px) < 0.03
    assert fit.errors.origin_px[0] > 2 * fit.residual_rms_px / math.sqrt(len(fit.index)), "the iris is known less well"


def test_another_kind_is_refused_by_its_name() -> None:
    with pytest.raises(InputError, match="lattice: expected square or hexagonal"):
        fit_lattice(plain(), kind="round")


@pytest.mark.long
def test_a_distortion_of_half_a_pitch_does_not_lose_the_lattice() -> None:
    """3 px with a pitch of 6.5 px: about a straight lattice the corners would be placed on the wrong side of a gap."""
    shape = (380, 470)
    reach = math.hypot(*shape) / 2
    truth = draw_white(shape, 6.5, "square", rotation=0.3, bend=barrel(3.0, reach), dead=0.02, seed=2)
    fit = fit_lattice(truth.frame)
    errors = truth.errors(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    assert math.sqrt((errors**2).sum(1).mean()) < 0.02
    # neighbours are neighbours: no row was skipped on the way
    drawn = truth.indices(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    matrix = np.linalg.lstsq(np.column_stack([fit.index, np.ones(len(fit.index))]), drawn, rcond=None)[0]
    assert np.abs(matrix[:2]).round(6).tolist() in ([[1, 0], [0, 1]], [[0, 1], [1, 0]])


def test_the_first_region_is_small_but_never_too_small() -> None:
    frame = DistortionFrame.of((4384, 6576))

    def reach(pitch: float, frame: DistortionFrame = frame) -> float:
        return start_reach(LatticeModel("square", np.zeros(2), np.array([pitch, 0.0]), 1.0), frame)

    assert reach(15.0) == 700.0
    assert reach(90.0) == 900.0
    small = DistortionFrame.of((100, 120))
    assert 3 * (reach(24.0, small) / 24.0) ** 2 >= 60


def test_what_runs_ahead_is_no_more_than_a_cubic() -> None:
    assert tracking_form(100000).degree == 3
    assert tracking_form(12).name == "affine"


def checkerboard(side: float, turn: float, blur: float, noise: float = 20.0) -> np.ndarray:
    y, x = np.mgrid[:240, :260]
    u, v = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    fields = 1000.0 * ((np.floor(u / side) + np.floor(v / side)) % 2) + 100
    soft = cv2.GaussianBlur(fields, (0, 0), blur) if blur else fields
    return soft + np.random.default_rng(1).normal(0, noise, soft.shape)


@pytest.mark.few(1)
@pytest.mark.parametrize(("side", "turn", "blur"), [(8.0, 0.0, 0.0), (11.0, 0.1, 1.0), (15.3, 0.78, 1.5)])
def test_a_checkerboard_is_no_white_image(side: float, turn: float, blur: float) -> None:
    with pytest.raises(InputError, match="checkerboard"):
        fit_lattice(checkerboard(side, turn, blur))


@pytest.mark.few(2)
@pytest.mark.parametrize("fill", [0.5, 0.75, 0.85, 1.0])
def test_micro_images_of_any_size_are(fill: float) -> None:
    assert fit_lattice(draw_white((200, 220), kind="square", fill=fill).frame).kind == "square"


def test_micro_images_that_are_not_resolved_are_not_judged() -> None:
    """Two crossed sines are their own negative half a diagonal away, too."""
    frame = draw_white((200, 220), 6.0, "square", fill=0.8, snr=100.0).frame.astype(float)
    assert fit_lattice(cv2.GaussianBlur(frame, (0, 0), 1.5)).kind == "square"


def test_a_blank_cell_is_left_to_others() -> None:
    check_cell(np.ones((12, 12)))
