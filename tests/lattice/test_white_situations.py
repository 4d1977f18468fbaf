"""White images as people record them: stopped down, partly lit, with few lenslets, or of a specimen by mistake."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from lfcal.base.errors import InputError
from lfcal.lattice._doubts import Evenness, check_white, evenness
from lfcal.lattice._iris_centre import _transforms
from lfcal.lattice.fit import fit_lattice
from lfcal.lattice.lattice_file import load_lattice, save_lattice
from lfcal.lattice.lattice_fit import LatticeFit
from tests.lattice.white_frames import draw_white

Array = NDArray[np.float64]
SHAPE = (300, 360)


def places_of(
    kind: str, pitch: float, ratio: float = 1.0, degrees: float = 0.5, shape: tuple[int, int] = SHAPE
) -> Array:
    """Return the centres ``(n, 2)`` (row, column) of an array that covers a frame; ``ratio`` stretches its rows."""
    turn = np.exp(1j * math.radians(degrees))
    across = (0.5 + 0.75**0.5 * 1j) if kind == "hexagonal" else ratio * 1j
    count = int(2 * max(shape) / pitch / min(1.0, ratio)) + 3
    q, r = np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1))
    # numbers without a common fraction with the pixels
    points = turn * pitch * (q + across * r).ravel() + (shape[1] / 2 + 0.37) + 1j * (shape[0] / 2 - 0.21)
    points = points[(np.abs(points.real - shape[1] / 2) < shape[1] / 2 + pitch)]
    points = points[(np.abs(points.imag - shape[0] / 2) < shape[0] / 2 + pitch)]
    return np.stack([points.imag, points.real], axis=-1)


def drawn(
    places: Array,
    profile: Callable[[Array], Array],
    reach: float,
    *,
    light: Array | float = 1.0,
    share: Array | None = None,
    shape: tuple[int, int] = SHAPE,
    peak: float = 3000.0,
    seed: int = 4,
) -> NDArray[np.uint16]:
    """Add ``profile`` (distance in px) of every micro-image within ``reach``; photon and read noise, 12 bits."""
    image = np.zeros(shape)
    for k, (y, x) in enumerate(places):
        rows = np.arange(max(0, math.ceil(y - reach)), min(shape[0], math.floor(y + reach) + 1))
        columns = np.arange(max(0, math.ceil(x - reach)), min(shape[1], math.floor(x + reach) + 1))
        if rows.size and columns.size:
            distance = np.hypot(rows[:, None] - y, columns - x)
            image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += profile(distance) * (
                1.0 if share is None else share[k]
            )
    rng = np.random.default_rng(seed)
    counts = rng.poisson(peak * image * light) + 64 + rng.normal(0, 3, shape)
    return np.clip(np.rint(counts), 0, 4095).astype(np.uint16)


def disc(radius: float, edge: float = 0.5) -> tuple[Callable[[Array], Array], float]:
    return lambda d: 1 / (1 + np.exp(np.clip((d - radius) / edge, -40, 40))), radius + 9 * edge


def spot(sigma: float) -> tuple[Callable[[Array], Array], float]:
    return lambda d: np.exp(-0.5 * (d / sigma) ** 2), 5 * sigma


def worst(fit: LatticeFit, places: Array) -> float:
    """Return the largest distance of a fitted lenslet that was located from a drawn one (px)."""
    found = fit.centres_px(*fit.index[~fit.dead].T)
    return float(cKDTree(places).query(found)[0].max())


def found_share(fit: LatticeFit, places: Array) -> float:
    """Return the share of whole drawn micro-images that were located."""
    margin = 0.6 * max(fit.pitch_px, fit.row_pitch_px)
    whole = places[((places > margin) & (places < np.array(fit.shape) - 1 - margin)).all(1)]
    return float((cKDTree(fit.centres_px(*fit.index[~fit.dead].T)).query(whole)[0] < 0.5).mean())


@pytest.mark.few(3)
@pytest.mark.parametrize("hint", [False, True])
@pytest.mark.parametrize("kind", ["hexagonal", "square"])
@pytest.mark.parametrize(
    ("pitch", "sigma"), [(14.37, 1.0), (14.37, 1.6), (14.37, 2.4), (24.8, 1.3), (24.8, 3.0), (24.8, 4.0)]
)
def test_spots_of_a_stopped_down_main_lens(kind: str, pitch: float, sigma: float, hint: bool) -> None:
    places = places_of(kind, pitch)
    given: dict[str, Any] = {"kind": kind, "pitch_px": 1.04 * pitch} if hint else {}
    fit = fit_lattice(drawn(places, *spot(sigma)), **given)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(pitch, abs=2e-3)
    assert worst(fit, places) < 0.01 and found_share(fit, places) == 1.0


@pytest.mark.few(2)
@pytest.mark.parametrize("hint", [False, True])
@pytest.mark.parametrize("ratio", [0.5, 1 / 1.5, 1 / 1.1, 1.05, 1.1, 1.2, 1.5, 2.0])
def test_rectangular_cells(ratio: float, hint: bool) -> None:
    places = places_of("square", 16.4, ratio)
    given: dict[str, Any] = {"kind": "square", "pitch_px": 16.4} if hint else {}
    fit = fit_lattice(drawn(places, *disc(7.0 * min(1.0, ratio))), **given)
    assert fit.kind == "square" and fit.row_pitch_px == pytest.approx(16.4 * ratio, abs=2e-3)
    assert fit.pitch_px == pytest.approx(16.4, abs=2e-3)
    assert worst(fit, places) < 0.01 and found_share(fit, places) == 1.0


@pytest.mark.few(2)
@pytest.mark.parametrize("hint", [False, True])
@pytest.mark.parametrize(
    ("kind", "count", "pitch"),
    [
        *(("hexagonal", 7, 95.0), ("hexagonal", 19, 60.0), ("hexagonal", 37, 43.0)),
        *(("square", 9, 95.0), ("square", 16, 70.0), ("square", 36, 47.0)),
    ],
)
def test_few_large_lenslets(kind: str, count: int, pitch: float, hint: bool) -> None:
    places = places_of(kind, pitch, degrees=0.0)
    places = places[np.argsort(np.hypot(*(places - np.array(SHAPE) / 2).T), kind="stable")[:count]]
    given: dict[str, Any] = {"kind": kind, "pitch_px": pitch} if hint else {}
    fit = fit_lattice(drawn(places, *disc(0.46 * pitch)), **given)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(pitch, abs=0.01)
    assert worst(fit, places) < 0.02 and found_share(fit, places) == 1.0
    assert sum("lenslets: distortion is limited to" in note for note in fit.notes) == 1


ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
LIT = {
    "left third": COLUMNS < SHAPE[1] / 3,
    "left 15 %": COLUMNS < 0.15 * SHAPE[1],
    "disc": np.hypot(ROWS - 120, COLUMNS - 110) < 90,
    "corner": (ROWS > 165) & (COLUMNS > 200),
}


@pytest.mark.few(1)
@pytest.mark.parametrize("dark", [0.0, 64.0])
@pytest.mark.parametrize("kind", ["hexagonal", "square"])
@pytest.mark.parametrize("part", LIT)
def test_a_partly_lit_frame_is_fitted_where_there_is_light(part: str, kind: str, dark: float, tmp_path: Any) -> None:
    places = places_of(kind, 12.6, degrees=2.0)
    fit = fit_lattice(drawn(places, *disc(5.6), light=LIT[part].astype(float)), dark=dark)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(12.6, rel=2e-3)
    assert worst(fit, places) < 0.1
    assert sum("extrapolated elsewhere" in note for note in fit.notes) == 1
    # the outline contains every located micro-image, and only lit ones
    assert fit.outline_px is not None
    lit = np.argwhere(LIT[part])
    assert (fit.outline_px >= lit.min(0) - 8).all() and (fit.outline_px <= lit.max(0) + 8).all()
    assert np.ptp(fit.outline_px, axis=0).prod() > 0.6 * np.ptp(lit, axis=0).prod()
    save_lattice(fit, tmp_path)
    again = load_lattice(tmp_path / "lattice.json")
    assert again.outline_px is not None and np.abs(again.outline_px - fit.outline_px).max() < 0.01
    gone = set(again.dead_lenslets)
    assert not [one for one in map(tuple, fit.index[~fit.dead].tolist()) if one in gone]


def falling(share: float, shape: tuple[int, int] = SHAPE) -> Array:
    """Return light that falls from 1 in the middle to ``share`` in the corners."""
    away = np.hypot(np.linspace(-1, 1, shape[0])[:, None], np.linspace(-1, 1, shape[1])) / 2**0.5
    result: Array = 1 - (1 - share) * away**2
    return result


def ring(radius: float) -> tuple[Callable[[Array], Array], float]:
    return lambda d: np.exp(-0.5 * ((d - radius) / 1.3) ** 2), radius + 7


def annulus(inner: float, outer: float) -> tuple[Callable[[Array], Array], float]:
    whole, reach = disc(outer)
    return lambda d: whole(d) * (1 - disc(inner)[0](d)), reach


def as_8_bit_jpeg(frame: NDArray[np.uint16]) -> Array:
    """Return the frame as a camera that saves pictures writes it: gamma 2.2, 8 bits, compressed about 10:1."""
    levels = np.rint(255 * (frame / frame.max()) ** (1 / 2.2)).astype(np.uint8)
    done, data = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, 75])
    assert done
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.float64)


REPORTED: dict[str, tuple[str, float, float, Callable[[Array], Any]]] = {
    "corners at 3 %": ("hexagonal", 14.37, 0.7, lambda p: drawn(p, *disc(6.4), light=falling(0.03))),
    "lensfun/lensfun#2775": ("hexagonal", 14.37, 0.7, lambda p: drawn(p, *disc(6.4), light=falling(0.17))),
    "contrast of 17 %": ("square", 14.37, 0.7, lambda p: drawn(p, *disc(6.0), peak=400.0) + np.uint16(1800)),
    "hahnec/plenopticam#7, rings": ("hexagonal", 22.6, -1.15, lambda p: drawn(p, *ring(8.5))),
    "hahnec/plenopticam#8, turned by 45 degrees": ("square", 18.25, 45.0, lambda p: drawn(p, *disc(8.0))),
    "turned by 20 degrees": ("square", 18.25, 20.0, lambda p: drawn(p, *disc(8.0))),
    "Plenoptic-Simulation#13, columns first": ("hexagonal", 18.25, 30.0, lambda p: drawn(p, *disc(8.0))),
    "turned by 15 degrees": ("hexagonal", 18.25, 15.0, lambda p: drawn(p, *disc(8.0))),
    "light-field-Processing#3, 5 px": ("square", 5.13, 0.23, lambda p: drawn(p, *spot(1.2))),
    "4.4 px": ("hexagonal", 4.4, 0.23, lambda p: drawn(p, *spot(1.0))),
    "saturated": ("hexagonal", 14.37, 0.7, lambda p: drawn(p, *disc(5.5), peak=12000.0)),
    "8 bits, gamma, JPEG": ("hexagonal", 14.37, 0.7, lambda p: as_8_bit_jpeg(drawn(p, *disc(6.0)))),
}
"""Kind, pitch (px), rotation (degrees) and what draws the white image, after public reports or common practice."""


@pytest.mark.parametrize(
    "name",
    [name if "JPEG" in name else pytest.param(name, marks=pytest.mark.long) for name in REPORTED],
)
def test_white_images_after_public_reports(name: str) -> None:
    kind, pitch, degrees, draw = REPORTED[name]
    places = places_of(kind, pitch, degrees=degrees)
    fit = fit_lattice(draw(places))
    assert fit.kind == kind and fit.pitch_px == pytest.approx(pitch, abs=3e-3)
    assert worst(fit, places) < 0.05 and found_share(fit, places) > 0.99


@pytest.mark.few(1)
@pytest.mark.parametrize("obstruction", [0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
@pytest.mark.parametrize("fill", [0.8, 0.9])
@pytest.mark.parametrize("kind", ["hexagonal", "square"])
def test_the_dark_middle_of_rings_is_no_gap(kind: str, fill: float, obstruction: float) -> None:
    """The iris of a mirror lens is a ring: the gaps of a square array are as symmetric as its lenslets."""
    places = places_of(kind, 22.6, degrees=1.1)
    outer = fill * 22.6 / 2
    fit = fit_lattice(drawn(places, *annulus(obstruction * outer, outer), light=falling(0.3)))
    assert fit.kind == kind and fit.pitch_px == pytest.approx(22.6, abs=3e-3)
    assert worst(fit, places) < 0.05 and found_share(fit, places) == 1.0


@pytest.mark.few(1)
@pytest.mark.parametrize("obstruction", [0.2, 0.3, 0.4, 0.6, 0.7, 0.8])
@pytest.mark.parametrize(("kind", "ratio"), [("hexagonal", 1.0), ("square", 1.0), ("square", 1.3)])
def test_rings_that_touch_are_fitted_or_refused(kind: str, ratio: float, obstruction: float) -> None:
    """The brightest places of touching rings are between their centres."""
    places, outer = places_of(kind, 22.6, ratio, 1.1), 0.98 * 22.6 / 2
    try:
        fit = fit_lattice(drawn(places, *annulus(obstruction * outer, outer), light=falling(0.3)))
    except InputError as refused:
        assert "lenslets, with the main lens stopped down if micro-images overlap" in str(refused)
    else:
        assert fit.kind == kind and worst(fit, places) < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["hexagonal", "square"])
@pytest.mark.parametrize("radius", [9.0, 10.0, 11.0, 11.5, 12.0, 13.0])
def test_overlapping_discs_are_refused(kind: str, radius: float) -> None:
    """Their overlaps form lattices too: a plausible answer would be half a cell off."""
    frame = drawn(places_of(kind, 16.4), *disc(radius, 0.2), peak=700.0)
    with pytest.raises(InputError, match="stopped down if micro-images overlap"):
        fit_lattice(frame)


@pytest.mark.long
def test_a_fine_lattice_is_written_and_read_and_a_finer_one_is_refused(tmp_path: Any) -> None:
    """Rows of a hexagonal array of 4.4 px are 3.8 px apart."""
    fit = fit_lattice(drawn(places_of("hexagonal", 4.4), *spot(1.1)))
    save_lattice(fit, tmp_path)
    assert load_lattice(tmp_path / "lattice.json").row_pitch_px == pytest.approx(4.4 * 0.75**0.5, abs=1e-3)
    with pytest.raises(InputError, match=r"row_pitch_px: expected a number ≥ 3|white image"):
        fit_lattice(drawn(places_of("square", 5.4, 0.5), *spot(0.6)))


def situation(seed: int) -> tuple[NDArray[np.uint16], Array, str, float, float]:
    """Return a random white image: frame, places, kind, pitch and ratio of rows."""
    rng = np.random.default_rng(seed)
    kind = ("hexagonal", "square")[seed % 2]
    ratio = float(rng.choice([1.0, 1.0, 1.07, 1.3, 1.8, 1 / 1.3])) if kind == "square" else 1.0
    pitch = float(rng.uniform(8, 26)) / min(1.0, ratio)
    degrees = float(rng.uniform(-12, 12))
    places = places_of(kind, pitch, ratio, degrees)
    small = pitch * min(1.0, ratio)
    round_ = rng.random() < 0.5
    size = spot(float(rng.uniform(0.06, 0.16)) * small + 0.5) if round_ else disc(rng.uniform(0.3, 0.47) * small)
    lit = rng.choice(["all", "all", *LIT])
    light = np.ones(SHAPE) if lit == "all" or small > 14 else LIT[str(lit)].astype(float)
    share = rng.uniform(0.7, 1.0, len(places)) * (rng.random(len(places)) > 0.03)
    peak = float(rng.choice([300.0, 1000.0, 3000.0]))
    frame = drawn(places, *size, light=light, share=share, peak=peak, seed=seed)
    return frame, places[share > 0], kind, pitch, ratio


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(60))
def test_random_situations(seed: int) -> None:
    frame, places, kind, pitch, ratio = situation(seed)
    fit = fit_lattice(frame)
    assert fit.kind == kind
    across = 0.75**0.5 if kind == "hexagonal" else ratio
    assert (fit.pitch_px, fit.row_pitch_px) == pytest.approx((pitch, pitch * across), rel=3e-3)
    assert worst(fit, places) < 0.15


REAL = Path(__file__).parents[3] / "shared/data/lfm_guv"
DRAWN = (300, 380)


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")
@pytest.mark.long
@pytest.mark.parametrize("dark", [True, False])
def test_a_real_specimen_is_refused_and_the_real_white_image_has_no_warnings(dark: bool) -> None:
    from lfcal.frames import read_image

    level: Any = read_image(REAL / "DarkFrame_GUVExperim1.tif") if dark else 0.0
    with pytest.raises(InputError, match="specimen"):
        fit_lattice(read_image(REAL / "Lightfield_GUVExperim1.tif"), dark=level)
    assert fit_lattice(read_image(REAL / "Radiometry_GUVExperim1.tif"), dark=level).notes == ()


WHITE: dict[str, dict[str, Any]] = {
    "brightness scatters by 15 %": {"scatter": 0.15},
    "three types": {"pitch": 22.3, "edges": (0.7, 2.0, 3.3)},
    "noise": {"snr": 3.0},
    "cores saturated": {"full": 0.6},
    "gradient": {"light": lambda x, y: 1 + 0.7 * x},
    "falls to a fifth": {"falloff": 0.8},
    "half lit": {"light": lambda x, y: (x > 0.02).astype(float)},
}


@pytest.mark.long
@pytest.mark.parametrize("name", WHITE)
def test_white_images_of_many_kinds_have_no_warnings(name: str) -> None:
    truth = draw_white(DRAWN, dark=0.0, **WHITE[name])
    fit = fit_lattice(truth.frame)
    assert [note for note in fit.notes if "extrapolated elsewhere" not in note] == []
    assert fit.pitch_px == pytest.approx(truth.pitch, abs=0.01)


def fermi(distance: Any, width: float) -> Any:
    return 1 / (1 + np.exp(np.clip(distance / width, -50, 50)))


def bell(x: Any, y: Any) -> Any:
    """Light of a beam, two percent in the corners: a polynomial of it would fall too fast or too slowly there."""
    return np.exp(-2 * (x * x + y * y))


def half(x: Any, y: Any) -> Any:
    """Light of the right half: no places fix a flexible lattice in the dark half."""
    return (x > 0.02).astype(float)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("light", "kind", "seed"),
    [
        (lambda x, y: fermi(np.hypot(x, y) - 0.8, 0.05), "hexagonal", 4),
        (lambda x, y: fermi(-x - 0.2, 0.08), "hexagonal", 6),
        (bell, "hexagonal", 0),
        (bell, "hexagonal", 2),
        (bell, "square", 0),
        (bell, "square", 4),
        (half, "square", 0),
        (half, "square", 3),
    ],
)
def test_uneven_light_does_not_bend_a_straight_lattice(light: Any, kind: str, seed: int) -> None:
    truth = draw_white(DRAWN, kind=kind, dark=0.0, light=light, seed=seed)
    fit = fit_lattice(truth.frame)
    assert fit.form == "affine"
    assert np.hypot(*truth.errors(fit.centres_px(*fit.index[~fit.dead].T)).T).max() < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("size", [8.0, 30.0])
def test_drawn_specimens_are_refused(size: float) -> None:
    white = draw_white(DRAWN, dead=0.0, dark=0.0).frame
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=DRAWN), (0, 0), size)
    with pytest.raises(InputError, match=r"^[^\n]*specimen[^\n]*$"):
        fit_lattice(white * np.exp(0.4 * grain / grain.std()))


def test_cells_of_a_tissue_cause_a_warning() -> None:
    rng = np.random.default_rng(2)
    cells = np.array([((i + 0.5 * (j % 2)) * 16, j * 13.9) for i in range(-2, 28) for j in range(-2, 26)])
    y, x = np.mgrid[: DRAWN[0], : DRAWN[1]]
    near, _ = cKDTree(cells + rng.normal(0, 0.8, cells.shape)).query(np.stack([x, y], -1).reshape(-1, 2), k=2)
    wall = np.clip((near[:, 1] - near[:, 0]).reshape(DRAWN) / 5, 0, 1)
    notes = fit_lattice(1000 * wall + rng.normal(0, 20, DRAWN)).notes
    assert any("more than noise explains" in note for note in notes)


def test_evenness_by_hand() -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(20), np.arange(16)))
    index, places = np.stack([q, r], -1), 10.0 * np.stack([r, q], -1)
    alive = np.ones(len(q), bool)
    alternating = 100.0 * (1 + 0.2 * (-1.0) ** (q + r))
    found = evenness(index, alternating, alive, places)
    assert found.shared == 0.0 and found.scatter > 0.1
    blocks = 100.0 * (1 + 0.3 * (-1.0) ** (q // 2 + r // 2))
    assert evenness(index, blocks, alive, places).shared > 0.1
    even = evenness(index, np.full(len(q), 100.0), alive, places)
    assert max(even.shared, even.scatter) < 1e-6


def test_each_warning_is_one_line() -> None:
    assert check_white(Evenness(0.01, 0.05), 0.03, 0.2, 15.0) == ()
    notes = check_white(Evenness(0.06, 0.25), 0.6, 0.2, 15.0)
    assert len(notes) == 3 and all("\n" not in note for note in notes)


ROTATION, CENTRE, FRAME = 0.03, np.array([47.3, 53.6]), (96, 108)


def inside(x, y, blades, radius, turn):
    """Return where a polygon of the area of a disc lies, a disc where it has no blades."""
    if not blades:
        return np.hypot(x, y) < radius
    apothem = radius * math.sqrt(math.pi / (blades * math.tan(math.pi / blades)))
    corner = np.mod(np.arctan2(y, x) - turn, 2 * math.pi / blades) - math.pi / blades
    return np.hypot(x, y) * np.cos(corner) < apothem


def basis(kind, pitch):
    step = math.pi / 3 if kind == "hexagonal" else math.pi / 2
    angles = np.array([ROTATION, ROTATION + step])
    return pitch * np.stack([np.cos(angles), np.sin(angles)], -1)


def iris_frame(kind, pitch, blades, fill, *, turn=0.2, over=4, noise=0.0):
    """Return an antialiased frame of micro-images, which add where they overlap."""
    rows, columns = ((np.arange(n * over) + 0.5) / over - 0.5 for n in FRAME)
    x, y = columns[None] - CENTRE[1], rows[:, None] - CENTRE[0]
    vectors = basis(kind, pitch)
    cell = np.stack(np.broadcast_arrays(x, y), -1) @ np.linalg.inv(vectors)
    part = cell - np.floor(cell)
    light = np.zeros(cell.shape[:2])
    for q in (-1, 0, 1, 2):
        for r in (-1, 0, 1, 2):
            away = (part - (q, r)) @ vectors
            light += inside(away[..., 0], away[..., 1], blades, fill * pitch / 2, turn)
    fine = ndimage.gaussian_filter(light, 0.6 * over)
    frame = 3000 * fine.reshape(FRAME[0], over, FRAME[1], over).mean((1, 3)) + 64
    return frame + noise * np.random.default_rng(0).standard_normal(FRAME)


def off_centre(fit, kind, pitch):
    """Return (row, column) from the true lattice to the fitted one."""
    away = np.array(fit.origin_px) - CENTRE
    vectors = basis(kind, pitch)[:, ::-1]
    return away - np.rint(away @ np.linalg.inv(vectors)) @ vectors


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("kind", "blades", "fill"),
    [("hexagonal", 7, 0.98), ("hexagonal", 5, 0.9), ("hexagonal", 5, 1.03), ("square", 5, 1.03), ("square", 9, 1.03)],
)
def test_the_centre_is_that_of_the_iris_and_not_that_of_symmetry(kind, blades, fill):
    fit = fit_lattice(iris_frame(kind, 11.0, blades, fill), dark=64.0)
    assert np.abs(off_centre(fit, kind, 11.0)).max() < 0.004  # a tenth of a pixel and more without
    assert max(fit.errors.origin_px) < 0.01
    apart = np.array(fit.measured_px) - np.array([fit.centres_px(*index) for index in fit.index]).reshape(-1, 2)
    assert np.abs(np.nanmedian(apart, axis=0)).max() < 0.02  # the places came along


def test_an_iris_with_a_centre_of_symmetry_keeps_it() -> None:
    for blades in (0, 6):
        fit = fit_lattice(iris_frame("hexagonal", 11.0, blades, 0.98), dark=64.0)
        assert np.abs(off_centre(fit, "hexagonal", 11.0)).max() < 0.004, blades


def test_noise_and_iris_are_in_the_stated_error() -> None:
    for noise, most in ((60.0, 0.03), (150.0, 0.08)):
        fit = fit_lattice(iris_frame("hexagonal", 11.0, 7, 0.95, noise=noise), dark=64.0)
        off = np.abs(off_centre(fit, "hexagonal", 11.0))
        assert (off < 4 * np.array(fit.errors.origin_px)).all() and max(fit.errors.origin_px) < most
        # more than the residuals alone, because the iris is known less well
        assert fit.errors.origin_px[0] > 2 * fit.residual_rms_px / math.sqrt(len(fit.index)) or noise > 100


def test_the_transform_of_a_polygon_is_that_of_its_pixels() -> None:
    at = (np.arange(1200) + 0.5) / 60 - 10
    x, y = at[None], at[:, None]
    for blades in (5, 6, 7):
        drawn = inside(x, y, blades, 4.0, 0.3)
        for wave in ((0.1, 0.02), (-0.05, 0.12), (0.2, -0.17)):
            summed = (drawn * np.exp(-2j * np.pi * (wave[0] * x + wave[1] * y))).sum() / drawn.sum()
            ((transform,),) = _transforms(np.array([wave]), blades, np.array([4.0]), np.array([0.3]))
            assert abs(transform - summed) < 2e-3, (blades, wave)
