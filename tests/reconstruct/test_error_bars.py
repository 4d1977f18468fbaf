"""Error bars of a volume contain the truth as often as they claim."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter, uniform_filter

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.psf import Facts, PSFMatrix
from lfcal.reconstruct import BootstrapSettings, Projector, SolverChoice, error_bars, save_volume
from lfcal.reconstruct._replicates import ObjectModel, SampleNoise
from lfcal.reconstruct.bar_run import USUAL_ITERATIONS
from lfcal.reconstruct.error_bars import runs_of
from lfcal.reconstruct.volumes import load_labels
from lfcal.simulate import simulate_psf
from tests.reconstruct._building import square, square_matrix

SHAPE = (77, 77)
EDGE = 14
KINDS = ("beads", "texture", "lines", "shell", "plume")
CHOICE = SolverChoice("rl-nesterov", iterations=60, background=10, gain=1)


def without_dim_entries(values: np.ndarray) -> np.ndarray:
    """Return H without entries below a thousandth of the peak of their plane."""
    return np.where(values > 1e-3 * values.max(axis=(1, 2, 3, 4), keepdims=True), values, 0)


def matrix(camera: Camera, depths: tuple[float, ...], cutout: int = 45, tolerance: float = 0.02) -> np.ndarray:
    """Return H of ``camera`` for the image planes of ``depths`` (µm)."""
    period, anchor = ((11, 11), (137, 137)) if len(camera.lattice.types) == 1 else ((19, 33), (133, 132))
    plan = ScanPlan(camera, period, cutout=(cutout, cutout), depths_um=depths, anchor=anchor)
    return without_dim_entries(np.asarray(simulate_psf(plan, effects=(), tolerance=tolerance)[:], np.float32))


def projector(H: np.ndarray | PSFMatrix) -> Projector:
    return Projector(H, SHAPE, anchor=(5, 5), workers=1)


@pytest.fixture(scope="module")
def P() -> Projector:
    """Return the projector of two planes behind square lenslets."""
    return projector(without_dim_entries(square_matrix((2.2, 3.0), 41)))


def drawn(kind: str, seed: int, planes: int) -> np.ndarray:
    """Return an object ``(planes, Y, X)`` that is zero near the edges."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(SHAPE)
    inner = (np.minimum(y, x) >= EDGE) & (np.maximum(y, x) < SHAPE[0] - EDGE)
    g = np.zeros((planes, *SHAPE))
    if kind == "beads":
        for _ in range(14):
            g[rng.integers(planes), *rng.integers(EDGE + 3, SHAPE[0] - EDGE - 3, 2)] += rng.uniform(0.4, 1)
        g = gaussian_filter(g, (0, 1, 1))
    elif kind == "texture":
        g = 0.1 + np.clip([10 * gaussian_filter(rng.standard_normal(SHAPE), 3) for _ in g], 0, None)
    elif kind == "lines":
        for _ in range(7):
            z, angle, width = rng.integers(planes), rng.uniform(0, np.pi), rng.uniform(0.8, 2)
            row, column = rng.uniform(EDGE + 8, SHAPE[0] - EDGE - 8, 2)
            across = (y - row) * np.cos(angle) - (x - column) * np.sin(angle)
            g[z] += rng.uniform(0.4, 1) * np.exp(-(across**2) / (2 * width**2))
    elif kind == "shell":
        for _ in range(3):
            row, column = rng.uniform(EDGE + 10, SHAPE[0] - EDGE - 10, 2)
            radius, light = rng.uniform(7, 13), rng.uniform(0.5, 1)
            for z in range(planes):
                r = np.sqrt((6 * (z - (planes - 1) / 2)) ** 2 + (y - row) ** 2 + (x - column) ** 2)
                g[z] += light * np.exp(-((r - radius) ** 2) / 4.5)
    else:
        for z in range(planes):
            (row, column), size = rng.uniform(30, 47, 2), rng.uniform(7, 13)
            g[z] = rng.uniform(0.4, 1) * np.exp(-((y - row) ** 2 + (x - column) ** 2) / (2 * size**2))
    return g * inner


def boxes(volume: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return labels of regions where ``volume`` is bright: squares in one plane, and columns through all planes."""
    labels = np.zeros(volume.shape, int)
    for size, through in ((5, False), (11, False), (9, True)) * 4:
        mean = uniform_filter(volume.sum(0, keepdims=True) if through else volume, (0, size, size))
        lit = mean[:, EDGE + size // 2 : -EDGE - size // 2, EDGE + size // 2 : -EDGE - size // 2]
        bright = np.argwhere(lit > 0.2 * lit.max())
        z, y, x = bright[rng.integers(len(bright))]
        planes = slice(None) if through else slice(z, z + 1)
        box = labels[planes, y + EDGE : y + EDGE + size, x + EDGE : x + EDGE + size]
        if not box.any():
            box[:] = labels.max() + 1
    return labels


def covered(
    P: Projector, kind: str, seed: int, peak: float, imaging: Callable[[np.random.Generator], Projector] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return for bright voxels, and for regions, whether the intervals of 68 and 95 % contain the truth, ``(n, 2)``."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    truth = drawn(kind, 1000 * seed + KINDS.index(kind), P.volume_shape[0])
    truth *= peak / P.forward(truth).max()
    frame = rng.poisson(np.maximum((P if imaging is None else imaging(rng)).forward(truth), 0) + 10.0)
    # regions are chosen on another reconstruction of the frame
    seen = error_bars(P, frame, replace(CHOICE, iterations=15), BootstrapSettings(replicates=3)).volume
    labels = boxes(seen, rng)
    bars = error_bars(P, frame, CHOICE, BootstrapSettings(seed=seed), labels=labels, imaging=imaging)
    inner = np.zeros(truth.shape, bool)
    inner[:, EDGE:-EDGE, EDGE:-EDGE] = True
    bright = inner & (seen > 0.05 * seen.max())
    voxels, sums = [], []
    for level in (0.6827, 0.95):
        low, high = bars.interval(level)
        voxels.append(((low <= truth) & (truth <= high))[bright])
        ends = [(one.interval(level), truth[labels == one.label].sum()) for one in bars.regions]
        sums.append([low <= true <= high for (low, high), true in ends])
    return np.transpose(voxels), np.transpose(sums)


def shares(found: list[np.ndarray]) -> np.ndarray:
    """Return the mean over scenes, with equal weights, of the fractions of 68 and 95 % intervals (%)."""
    return 100 * np.mean([one.mean(0) for one in found], axis=0)


@pytest.mark.long
def test_intervals_contain_the_truth(P: Projector) -> None:
    found = [covered(P, kind, 1, 2000) for kind in KINDS]
    voxels, sums = (shares([pair[k] for pair in found]) for k in range(2))
    assert abs(voxels[0] - 68) < 8 and abs(voxels[1] - 95) < 4, voxels
    assert abs(sums[0] - 68) < 20 and sums[1] > 85, sums


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(("gain", "background"), [(1.0, 10.0), (2.5, 4.0)])
def test_unknown_noise_is_estimated_from_the_frame(P: Projector, gain: float, background: float) -> None:
    """60 iterations also fit a part of the noise, which the estimate has to take into account."""
    truth = drawn("shell", 5, 2)
    truth *= 2000 / P.forward(truth).max()
    frame = gain * np.random.default_rng(2).poisson(P.forward(truth) / gain + background / gain)
    choice = replace(CHOICE, gain=None, background=background)
    unknown = error_bars(P, frame, choice, BootstrapSettings(replicates=3))
    known = error_bars(P, frame, replace(choice, gain=gain), BootstrapSettings(replicates=3))
    assert "counts per photoelectron" in unknown.notes[0] and not known.notes
    stated = float(unknown.notes[0].split("with ")[1].split()[0])
    assert stated == pytest.approx(gain, rel=0.25)
    assert np.median(unknown.sigma / known.sigma) == pytest.approx(1, abs=0.15)


@pytest.mark.long
def test_the_division_of_light_between_equal_planes_is_uncertain(P: Projector) -> None:
    """How the light is divided between two equal planes of H cannot be known, but their sum can."""
    plane = np.asarray(P._reader.H[:1])
    twice = projector(np.concatenate([plane, plane]))
    truth = drawn("shell", 3, 2)
    truth *= 2000 / twice.forward(truth).max()
    frame = np.random.default_rng(1).poisson(twice.forward(truth) + 10.0)
    labels = np.zeros(truth.shape, int)
    labels[0, 30:45, 30:45], labels[1, 30:45, 30:45] = 1, 2
    bars = error_bars(twice, frame, CHOICE, BootstrapSettings(replicates=4), labels=labels)
    both = error_bars(twice, frame, CHOICE, BootstrapSettings(replicates=4), labels=np.minimum(labels, 1))
    apart = error_bars(P, np.random.default_rng(1).poisson(P.forward(truth) + 10.0), CHOICE)
    inner = (slice(None), slice(25, 52), slice(25, 52))
    assert np.median(bars.kappa[inner]) > 1.3 * np.median(apart.kappa[inner])
    assert both.regions[0].sigma < 0.5 * min(one.sigma for one in bars.regions)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["plume", "shell", "texture"])
def test_bars_include_the_noise_of_a_recorded_matrix(P: Projector, kind: str) -> None:
    """Sums through all planes are wrong by several times the noise of the frame, because H is noisy."""
    values = np.asarray(P._reader.H[:], np.float64)
    rng = np.random.default_rng(4)
    scale = 100 / values.max()
    counts = rng.poisson(values * scale) + 2.0 * rng.standard_normal(values.shape)
    where = values.shape[:3]
    facts = Facts.of(where, values.shape[3:], noise=np.tile([4.0, 1.0], (*where, 1)))
    recorded = projector(PSFMatrix(counts.astype(np.float32), facts=facts, anchor=(5, 5)))
    truth = drawn(kind, 1, 2)
    truth *= 20000 / P.forward(truth).max()
    frame = rng.poisson(P.forward(truth) + 10.0)
    labels = np.zeros(truth.shape, int)
    labels[:, 25:52, 25:52] = 1
    choice = replace(CHOICE, iterations=20)
    bars = error_bars(recorded, frame, choice, BootstrapSettings(replicates=5), labels=labels)
    (region,) = bars.regions
    error = region.total * scale - truth[:, 25:52, 25:52].sum()
    assert abs(error) > 5 * region.noise * scale
    assert abs(error) < 3 * region.sigma * scale, (error, region)


def test_sums_have_a_part_due_to_the_noise_of_a_recorded_matrix() -> None:
    rng = np.random.default_rng(2)
    values = 40 + 10 * rng.random((2, 3, 3, 5, 5))
    facts = Facts.of(values.shape[:3], values.shape[3:], noise=np.tile([4.0, 0.5], (*values.shape[:3], 1)))
    parts = []
    for H in (PSFMatrix(values, facts=facts), PSFMatrix(values)):
        P = Projector(H, (30, 32), workers=1)
        frame = np.random.default_rng(3).poisson(P.forward(np.ones(P.volume_shape)))
        settings = BootstrapSettings(replicates=3)
        bars = error_bars(P, frame, SolverChoice("rl", iterations=4, gain=1), settings, labels=np.ones((30, 32), int))
        parts.append(bars.regions[0].h)
    assert parts[0] > 0 == parts[1]


def test_margins_and_missing_pixels_are_handled(P: Projector) -> None:
    wide = Projector(P._reader.H, (SHAPE[0] + 22, SHAPE[1] + 22), anchor=(16, 16), workers=1)
    truth = drawn("shell", 3, 2)
    truth *= 2000 / P.forward(truth).max()
    frame = np.random.default_rng(1).poisson(P.forward(truth) + 10.0).astype(float)
    frame[40, 40] = np.nan
    settings = BootstrapSettings(replicates=3)
    bars = error_bars(wide, frame, replace(CHOICE, margin=11), settings, labels=np.ones(SHAPE, int))
    assert bars.volume.shape == bars.sigma.shape == bars.kappa.shape == truth.shape
    assert np.isfinite(bars.sigma).all() and (bars.sigma > 0).all()
    (region,) = bars.regions
    assert region.voxels == truth.size and region.planes == (0, 1)
    assert abs(region.total - truth.sum()) < 4 * region.sigma and region.noise < region.sigma
    again = error_bars(wide, frame, replace(CHOICE, margin=11), settings)
    np.testing.assert_array_equal(again.sigma, bars.sigma)
    other = error_bars(wide, frame, replace(CHOICE, margin=11), BootstrapSettings(replicates=3, seed=1))
    assert (other.sigma != bars.sigma).any()


def test_labels_may_be_large_and_levels_are_probabilities(P: Projector) -> None:
    frame = np.random.default_rng(1).poisson(P.forward(drawn("shell", 3, 2)) * 100 + 10.0)
    labels = np.zeros(SHAPE, np.uint32)
    labels[30:40, 30:40], labels[50:60, 20:30] = 4_000_000_000, 7
    choice, settings = replace(CHOICE, iterations=3), BootstrapSettings(replicates=3)
    bars = error_bars(P, frame, choice, settings, labels=labels)
    assert [(one.label, one.voxels) for one in bars.regions] == [(7, 200), (4_000_000_000, 200)]
    for one in bars.regions:
        assert one.total == pytest.approx(bars.volume[:, labels == one.label].sum(), rel=1e-5)
    for level in (0.0, 1.0, 95, float("nan")):
        with pytest.raises(InputError, match="probability of an interval"):
            bars.interval(level)


def test_labels_belong_to_the_planes_on_which_they_were_drawn(tmp_path: Path) -> None:
    """TIFF files have planes by increasing depth, and so have labels drawn on them."""
    depths = np.array([-100.0, -300.0, -200.0])
    volume = np.arange(3.0)[:, None, None] * np.ones((3, 4, 5)) + 1
    for suffix in (".tif", ".npy", ".ome.tif"):
        save_volume(tmp_path / f"v{suffix}", volume, depths_um=depths)
        if suffix == ".npy":
            stored = np.load(tmp_path / "v.npy")
            np.save(tmp_path / "drawn.npy", stored)
        else:
            stored = tifffile.imread(tmp_path / f"v{suffix}")
            tifffile.imwrite(tmp_path / f"drawn{suffix}", stored.astype(np.uint16), photometric="minisblack")
        np.testing.assert_array_equal(load_labels(tmp_path / f"drawn{suffix}", depths), volume)
        np.testing.assert_array_equal(load_labels(tmp_path / f"v{suffix}", depths), volume)
        np.testing.assert_array_equal(load_labels(tmp_path / f"drawn{suffix}", None), stored)
    np.save(tmp_path / "large.npy", stored * 2**30)
    with pytest.raises(InputError, match="numbers up to 16777216"):
        load_labels(tmp_path / "large.npy", depths)


def test_synthetic_objects_are_rougher_than_the_volume_and_equally_bright() -> None:
    volume = gaussian_filter(np.random.default_rng(1).random((2, 60, 60)), 2).astype(np.float32)
    model = ObjectModel.of(volume, 0.9)
    objects = [model.draw(np.random.default_rng(k)) for k in range(20)]
    assert all(one.sum() == pytest.approx(model.mean.sum(), rel=1e-4) for one in objects)
    spread = np.std([np.log(one / model.mean) - np.log(one / model.mean).mean() for one in objects])
    assert spread == pytest.approx(0.9, rel=0.03)


def test_frames_have_the_stated_noise() -> None:
    for noise, light, variance in (
        (SampleNoise(20.0, 2.0, 10.0), 100.0, 220.0),
        (SampleNoise(9.0, 1.0, 3.0), 50.0, 59.0),
        (SampleNoise(4.0, 0.5, 0.0), 0.0, 4.0),
    ):
        frame = noise.sampled(np.full((300, 300), light), np.random.default_rng(1))
        assert frame.mean() == pytest.approx(light + noise.background, abs=0.3)
        assert frame.var() == pytest.approx(variance, rel=0.03)
        assert replace(noise, saturation=60.0).sampled(np.full((9, 9), 1e3), np.random.default_rng(1)).max() == 60


@pytest.mark.parametrize(("regions", "uncertain", "runs"), [(False, True, 11), (True, False, 15), (True, True, 17)])
def test_the_default_costs_at_most_40_default_reconstructions(regions: bool, uncertain: bool, runs: int) -> None:
    """60 iterations of rl-nesterov take about 2.3 times as long as a default reconstruction."""
    assert runs_of(CHOICE, BootstrapSettings(), regions=regions, uncertain=uncertain) == runs
    assert runs * CHOICE.iterations / USUAL_ITERATIONS <= 40


def test_wrong_input_is_refused(P: Projector) -> None:
    for choice, labels, words in (
        (SolverChoice(auto=True), None, "iterations of a reconstruction with error bars: expected a fixed number"),
        (SolverChoice("rl", tolerance=0.1), None, "tolerance of a reconstruction with error bars"),
        (CHOICE, np.ones((3, 5)), r"labels of regions: expected shape \(2, 77, 77\) or \(77, 77\), got \(3, 5\)"),
        (CHOICE, np.full(SHAPE, 0.5), "labels of regions: expected integers"),
        (CHOICE, np.zeros(SHAPE), "positive integers inside, got only zeros; label at least one region"),
        (CHOICE, np.full(SHAPE, -1), "positive integers inside, got -1; replace the negative labels"),
    ):
        with pytest.raises(InputError, match=words):
            error_bars(P, np.ones(SHAPE), choice, labels=labels)


def test_a_frame_below_its_background_is_refused() -> None:
    """Its volume was zero and its bars were NaN, without a message."""
    P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (20, 20), workers=1)
    choice = SolverChoice("rl", iterations=3, background=100, gain=1)
    with pytest.raises(InputError, match="expected light above the background of 100, got a volume without light"):
        error_bars(P, np.full((20, 20), 60.0), choice, BootstrapSettings(replicates=3))


SQUARE_DEPTHS = (2.2, 2.8, 3.4)
SIGMAS: dict[str, float] = {"gap": 0.002, "row": 0.03, "column": 0.03, "f-number": 0.01, "focus": 0.005}
"""Standard uncertainties of a fitted camera: relative, but pixels for the lattice."""


def changed(camera: Camera, name: str, by: float) -> Camera:
    lattice, pixel = camera.lattice, camera.sensor.pixel_um
    if name == "f-number":
        return replace(camera, optics=replace(camera.optics, f_number=camera.optics.f_number * (1 + by)))
    if name == "gap":
        return replace(camera, lattice=replace(lattice, gap_um=lattice.gap_um * (1 + by)))
    if name == "focus":
        (lens,) = lattice.types
        types = (replace(lens, focal_length_um=lens.focal_length_um * (1 + by)),)
        return replace(camera, lattice=replace(lattice, types=types))
    row, column = lattice.offset_um
    moved = (row + by * pixel, column) if name == "row" else (row, column + by * pixel)
    return replace(camera, lattice=replace(lattice, offset_um=moved))


class Uncertain:
    """H of the camera ``square``, and projectors of H drawn from the uncertainty of a fit."""

    def __init__(self) -> None:
        camera = square()
        depths = tuple(camera.depth_of(v) for v in SQUARE_DEPTHS)
        self.H = matrix(camera, depths, tolerance=0.01)
        lit = self.H > 0
        self.changes = []
        for name, sigma in SIGMAS.items():
            ends = [matrix(changed(camera, name, by), depths, tolerance=0.01) for by in (sigma, -sigma)]
            self.changes.append(np.where(lit, (ends[0] - ends[1]) / 2, 0))

    def __call__(self, rng: np.random.Generator) -> Projector:
        drawn = self.H + sum(rng.standard_normal() * change for change in self.changes)
        return projector(np.maximum(drawn, 0).astype(np.float32))


@pytest.fixture(scope="module")
def uncertain() -> Uncertain:
    return Uncertain()


@pytest.fixture(scope="module")
def hexagonal() -> Projector:
    """Return the projector of two planes behind hexagonal lenslets of three types."""
    camera = preset("bench")
    return projector(matrix(camera, tuple(camera.depth_of(v) for v in (3.0, 4.0)), 55))


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("peak", [200, 2000, 20000])
@pytest.mark.parametrize("case", ["exact", "uncertain", "hexagonal"])
def test_intervals_hold_for_all_objects_light_levels_and_cameras(
    case: str, peak: int, request: pytest.FixtureRequest
) -> None:
    """Intervals hold for objects of five kinds, three light levels, two cameras, and H exact or uncertain."""
    system = request.getfixturevalue("hexagonal" if case == "hexagonal" else "uncertain")
    P = system if case == "hexagonal" else projector(system.H)
    imaging = system if case == "uncertain" else None
    found = {kind: [covered(P, kind, seed, peak, imaging) for seed in range(100, 105)] for kind in KINDS}
    voxels, sums = (shares([pair[k] for pairs in found.values() for pair in pairs]) for k in range(2))
    print(case, peak, "voxels", voxels.round(1), "regions", sums.round(1))
    for kind, pairs in found.items():
        print("  ", kind, *(shares([pair[k] for pair in pairs]).round(0) for k in range(2)))
    # bars may be too long: a bright frame limits details of an object less than is assumed
    assert (voxels >= (65, 92)).all() and (voxels <= (80, 99)).all(), voxels
    assert (sums >= (60, 89)).all() and (sums <= (80, 100)).all(), sums
