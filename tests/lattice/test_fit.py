"""Lattices of drawn and real white images: what is found, how sure it is, and what is refused."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.lattice import measure
from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, MainLens, Sensor, preset
from lfcal.lattice._forms import DistortionFrame
from lfcal.lattice._model import LatticeModel
from lfcal.lattice._rounds import levelled
from lfcal.lattice.fit import LatticeFit, check_cell, fit_lattice, start_reach
from tests.lattice.white_frames import WhiteFrame, barrel, draw_white, relay

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
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("wrong", [0.97, 1.03])
def test_a_nominal_pitch_may_be_wrong_by_three_percent(kind: str, wrong: float) -> None:
    truth = draw_white(kind=kind, seed=3)
    check(fit_lattice(truth.frame, pitch_px=wrong * 15.4, kind=kind), truth, 0.002)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("rotation", [0.0, 0.002])
@pytest.mark.parametrize("offset", [(0.1, -0.4), (0.3, 0.35)])
def test_a_pitch_of_whole_pixels_does_not_move_the_lattice(
    kind: str, rotation: float, offset: tuple[float, float]
) -> None:
    """All micro-images have the same place on their pixels, so they are sampled once a pixel."""
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


def test_dead_lenslets_are_found() -> None:
    truth = draw_white((260, 300), dead=0.05, seed=5)
    fit = fit_lattice(truth.frame)
    index = (fit.centres_px(fit.index[:, 0], fit.index[:, 1]) - truth.origin)[:, ::-1] @ np.linalg.inv(truth.basis)
    gone = np.array([tuple(pair) in truth.dead for pair in np.rint(index).astype(int).tolist()])
    assert gone.sum() > 10 and np.array_equal(fit.dead, gone) and len(fit.dead_lenslets) == gone.sum()
    assert np.isnan(fit.measured_px[fit.dead]).all() and np.isfinite(fit.measured_px[~fit.dead]).all()


def test_the_residual_is_that_of_the_measured_centres() -> None:
    frame = draw_white((200, 260), dead=0.0, snr=50).frame
    fit, three = fit_lattice(frame, workers=1), fit_lattice(frame, workers=3)
    centres = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    assert math.sqrt(np.nanmean((fit.measured_px - centres) ** 2)) == pytest.approx(fit.residual_rms_px, rel=1e-6)
    assert fit.residual_rms_px < 0.03
    middle = (np.array(fit.shape) - 1) / 2
    assert tuple(fit.index[np.argmin(np.hypot(*(centres - middle).T))]) == (0, 0)
    # several threads find the same
    assert fit.pitch_px == pytest.approx(three.pitch_px, abs=1e-9)
    assert np.allclose(fit.measured_px, three.measured_px, equal_nan=True)


@pytest.mark.long
def test_a_dark_frame_or_level_is_subtracted() -> None:
    truth = draw_white(dark=3000.0, seed=2)
    plain = fit_lattice(truth.frame)
    for dark in (3000.0, np.full(truth.frame.shape, 3000, np.uint16)):
        fit = fit_lattice(truth.frame, dark=dark)
        assert fit.pitch_px == pytest.approx(plain.pitch_px, abs=1e-3)
        assert np.allclose(plain.light - fit.light, 3000.0, atol=5.0)


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


def test_the_fit_becomes_the_lattice_of_the_camera() -> None:
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
    assert truth.distance_to_lattice(measured.pixels(lattice.offset_um)) < 0.05
    # every centre of the new lattice is one of the frame's
    centres, _ = lattice.lenslets_within(400.0, 400.0)
    assert max(truth.distance_to_lattice((r, c)) for r, c in measured.pixels(centres)) < 0.06
    other = fit.to_lattice(camera, origin=(2, 1), type_step=2)
    assert other.type_step == 2 and measured.pixels(other.offset_um) == pytest.approx(fit.centres_px(2, 1))
    # a camera of another kind or size is refused
    with pytest.raises(InputError, match="lattice of the white image"):
        fit.to_lattice(replace(camera, lattice=LensletLattice("square", 77.0, 400.0)))
    with pytest.raises(InputError, match="px, as the camera has"):
        fit.to_lattice(preset("r29"))


def textures() -> dict[str, np.ndarray]:
    rng, n = np.random.default_rng(0), 240
    y, x = np.mgrid[:n, :n]
    noise = rng.normal(0, 1, (n, n))
    spots = np.zeros((n, n))
    spots[tuple(rng.integers(0, n, (2, 320)))] = 1
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
        "rings": 100 + 50 * np.cos(np.hypot(x - n / 2, y - n / 2) * 0.4) + noise,
        "bricks": 100.0 + 60 * (((x + (y // 16 % 2) * 20) % 40 < 3) | (y % 16 < 3)),
        "cloth": 100 + 20 * np.sin(x * 0.3) + 20 * np.sin(y * 0.11) + noise,
    }


def test_blank_and_textured_images_are_refused_with_a_reason() -> None:
    for name, frame in textures().items():
        with pytest.raises(InputError, match=r"^white image: expected [^\n]*$"):
            fit_lattice(frame)
            pytest.fail(f"{name} is fitted")


def test_unusable_input_is_refused_in_one_line() -> None:
    plain = draw_white((240, 260)).frame
    for frame, options, what in (
        (np.zeros((3, 400, 400)), {}, "expected"),
        (np.zeros((12, 12)), {}, "expected"),
        (np.full((400, 400), np.nan), {}, "expected"),
        (np.array([["a"]]), {}, "expected"),
        (plain, {"pitch_px": 1.0}, "expected"),
        (plain, {"pitch_px": 200.0}, "expected"),
        (plain, {"pitch_px": 18.0}, "expected"),
        (plain, {"pitch_px": math.nan}, "expected"),
        (plain, {"kind": "square"}, "expected"),
        (plain, {"kind": "round"}, "lattice: expected square or hexagonal"),
        (plain, {"dark": np.zeros((3, 3))}, "expected"),
        (draw_white((240, 260), dead=0.6).frame, {}, "expected"),
        (plain[:40, :40], {}, "expected"),
    ):
        with pytest.raises(InputError, match=rf"^[^\n]*{what}[^\n]*$"):
            fit_lattice(frame, **options)
            pytest.fail(f"accepted {np.shape(frame)}, {options}")


@pytest.mark.long
def test_a_distortion_of_half_a_pitch_does_not_lose_the_lattice() -> None:
    """3 px at a pitch of 6.5 px: about a straight lattice the corners would be on the wrong side of a gap."""
    shape = (380, 470)
    truth = draw_white(shape, 6.5, "square", rotation=0.3, bend=barrel(3.0, math.hypot(*shape) / 2), dead=0.02, seed=2)
    fit = fit_lattice(truth.frame)
    places = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    assert math.sqrt((truth.errors(places) ** 2).sum(1).mean()) < 0.02
    # neighbours are neighbours: no row was skipped on the way
    columns = np.column_stack([fit.index, np.ones(len(fit.index))])
    matrix = np.linalg.lstsq(columns, truth.indices(places), rcond=None)[0]
    assert np.abs(matrix[:2]).round(6).tolist() in ([[1, 0], [0, 1]], [[0, 1], [1, 0]])


def test_the_first_region_is_small_but_never_too_small() -> None:
    def reach(pitch: float, shape: tuple[int, int] = (4384, 6576)) -> float:
        model = LatticeModel("square", np.zeros(2), np.array([pitch, 0.0]), 1.0)
        return start_reach(model, DistortionFrame.of(shape))

    assert reach(15.0) == 700.0 and reach(90.0) == 900.0
    assert 3 * (reach(24.0, (100, 120)) / 24.0) ** 2 >= 60


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


@pytest.mark.long
def test_micro_images_of_any_size_are_no_checkerboard() -> None:
    for fill in (0.5, 1.0):
        assert fit_lattice(draw_white((200, 220), kind="square", fill=fill).frame).kind == "square"
    # micro-images that are not resolved are not judged: two crossed sines are their own negative half a diagonal away
    frame = draw_white((200, 220), 6.0, "square", fill=0.8, snr=100.0).frame.astype(float)
    assert fit_lattice(cv2.GaussianBlur(frame, (0, 0), 1.5)).kind == "square"
    check_cell(np.ones((12, 12)))


LARGE = (700, 900)
COUNT = 24


@dataclass(frozen=True)
class DistortedCamera:
    """A drawn white image, its nominal pitch (2 % wrong), and the lattice form that made it."""

    truth: WhiteFrame
    nominal_px: float
    form: str


def distorted_camera(number: int) -> DistortedCamera:
    """Square or hexagonal, turned up to 45 degrees, 1-3 px radial or relay distortion, SNR 20, 5 % dead."""
    rng = np.random.default_rng(100 + number)
    pitch, turn, by = rng.uniform(9, 26), rng.uniform(-math.pi / 4, math.pi / 4), rng.uniform(1, 3)
    reach, radial = math.hypot(*LARGE) / 2, number % 4 < 2
    sign, centre = rng.choice([-1, 1]), rng.uniform(-0.2, 0.2, 2) * reach
    bend = barrel(sign * by, reach, (centre[0], centre[1])) if radial else relay(by, reach, number)
    kind = ("hexagonal", "square")[number % 2]
    truth = draw_white(LARGE, float(pitch), kind, rotation=float(turn), seed=number, bend=bend)
    return DistortedCamera(truth, float(pitch * rng.choice([0.98, 1.02])), "radial" if radial else "cubic")


def rms(camera: DistortedCamera, fit: LatticeFit) -> float:
    errors = camera.truth.errors(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    return math.sqrt(float((errors**2).sum(1).mean()))


def true_terms(camera: DistortedCamera, fit: LatticeFit) -> np.ndarray:
    """Return the terms that plain least squares finds in the exact places: the truth in the fit's own form."""
    bend = fit.distortion
    assert bend is not None
    places = camera.truth.seen(camera.truth.indices(fit.centres_px(*fit.index.T)))[:, ::-1]
    straight = fit.index @ fit.basis_px() + bend.invert(np.array(fit.origin_px[::-1]))
    u, v = ((straight - np.array(bend.centre)) / bend.scale).T
    plain = [np.ones_like(u), u, v]
    if bend.model == "radial":
        # about the fitted centre a radial distortion has quadratic terms, too
        rho = u * u + v * v
        zero = np.zeros_like(u)
        columns = [np.concatenate([c, zero]) for c in plain] + [np.concatenate([zero, c]) for c in plain]
        columns += [np.concatenate([3 * u * u + v * v, 2 * u * v]), np.concatenate([2 * u * v, u * u + 3 * v * v])]
        columns.append(np.concatenate([rho * u, rho * v]))
        answer = np.linalg.lstsq(np.stack(columns, -1), places.T.ravel(), rcond=None)[0]
        return answer[-1:]
    bent = [u**i * v**j for i, j in ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))]
    answer = np.linalg.lstsq(np.stack([*plain, *bent], -1), places, rcond=None)[0]
    return answer[3:].T.ravel()


@pytest.mark.long
def test_two_of_the_distorted_cameras() -> None:
    for number in (1, 2):
        trial = measure(number, workers=1)
        assert trial.form == trial.called and trial.rms_px < 0.01 and trial.pull < 2


@pytest.mark.long
def test_every_distorted_camera_to_a_twentieth_of_a_pixel() -> None:
    """Every micro-image within 0.05 px rms of the truth, and coefficients as far off as their errors say."""
    z = []
    for number in range(COUNT):
        camera = distorted_camera(number)
        fit = fit_lattice(camera.truth.frame, pitch_px=camera.nominal_px)
        assert fit.form == camera.form and fit.errors is not None and fit.distortion is not None
        assert rms(camera, fit) < 0.05
        z.append((np.concatenate(fit.distortion.terms) - true_terms(camera, fit)) / np.concatenate(fit.errors.terms))
    every = np.concatenate(z)
    # chi² per coefficient, and no coefficient far outside
    assert 0.5 < float((every**2).mean()) < 1.6
    assert np.abs(every).max() < 5


@pytest.mark.long
def test_without_distortion_the_straight_lattice_is_chosen() -> None:
    for kind, seed in itertools.product(("square", "hexagonal"), range(6)):
        truth = draw_white((700, 900), 11.0 + 2 * seed, kind, rotation=0.13 * seed, seed=seed)
        fit = fit_lattice(truth.frame)
        assert fit.form == "affine" and fit.pitch_px == pytest.approx(truth.pitch, abs=3e-4), (kind, seed)


GAINS = np.array([[0.5, 1.0], [1.0, 0.35]])


def behind_filters(frame: np.ndarray) -> np.ndarray:
    rows, columns = frame.shape
    return frame * np.tile(GAINS, (rows // 2 + 1, columns // 2 + 1))[:rows, :columns]


def test_a_bayer_white_image_gives_the_lattice_of_a_grey_one() -> None:
    """A pitch of whole pixels beats with the mosaic: untreated, the places are off by more than a pixel."""
    truth = draw_white((331, 401), 16.0, seed=3)
    fit = fit_lattice(behind_filters(truth.frame - 100.0))
    errors = truth.errors(fit.centres_px(*fit.index.T))
    assert fit.form == "affine" and math.sqrt(float((errors**2).sum(1).mean())) < 0.02


def test_micro_images_alone_are_no_mosaic() -> None:
    for pitch, rotation in ((4.0, 0.0), (6.0, 0.0), (8.0, 0.003), (15.4, 0.003)):
        frame = (draw_white((160, 200), pitch, "square", rotation=rotation).frame - 100.0).astype(np.float32)
        assert levelled(frame) is frame, pitch
    for frame in (np.zeros((64, 64), np.float32), np.full((64, 64), -3, np.float32)):
        assert levelled(frame) is frame, "blank"


def test_the_gains_of_a_mosaic_are_removed_and_the_light_stays() -> None:
    frame = draw_white((160, 200), 15.4, snr=1e6).frame - 100.0
    even = levelled(behind_filters(frame).astype(np.float32))
    np.testing.assert_allclose(even / frame.clip(1), float(GAINS.mean()) * (frame / frame.clip(1)), atol=0.02)
