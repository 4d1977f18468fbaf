"""Two H compared in numbers: known shifts, scales and noise, swapped planes, lens types, and omitted positions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from lfcal.base._plain import plain
from lfcal.base.errors import InputError
from lfcal.base.progress import Progress
from lfcal.camera import ScanPlan, preset
from lfcal.judge._shifting import best_shift, shifted
from lfcal.judge.comparison import compare, iter_compare
from lfcal.judge.pairing import pair
from lfcal.judge.report.two import compared_words, figure_rows, map_levels, verdict
from lfcal.psf import PSFMatrix, open_psf, save

SHAPE = (2, 3, 4, 25, 27)
Values = NDArray[np.float64]


def spots(shape: tuple[int, ...] = SHAPE, at: tuple[float, float] = (0.0, 0.0), seed: int = 1) -> Values:
    """Gaussian spots, each a little elsewhere and of another brightness; their centres moved by ``at``."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[3], : shape[4]]
    out = np.empty(shape)
    for place in np.ndindex(shape[:3]):
        row, column = 10 + rng.uniform(-1, 1), 11 + rng.uniform(-1, 1)
        spot = np.exp(-((rows - row - at[0]) ** 2 + (columns - column - at[1]) ** 2) / 8)
        out[place] = rng.uniform(1, 2) * spot
    return out


def moved(at: tuple[float, float] = (0.0, 0.0), seed: int = 1) -> Values:
    """Return spots with the source ``at`` (row, column) pixels elsewhere."""
    return spots(SHAPE, at, seed)


@pytest.mark.parametrize("at", [(0.37, -0.21), (-1.4, 0.6), (0.0, 0.05), (2.8, -3.1)])
def test_a_known_shift_is_found_with_its_sign(at: tuple[float, float]) -> None:
    found = compare(moved(at), moved())
    assert found.all.shift_px == pytest.approx(at, abs=2e-3)
    assert found.all.scale < 1 and found.all.left < 2e-3 < 0.01 < found.all.scaled and found.all.nrmse > 0.01
    assert found.max_shift_px == pytest.approx(np.hypot(*at), abs=0.03 + 0.02 * np.hypot(*at))
    assert found.rms_shift_px <= found.max_shift_px
    if np.hypot(*at) < 0.5:
        np.testing.assert_allclose(found.shift_px, np.broadcast_to(at, found.shift_px.shape), atol=0.02)
        assert compare(moved(), moved(at)).all.shift_px == pytest.approx(np.negative(at), abs=2e-3)


def test_a_known_scale_is_found() -> None:
    found = compare(2.5 * moved(), moved())
    assert found.all.scale == pytest.approx(2.5) and found.all.nrmse == pytest.approx(1.5)
    assert found.all.scaled < 1e-6 and found.all.left < 1e-6 and found.correlation == pytest.approx(1, abs=1e-12)
    assert found.all.shift_px == pytest.approx((0, 0), abs=1e-6)
    assert found.max_shift_px < 1e-6 and found.rms_error < 1e-6
    assert found.error.shape == SHAPE[:3] and found.shift_px.shape == (*SHAPE[:3], 2)


def test_scale_and_shift_together_leave_the_noise() -> None:
    rng = np.random.default_rng(3)
    first, noise = 1.7 * moved((0.3, 0.4)), rng.normal(0, 0.02, SHAPE)
    found = compare(first + noise, moved()).all
    assert found.scale != pytest.approx(1.7, rel=0.005), "of the shifted pattern the plain scale is less"
    assert found.left == pytest.approx(float(np.linalg.norm(noise) / np.linalg.norm(first + noise)), rel=0.02)
    assert found.shift_px == pytest.approx((0.3, 0.4), abs=0.01)
    assert compare(spots((1, 4, 4, 21, 23)).swapaxes(1, 2), spots((1, 4, 4, 21, 23))).max_shift_px > 0.5
    far = moved() + rng.normal(0, 0.005, SHAPE)
    assert compare(far, moved()).max_shift_px < 0.05, "noise far out does not move centroids"


def test_figures_are_the_plain_formulae_for_each_plane() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.random(SHAPE), rng.random(SHAPE)
    found = compare(a, b, workers=2)
    for z, one in enumerate(found.planes):
        p, q = a[z].ravel(), b[z].ravel()
        scale = p @ q / (q @ q)
        assert one.all.nrmse == pytest.approx(np.linalg.norm(p - q) / np.linalg.norm(q))
        assert one.all.scale == pytest.approx(scale)
        assert one.all.scaled == pytest.approx(np.linalg.norm(p - scale * q) / np.linalg.norm(p))
        assert one.all.correlation == pytest.approx(p @ q / np.linalg.norm(p) / np.linalg.norm(q))
        assert one.positions == 12 and one.types == ()
    assert found.all.nrmse == pytest.approx(np.linalg.norm(a - b) / np.linalg.norm(b))
    assert found.correlation == pytest.approx((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
    for place in np.ndindex(SHAPE[:3]):
        scaled = a[place] / a[place].sum() * b[place].sum()
        want = np.sqrt(((scaled - b[place]) ** 2).sum() / (b[place] ** 2).sum())
        assert found.error[place] == pytest.approx(want, rel=1e-5)


def test_swapped_planes_are_reported() -> None:
    values = np.concatenate([moved(seed=1)[:1], ndimage.gaussian_filter(moved(seed=2)[:1], (0, 0, 0, 2, 2))])
    right = PSFMatrix(values, depths=[-2000.0, -1000.0])
    wrong = PSFMatrix(values[::-1].copy(), depths=[-2000.0, -1000.0])
    found = compare(wrong, right)
    assert [one.like for one in found.planes] == [1, 0] and sum("swapped" in note for note in found.notes) == 2
    assert [one.like for one in compare(right, right).planes] == [None, None]
    labelled = PSFMatrix(values[::-1].copy(), depths=[-1000.0, -2000.0])
    again = compare(labelled, right)
    assert again.pair.planes == ((0, 1), (1, 0)) and again.all.nrmse < 1e-9, "paired by depth"


def test_the_position_that_differs_most_is_named() -> None:
    first = moved()
    first[1, 2, 3] = np.roll(first[1, 2, 3], 4, 0)
    found = compare(first, moved())
    assert found.worst(1) == [(1, 2, 3)] and found.error[1, 2, 3] > 0.5
    assert found.shift_px[1, 2, 3] == pytest.approx((4, 0), abs=0.1)


def test_missing_dark_and_damaged_positions_are_left_out() -> None:
    damaged, recorded = moved(), np.ones(SHAPE[:3], int)
    recorded[0, 1, 2] = 0
    damaged[0, 1, 2] = 99.0
    damaged[1, 0, 0] = 0
    damaged[1, 2, 3, 4, 4] = np.nan
    found = compare(PSFMatrix(damaged, recorded=recorded), moved())
    assert np.argwhere(np.isnan(found.error)).tolist() == [[0, 1, 2], [1, 0, 0], [1, 2, 3]]
    assert found.all.nrmse < 1e-9 and [one.positions for one in found.planes] == [11, 10] and found.compared == 21


def test_nothing_to_compare_is_no_number() -> None:
    found = compare(np.zeros(SHAPE), moved())
    assert np.isnan([found.all.nrmse, found.all.left, found.correlation, found.max_shift_px, found.rms_error]).all()
    assert not found.worst() and found.compared == 0
    assert json.dumps(plain(found.to_dict()), allow_nan=False)
    assert all(row[2:] == ("–",) * 6 for row in figure_rows(found))
    assert compared_words(found).startswith("0 of 24 positions") and not found.notes, "the verdict says it"


def test_a_plane_without_light_is_not_compared_and_like_no_other() -> None:
    dark = moved()
    dark[1] = 0
    found = compare(moved(), dark)
    assert found.notes == ("plane 1 of the first H: not compared, because no position has light in both",)
    assert compared_words(found).startswith("12 of 24 positions of 2 planes")
    assert figure_rows(found)[2][2:] == ("–",) * 6 and "–" not in figure_rows(found)[1]


def test_values_that_differ_by_rounding_are_drawn_alike() -> None:
    assert map_levels(np.array([[12.7217, 12.72169], [np.nan, 12.7217]])) == (0.0, 12.7217)
    assert map_levels(np.array([[3.0, 5.0], [np.nan, 4.0]])) == (3.0, 5.0)
    assert map_levels(np.zeros((2, 2))) == map_levels(np.full((2, 2), np.nan)) == (0.0, 1.0)


# -- lens types --------------------------------------------------------------------------------------------
def of_bench(values: Values, plan: ScanPlan) -> PSFMatrix:
    return PSFMatrix(values, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor)


def bench() -> ScanPlan:
    return ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,), cutout=31)


def test_a_lens_type_that_differs_is_found() -> None:
    plan = bench()
    ny, nx = plan.period
    nt, ns = plan.cutout
    rng = np.random.default_rng(2)
    field = 1 + rng.random((ny + nt - 1, nx + ns - 1))
    rows = round(plan.anchor[0]) - nt // 2 + np.arange(ny + nt - 1)
    columns = round(plan.anchor[1]) - ns // 2 + np.arange(nx + ns - 1)
    points = plan.camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), -1))
    # brute force: the nearest of all lenslets
    centres, kinds = plan.camera.lattice.lenslets_within(3000.0, 3000.0)
    nearest = [int(kinds[np.square(centres - p).sum(-1).argmin()]) for p in points.reshape(-1, 2)]
    dim = field * np.where(np.reshape(nearest, field.shape) == 1, 0.8, 1.0)

    def patterns(image: Values) -> Values:
        cells = [[image[y : y + nt, x : x + ns] for x in range(nx)] for y in range(ny)]
        return np.array(cells)[None]

    found = compare(of_bench(patterns(dim), plan), of_bench(patterns(field), plan))
    assert [one.scale for one in found.types] == pytest.approx([1.0, 0.8, 1.0], abs=1e-9)
    assert [one.nrmse for one in found.types] == pytest.approx([0.0, 0.2, 0.0], abs=1e-9)
    for one, whole in zip(found.planes[0].types, found.types, strict=True):  # of a single plane
        assert one.scale == whole.scale and one.left == pytest.approx(whole.left)
        assert one.shift_px == pytest.approx(whole.shift_px, abs=1e-12)


# -- what is common ----------------------------------------------------------------------------------------
def test_planes_are_paired_by_depth_and_the_others_are_named() -> None:
    values = np.concatenate([moved(), moved(seed=4)])
    first = PSFMatrix(values[:3], depths=[-3000.0, -2000.0, -1000.0])
    second = PSFMatrix(values[1:], depths=[-2000.5, -1000.0, -500.0])
    both = pair(first, second)
    assert both.planes == ((1, 0), (2, 1))
    assert both.notes == ("plane only in the first H: -3 mm", "plane only in the second H: -500 µm")
    assert compare(first, second).all.nrmse < 1e-9


def test_planes_of_other_depths_are_refused_unless_numbers_count() -> None:
    first, second = (PSFMatrix(moved(), depths=depths) for depths in ([0.0, 1e3], [400.0, 1400.0]))
    with pytest.raises(InputError, match="compare the planes by their numbers"):
        pair(first, second)
    both = pair(first, second, by_number=True)
    assert both.planes == ((0, 0), (1, 1)) and "2 of them differ in depth" in both.notes[0]


def test_the_larger_cutout_is_cut_about_the_source_unless_compared_by_index() -> None:
    found = compare(moved()[..., 2:-2, 3:-3], moved())
    assert found.pair.cutout == (21, 21) and "21 × 21" in found.notes[0] and found.all.nrmse < 1e-12
    with pytest.raises(InputError, match="expected shape"):
        compare(moved()[..., 2:-2, 3:-3], moved(), by_index=True)
    assert compare(PSFMatrix(moved()).T, PSFMatrix(moved())).all.nrmse < 1e-12, "a transposed view is the H behind it"


def test_positions_are_paired_by_the_sensor() -> None:
    plan = bench()
    values = np.random.default_rng(1).random(plan.shape)
    first = of_bench(values, plan)
    ny, nx = plan.period
    later = PSFMatrix(
        np.roll(values, (-2, -5), (1, 2)),
        depths=plan.depths_um,
        camera=plan.camera,
        anchor=(plan.anchor[0] + 2 + ny, plan.anchor[1] + 5),
    )
    both = pair(first, later)
    assert both.moved == (ny - 2, nx - 5) and "paired by their location on the sensor" in both.notes[0]
    assert compare(first, later).all.nrmse < 1e-12
    assert pair(first, PSFMatrix(later[:], depths=plan.depths_um)).moved == (0, 0), "without a camera nothing is known"


def test_what_cannot_be_compared_is_one_line() -> None:
    for other, words in ((spots((2, 4, 4, 25, 27)), "period"), (moved().astype(complex), "real numbers")):
        for refusing in (pair, compare):
            with pytest.raises(InputError, match=words) as error:
                refusing(moved(), other)
            assert "\n" not in str(error.value) and "second H" in str(error.value)


def test_a_refused_file_is_called_by_its_name(tmp_path: Path) -> None:
    depths = [-2000.0, -1000.0]
    for name, values, at in (
        ("may", moved(), depths),
        ("far", moved(), [-9.0, -5.0]),
        ("other", moved()[:, :2], depths),
    ):
        save(PSFMatrix(values, depths=at), tmp_path / f"{name}.h5")
    with open_psf(tmp_path / "may.h5") as a:
        for name in ("far", "other"):
            with open_psf(tmp_path / f"{name}.h5") as b, pytest.raises(InputError) as error:
                pair(a, b)
            assert str(error.value).startswith(f"{tmp_path / name}.h5 (the second H), ")
        with open_psf(tmp_path / "may.h5") as again:
            assert pair(a, again).notes == ("both are the same file",)


def test_cameras_of_other_names_are_noted() -> None:
    plan = bench()
    values = spots((1, *plan.period, 31, 31))
    other = PSFMatrix(values, depths=plan.depths_um, camera=replace(plan.camera, name="spare"), anchor=plan.anchor)
    assert pair(of_bench(values, plan), other).notes == (
        f"the names of the cameras differ: {plan.camera.name} and spare",
    )


def test_rows_are_read_one_by_one() -> None:
    class Counting:
        """Planes that notice how much is asked for at once."""

        def __init__(self, values: Values) -> None:
            self.values, self.shape, self.dtype = values, values.shape, values.dtype
            self.whole = 0

        def plane(self, z: int) -> Values:
            self.whole += 1
            return self.values[z]

        def cutout(self, z: int, y: int, x: int) -> Values:
            return self.values[z, y, x]

        def transposed(self) -> Counting:
            raise NotImplementedError

    planes = [Counting(spots((1, 8, 4, 9, 9))) for _ in range(2)]
    records = list(iter_compare(*(PSFMatrix(p) for p in planes), workers=2))
    assert [p.whole for p in planes] == [0, 0], "never a whole plane"
    assert all(isinstance(r, Progress) for r in records) and [r.done for r in records] == [0, 2, 4, 6, 8]


# -- shifts ------------------------------------------------------------------------------------------------
def test_a_series_is_shifted_as_its_formula() -> None:
    now, down, along = shifted(moved()[0].reshape(-1, 25, 27), np.array([0.4, -0.3]))
    np.testing.assert_allclose(now.reshape(SHAPE[1:]), moved((0.4, -0.3))[0], atol=2e-4)
    step = 1e-4
    for k, slope in enumerate((down, along)):
        at = [np.array([0.4, -0.3]) for _ in range(2)]
        at[0][k] -= step
        at[1][k] += step
        # a pattern moved further down is at a place what it was above it: its slope with the other sign
        ahead, behind = (shifted(moved()[0].reshape(-1, 25, 27), v)[0] for v in at)
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=1e-5)


def test_noise_alone_has_no_far_shift() -> None:
    rng = np.random.default_rng(0)
    found = best_shift(rng.random((5, 15, 15)), rng.random((5, 15, 15)))
    assert np.isfinite(found).all() and np.abs(found).max() <= 4.5


def test_values_of_other_units_are_named_as_such() -> None:
    """Counts compared with shares of the light: millions of per cent mean nothing."""
    words = verdict(compare(4e4 * moved((0.2, 0.0)), moved()))
    assert words.startswith("Their values are in different units: those of the first H are ") and "e+06" not in words
    assert figure_rows(compare(4e4 * moved(), moved()))[0][2] == "> 1000"
    assert verdict(compare(2.5 * moved(), moved())).startswith("They differ by 150 % (NRMSE) as they are")
