"""Beads and lines fitted on a frame have the uncertainties that they claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.psf import Facts, PSFMatrix
from lfcal.reconstruct import Feature, FeatureFit, Projector, SolverChoice, find_beads, fit_features, reconstruct
from lfcal.reconstruct._feature_shapes import Shape
from lfcal.reconstruct.feature_run import plane_of
from lfcal.simulate import simulate_psf

SHAPE = (77, 77)
EDGE = 14
PLANES = (2.2, 2.5, 2.8, 3.1, 3.4)
"""Virtual depths of H."""
BETWEEN = (2.65, 2.95)
"""Virtual depths of objects: between planes 1 and 2, and between 2 and 3."""
CHOICE = SolverChoice("rl-nesterov", iterations=60, background=10, gain=1)


def camera() -> Camera:
    """Return the camera ``bench`` with square lenslets of one type."""
    found = preset("bench")
    return replace(found, lattice=replace(found.lattice, kind="square", types=found.lattice.types[1:2]))


def projector(depths: tuple[float, ...]) -> Projector:
    """Return the projector of H at virtual ``depths``, without entries below a thousandth."""
    own = camera()
    plan = ScanPlan(own, (11, 11), cutout=(45, 45), depths_um=tuple(map(own.depth_of, depths)), anchor=(137, 137))
    values = np.asarray(simulate_psf(plan, tolerance=0.02)[:], np.float32)
    values = np.where(values > 1e-3 * values.max(axis=(1, 2, 3, 4), keepdims=True), values, 0)
    return Projector(values, SHAPE, anchor=(5, 5), workers=1)


@pytest.fixture(scope="module")
def P() -> Projector:
    return projector(PLANES)


@pytest.fixture(scope="module")
def between() -> Projector:
    """Return the projector at depths that H does not contain."""
    return projector(BETWEEN)


def spots(beads: np.ndarray, planes: int, width: float = 1.0) -> np.ndarray:
    """Return beads ``(n, 4)`` (brightness, row, column, plane) as a volume ``(planes, Y, X)``."""
    y, x = np.indices(SHAPE)
    volume = np.zeros((planes, *SHAPE))
    for light, row, column, plane in beads:
        profile = np.exp(-((y - row) ** 2 + (x - column) ** 2) / (2 * width**2)) / (2 * np.pi * width**2)
        volume[int(plane)] += light * profile
    return volume


def stroke(line: np.ndarray, planes: int) -> np.ndarray:
    """Return a line (brightness, row, column, plane, width, end row, end column), summed from 400 spots."""
    light, row, column, plane, width, end_row, end_column = line
    points = [
        (light / 400, row + t * (end_row - row), column + t * (end_column - column), plane)
        for t in (np.arange(400) + 0.5) / 400
    ]
    return spots(np.array(points), planes, width)


def places(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return positions ``(count, 2)`` that are more than 7 voxels apart."""
    found: list[np.ndarray] = []
    while len(found) < count:
        one = rng.uniform(EDGE + 5, SHAPE[0] - EDGE - 5, 2)
        if all(np.hypot(*(one - other)) > 7 for other in found):
            found.append(one)
    return np.array(found)


def haze(rng: np.random.Generator, planes: int) -> np.ndarray:
    """Return smooth light in all planes, in which a bead of brightness 1 is about as bright as its background."""
    y, x = np.indices(SHAPE)
    inner = (np.minimum(y, x) >= EDGE) & (np.maximum(y, x) < SHAPE[0] - EDGE)
    fields = [np.clip(12 * gaussian_filter(rng.standard_normal(SHAPE), 4) + 0.5, 0, None) for _ in range(planes)]
    return 0.0012 * np.array(fields) * inner


def pulls(fit: FeatureFit, true: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Return the errors of the features in units of their uncertainties, ``(n, len(names))``."""
    rows = []
    for one, values in zip(fit.features, true, strict=True):
        found = {name: getattr(one.feature, name, None) for name in names}
        if one.feature.end is not None:
            found |= {"end_row": one.feature.end[0], "end_column": one.feature.end[1]}
        rows.append([(found[name] - value) / one.sigmas[name] for name, value in zip(names, values, strict=True)])
    return np.array(rows)


BEAD = ("brightness", "row", "column", "plane")
LINE = ("brightness", "row", "column", "plane", "width", "end_row", "end_column")


def beads_over(
    P: Projector, between: Projector, seed: int, peak: float, *, over: bool
) -> tuple[np.ndarray, np.ndarray, list[Feature], np.ndarray]:
    """Return a frame of beads between planes, over nothing or ``over`` haze.

    The other results are the true beads ``(6, 4)``, inexact positions, and the haze.
    """
    rng = np.random.default_rng([seed, over])
    plane = rng.integers(2, size=6)
    beads = np.column_stack([rng.uniform(0.4, 1, 6), places(rng, 6), plane])
    rest = over * haze(rng, 5)
    light = between.forward(spots(beads, 2)) + P.forward(rest)
    scale = peak / light.max()
    frame = rng.poisson(np.maximum(scale * light, 0) + 10.0)
    starts = [Feature(*(one[1:3] + rng.normal(0, 0.5, 2)), width=1.0) for one in beads]
    # planes 1.5 and 2.5
    return frame, beads * [scale, 1, 1, 1] + [0, 0, 0, 1.5], starts, scale * rest


def beads_of(P: Projector, between: Projector, seed: int, peak: float, *, over: bool) -> np.ndarray:
    """Return the pulls ``(6, 4)`` of the beads of `beads_over`."""
    frame, true, starts, _ = beads_over(P, between, seed, peak, over=over)
    return pulls(fit_features(P, frame, starts, CHOICE), true, BEAD)


def lines_of(P: Projector, seed: int, peak: float) -> np.ndarray:
    """Return the pulls ``(3, 7)`` of lines in three planes."""
    rng = np.random.default_rng([seed, 2])
    lines = []
    for plane in (1, 2, 3):
        angle, half, middle = rng.uniform(0, np.pi), rng.uniform(8, 14), rng.uniform(30, 47, 2)
        to = half * np.array([np.sin(angle), np.cos(angle)])
        lines.append([rng.uniform(0.4, 1) * half, *(middle - to), plane, rng.uniform(0.8, 2), *(middle + to)])
    true = np.array(lines)
    light = P.forward(sum(stroke(one, 5) for one in true))
    scale = peak / light.max()
    frame = rng.poisson(scale * light + 10.0)
    starts = [Feature(*(one[1:3] + rng.normal(0, 0.5, 2)), end=tuple(one[5:] + rng.normal(0, 0.5, 2))) for one in true]
    return pulls(fit_features(P, frame, starts, CHOICE), true * [scale, 1, 1, 1, 1, 1, 1], LINE)


@pytest.mark.long
def test_beads_between_planes(P: Projector, between: Projector) -> None:
    found = beads_of(P, between, 1, 2000, over=False)
    assert np.isfinite(found).all() and np.abs(found).max() < 4, found
    assert 0.4 < np.sqrt(np.mean(found**2)) < 1.6, found


@pytest.mark.long
def test_bright_beads_over_haze_have_uncertainties(P: Projector, between: Projector) -> None:
    """The noise of the reconstructed haze was taken for a misfit of the beads."""
    found = beads_of(P, between, 1, 20000, over=True)
    assert np.isfinite(found).all() and np.abs(found).max() < 4, found


@pytest.mark.long
def test_the_rest_has_uncertainties_also_around_the_features(P: Projector, between: Projector) -> None:
    frame, true, starts, haze = beads_over(P, between, 2, 2000, over=True)
    bars = fit_features(P, frame, starts, CHOICE, replicates=5).bars
    assert bars is not None and bars.replicates == 5
    y, x = np.indices(SHAPE)
    near = np.min([np.hypot(y - row, x - column) for _, row, column, _ in true], axis=0) < 4
    bright = haze > 0.1 * haze.max()
    for some in (bright, bright & near):
        shares = [
            np.mean((low <= haze) & (haze <= high), where=some) for low, high in map(bars.interval, (0.6827, 0.95))
        ]
        assert 0.55 < shares[0] < 0.9 and shares[1] > 0.85, shares


@pytest.mark.long
def test_lines_with_their_widths_and_ends(P: Projector) -> None:
    found = lines_of(P, 1, 2000)
    assert np.isfinite(found).all() and np.abs(found).max() < 4, found
    assert 0.4 < np.sqrt(np.mean(found**2)) < 1.6, found


def one_bead(P: Projector, light: float, width: float = 1.0) -> np.ndarray:
    """Return the expected frame of a bead in plane 2."""
    return np.asarray(P.forward(spots(np.array([[light, 37.4, 39.8, 2]]), 5, width)) + 10.0, np.float64)


@pytest.mark.long
def test_a_model_that_the_frame_contradicts_has_no_uncertainty(P: Projector) -> None:
    """A bead of twice the stated width is found out, and fits if its width is fitted."""
    rng = np.random.default_rng(1)
    frame = rng.poisson(one_bead(P, 4e6, 2.0))
    start = Feature(37, 40, 2)
    (wrong,) = fit_features(P, frame, [replace(start, width=1.0)], CHOICE).features
    assert not wrong.fits and np.isnan(wrong.sigmas["row"]) and np.isnan(wrong.sigmas["depth_um"])
    (right,) = fit_features(P, frame, [start], CHOICE).features
    assert right.fits and right.feature.width == pytest.approx(2, abs=5 * right.sigmas["width"])
    assert 0 < right.sigmas["width"] < 0.05


def test_a_bead_beyond_the_planes_has_no_uncertainty(P: Projector) -> None:
    """A bead a whole plane before the first is not measured; one in the first plane is."""
    rng = np.random.default_rng(1)
    near = Projector(P._reader.H[1:], SHAPE, anchor=(5, 5), workers=1)
    for plane, fits in ((0, False), (1, True)):
        frame = rng.poisson(P.forward(spots(np.array([[3e5, 37.4, 39.8, plane]]), 5)) + 10.0)
        (one,) = fit_features(near, frame, [Feature(37, 40, width=1.0)], CHOICE).features
        assert one.fits == fits and np.isnan(one.sigmas["row"]) != fits
    assert abs(one.feature.plane) < 4 * one.sigmas["plane"] < 0.5


def test_a_bead_that_leaves_the_volume_does_not_excuse_the_others() -> None:
    """It has no light in the frame, so its misfit scatters widely; the limit for all features was too large."""
    spot = np.exp(-(np.hypot(*np.mgrid[-7:8, -7:8]) ** 2) / 8)
    P = Projector((spot / spot.sum())[None, None, None], (46, 50), workers=1)
    y, x = np.mgrid[-3:43, -3:47]

    def bead(row: float, column: float, light: float) -> np.ndarray:
        return light * np.exp(-((y - row) ** 2 + (x - column) ** 2) / 2) / (2 * np.pi)

    ring = sum(bead(row, column, 3000) for row, column in ((20, 16), (20, 24), (16, 20), (24, 20)))
    frame = np.random.default_rng(0).poisson(P.forward((ring + bead(-3, -3, 20000) + 10)[None])[3:-3, 3:-3])
    frame[0, 20] += 400
    choice = SolverChoice("rl-nesterov", iterations=30, gain=1, margin=3)
    for other in ((0, 20), (0, 0)):
        wrong, edge = fit_features(P, frame, [Feature(20, 20, width=1.5), Feature(*other)], choice).features
        assert not wrong.fits and wrong.limit < 2
        assert -3.5 <= edge.feature.row <= 42.5 and -3.5 <= edge.feature.column <= 46.5


def test_positions_stay_in_the_volume() -> None:
    bead, line = Shape((1.0, 1.0, 2.0, 0.0, 1.0), (1, 2)), Shape((1.0, 1.0, 2.0, 0.0, 1.0, 8.0, 9.0), (5, 6))
    ends = bead.moved(np.array([-9.0, 0.0]), (1, 10, 12), 0).moved(np.array([-9.0, 0.0]), (1, 10, 12), 0)
    assert ends.values[1:3] == (-0.5, 2.0) and ends.at_a_limit((1, 10, 12)) and not bead.at_a_limit((1, 10, 12))
    for _ in range(4):
        line = line.moved(np.array([5.0, 5.0]), (1, 10, 12), 0)
    assert line.values[5:] == (9.5, 11.5) and line.at_a_limit((1, 10, 12))


def test_a_frame_below_its_background_is_refused() -> None:
    P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (20, 20), workers=1)
    with pytest.raises(InputError, match="expected light above the background of 100, got a volume without light"):
        fit_features(P, np.full((20, 20), 60.0), [Feature(9, 9)], SolverChoice("rl", 3, background=100, gain=1))


@pytest.mark.parametrize(
    ("depths", "depth", "plane"),
    [
        ([1234.5678], 1234.57, 0.0),
        ([1234.5678], 1234.5678, 0.0),
        ([0.0, 1234.5678], 1851.85, 1.5),
        ([-1234.5678, 0.0], -1851.86, -0.5),
        ([-1234.5678, 0.0], -617.2839, 0.5),
    ],
)
def test_a_written_depth_is_read(depths: list[float], depth: float, plane: float) -> None:
    """A written depth has six digits, and was refused if rounding moved it beyond the planes."""
    assert plane_of(depth, np.array(depths)) == pytest.approx(plane, abs=1e-4)
    with pytest.raises(InputError, match="depth of a feature"):
        plane_of(depth + 1e4, np.array(depths))


@pytest.mark.long
def test_uncertainties_fall_with_the_light(P: Projector) -> None:
    """Without other light, positions are limited by photon noise: 100 times the light, a tenth of the sigma."""
    rng = np.random.default_rng(1)
    dim, bright = (
        fit_features(P, rng.poisson(one_bead(P, light)), [Feature(37, 40, 2, width=1.0)], CHOICE).features[0]
        for light in (3e4, 3e6)
    )
    assert dim.sigmas["row"] == pytest.approx(10 * bright.sigmas["row"], rel=0.35)
    assert bright.sigmas["brightness"] / 3e6 < 0.2 * dim.sigmas["brightness"] / 3e4


def test_beads_are_found(P: Projector) -> None:
    """All bright beads are found once, and a smooth object has none."""
    rng = np.random.default_rng(3)
    beads = np.column_stack([rng.uniform(0.5, 1, 6), places(rng, 6), rng.integers(1, 4, 6)])
    light = P.forward(spots(beads, 5))
    frame = rng.poisson(2000 * light / light.max() + 10.0)
    found = find_beads(reconstruct(P, frame, CHOICE).volume)
    assert len(found) == 6
    away = [min(np.hypot(one.row - row, one.column - column) for one in found) for _, row, column, _ in beads]
    assert max(away) < 1.5
    fit = fit_features(P, frame, None, CHOICE)
    assert [one.fits for one in fit.features] == [True] * 6
    y, x = np.indices(SHAPE)
    smooth = np.exp(-((y - 38) ** 2 + (x - 38) ** 2) / 200) * np.ones((5, 1, 1))
    assert find_beads(smooth) == ()
    with pytest.raises(InputError, match=r"no bead"):
        fit_features(P, 100 * P.forward(smooth / P.forward(smooth).max()) + 10, None, CHOICE)


@pytest.mark.long
def test_errors_of_h_are_included(P: Projector) -> None:
    """With an H whose scale is uncertain by 5 %, the brightness is uncertain by 5 %, and positions are not."""
    frame = np.random.default_rng(1).poisson(one_bead(P, 4e6))
    starts = [Feature(37, 40, 2, width=1.0)]
    H = np.asarray(P._reader.H[:])

    def imaging(rng: np.random.Generator) -> Projector:
        return Projector(H * (1 + 0.05 * rng.standard_normal()), SHAPE, anchor=(5, 5), workers=1)

    (exact,) = fit_features(P, frame, starts, CHOICE).features
    (uncertain,) = fit_features(P, frame, starts, CHOICE, imaging=imaging).features
    assert exact.sigmas["brightness"] < 0.01 * exact.feature.brightness
    # eight random H
    assert uncertain.sigmas["brightness"] == pytest.approx(0.05 * 4e6, rel=0.5)
    assert uncertain.sigmas["row"] == pytest.approx(exact.sigmas["row"], rel=0.2)


@pytest.mark.long
def test_noise_of_a_recorded_matrix_is_included(P: Projector) -> None:
    """A bright bead is limited by the noise of H: its position is wrong by more than the noise of the frame."""
    rng = np.random.default_rng(5)
    values = np.asarray(P._reader.H[:], np.float64)
    scale = 400 / values.max()
    counts = rng.poisson(values * scale) + 2.0 * rng.standard_normal(values.shape)
    where = values.shape[:3]
    facts = Facts.of(where, values.shape[3:], noise=np.tile([4.0, 1.0], (*where, 1)))
    recorded = Projector(PSFMatrix(counts.astype(np.float32), facts=facts, anchor=(5, 5)), SHAPE, workers=1)
    frame = rng.poisson(one_bead(P, 1e6))
    starts = [Feature(37, 40, 2, width=1.0)]
    (noisy,) = fit_features(recorded, frame, starts, CHOICE).features
    (exact,) = fit_features(P, frame, starts, CHOICE).features
    assert noisy.fits and noisy.sigmas["row"] > 2 * exact.sigmas["row"]
    for name, true in (("row", 37.4), ("column", 39.8), ("plane", 2.0)):
        assert abs(getattr(noisy.feature, name) - true) < 4 * noisy.sigmas[name]


@pytest.mark.long
def test_margin_and_missing_pixels(P: Projector) -> None:
    """Positions are those in the frame with any margin, and pixels without a value are left out."""
    frame = np.random.default_rng(1).poisson(one_bead(P, 1e6)).astype(float)
    frame[36:38, 36:44] = np.nan
    starts = [Feature(37, 40, 2, width=1.0)]
    wide = Projector(P._reader.H, (SHAPE[0] + 22, SHAPE[1] + 22), anchor=(16, 16), workers=1)
    fit = fit_features(wide, frame, starts, replace(CHOICE, margin=11))
    (one,) = fit.features
    assert fit.rest.shape == (5, *SHAPE) and one.fits
    for name, true in (("row", 37.4), ("column", 39.8), ("plane", 2.0), ("brightness", 1e6)):
        assert abs(getattr(one.feature, name) - true) < 4 * one.sigmas[name]


@pytest.mark.parametrize(
    ("features", "words"),
    [
        ([], "no bead"),
        ([Feature(90, 40)], "inside of the frame"),
        ([Feature(30, 40, 5.0)], "plane"),
        ([Feature(30, 40), Feature(30.2, 40.1)], "apart"),
        ([Feature(30, 40, width=0.1)], "width"),
        ([Feature(30, 40, brightness=-3)], "brightness"),
        ([Feature(30, float("nan"))], "inside of the frame"),
        ([Feature(30, 40, end=(30.5, 40))], "length"),
    ],
)
def test_features_that_cannot_be_fitted_are_refused(P: Projector, features: list[Feature], words: str) -> None:
    frame = np.random.default_rng(1).poisson(one_bead(P, 1e5))
    with pytest.raises(InputError, match=words):
        fit_features(P, frame, features, CHOICE)


@pytest.mark.long
@pytest.mark.parametrize("peak", [200, 2000, 20000])
@pytest.mark.parametrize("kind", ["beads", "beads in haze", "lines"])
def test_gate(P: Projector, between: Projector, kind: str, peak: float) -> None:
    """Intervals of 68 and 95 % contain the truth in 56 to 80 % and at least 88 %, if H is exact but for its planes."""
    if kind == "lines":
        some = [lines_of(P, seed, peak) for seed in range(200, 220)]
    else:
        some = [beads_of(P, between, seed, peak, over=kind != "beads") for seed in range(200, 212)]
    all_pulls = np.abs(np.concatenate(some))
    fitted = np.isfinite(all_pulls[:, 0])
    inside = [100 * np.mean(all_pulls[fitted] < limit) for limit in (1.0, 1.96)]
    print(f"{kind}, {peak:g} e-: {fitted.sum()} of {len(fitted)} fit, 68: {inside[0]:.0f}, 95: {inside[1]:.0f}")
    assert fitted.mean() > 0.85 and abs(inside[0] - 68) < 12 and abs(inside[1] - 95) < 7
