"""What a fit of the lattice states: places, errors, residuals, the camera's lattice, and vignetting."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, MainLens, Sensor
from lfcal.frames.corrections.steps import White
from lfcal.lattice._forms import FORMS, DistortionFrame, fit_form
from lfcal.lattice._model import LatticeModel
from lfcal.lattice._smooth_field import determined_degree, fit_field
from lfcal.lattice.fit import fit_lattice
from lfcal.lattice.lattice_fit import LatticeErrors, LatticeFit, best_places, gridded
from lfcal.lattice.vignetting import vignetting_map
from tests.lattice.white_frames import WhiteFrame, barrel, draw_white

SHAPE = (400, 480)
REACH = math.hypot(*SHAPE) / 2


@pytest.fixture(scope="module")
def bent() -> tuple[WhiteFrame, LatticeFit]:
    truth = draw_white(SHAPE, 12.3, rotation=0.02, bend=barrel(2.0, REACH, (30.0, -20.0)), seed=4)
    return truth, fit_lattice(truth.frame, dark=100.0)


@pytest.mark.long
def test_every_place_is_the_true_one(bent: tuple[WhiteFrame, LatticeFit]) -> None:
    truth, fit = bent
    for places in (fit.centres_px(fit.index[:, 0], fit.index[:, 1]), fit.places_px):
        assert places is not None
        assert math.sqrt((truth.errors(places) ** 2).sum(1).mean()) < 0.02
    assert fit.residual_rms_px < 0.06 and 0.03 < fit.dead.mean() < 0.07
    assert truth.errors(np.array([fit.origin_px]))[0] == pytest.approx((0.0, 0.0), abs=0.02)
    assert fit.centres_px(0, 0) == pytest.approx(fit.origin_px, abs=1e-9)


def test_the_numbers_are_those_of_the_distortion(bent: tuple[WhiteFrame, LatticeFit]) -> None:
    _, fit = bent
    assert fit.form == "radial" and fit.distortion is not None and fit.errors is not None
    assert abs(fit.distortion.terms[0][0] - 2.0) < 4 * fit.errors.terms[0][0] < 0.2
    away = np.array(fit.distortion.centre) - (np.array(SHAPE[::-1]) - 1) / 2 - (30.0, -20.0)
    assert (np.abs(away) < 4 * np.array(fit.errors.centre)).all() and max(fit.errors.centre) < 5
    assert abs(fit.pitch_px - 12.3) < 4 * fit.errors.pitch_px < 0.01
    assert abs(fit.row_pitch_px - 12.3 * math.sqrt(3) / 2) < 4 * fit.errors.row_pitch_px
    assert abs(fit.rotation_rad - 0.02) < 4 * fit.errors.rotation_rad
    left = fit.residual_map(12)
    assert left.shape == (2, 10, 12) and np.nanmax(np.abs(left)) < 0.06
    without = replace(fit, distortion=None, origin_px=tuple(fit.model.origin[::-1]))
    assert np.nanmax(np.abs(without.residual_map(12))) > 1.0


def test_indices_and_local_vectors_belong_to_the_places(bent: tuple[WhiteFrame, LatticeFit]) -> None:
    _, fit = bent
    places = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    assert np.allclose(fit.lenslet_at(places[:, 0], places[:, 1]), fit.index, atol=1e-7)
    (row, column), (q, r) = places[0], fit.index[0]
    steps = np.array([fit.centres_px(q + 1, r), fit.centres_px(q, r + 1)]) - (row, column)
    assert fit.distortion is not None
    bend = fit.distortion.jacobian(fit.distortion.invert(np.array([column, row])))
    assert np.abs(fit.basis_px() @ bend.T - steps[:, ::-1]).max() < 0.01
    assert np.abs(fit.basis_px() - steps[:, ::-1]).max() > 0.02


def test_the_distortion_is_set_in_the_camera(bent: tuple[WhiteFrame, LatticeFit]) -> None:
    truth, fit = bent
    stated = LensletLattice("hexagonal", 60.0, 300.0, offset_um=(20.0, -35.0))
    camera = Camera("c", MainLens(), stated, Sensor(SHAPE, 5.0))
    measured = replace(camera, lattice=fit.to_lattice(camera))
    assert measured.lattice.distortion is not None
    centres, _ = measured.lattice.lenslets_within(SHAPE[1] * 2.4, SHAPE[0] * 2.4)
    errors = truth.errors(measured.pixels(centres))
    assert len(centres) > 1000 and np.hypot(*errors.T).max() < 0.06
    assert Camera.from_json(measured.to_json()) == measured
    # the types keep their place: the offset's lenslet is the one nearest to that stated
    assert math.dist(measured.lattice.centres_um(0, 0), (20.0, -35.0)) < 12.3 * 5 * 0.6


def test_errors_of_the_place_are_row_first() -> None:
    frame, model = DistortionFrame.of(SHAPE), LatticeModel("square", np.array([3.0, -2.0]), np.array([12.0, 0.0]), 1.0)
    index = np.stack(np.meshgrid(np.arange(-9, 10), np.arange(-9, 10)), axis=-1).reshape(-1, 2)
    fitted = fit_form(model, FORMS[0], index, model.places(index), frame)
    assert fitted is not None
    # the form counts across first
    errors = LatticeErrors.of(fitted, np.diag([4.0, 9.0, *np.zeros(FORMS[0].size - 2)]), frame)
    assert errors.origin_px == pytest.approx((3.0, 2.0))


def field(common: float, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(40), np.arange(30)))
    index = np.stack([q, r], axis=-1)
    lattice = 15.0 * index[:, ::-1]
    smooth = common * np.stack([np.sin(q / 6), np.cos(r / 5)], axis=-1)
    truth = lattice + smooth
    measured = truth + np.random.default_rng(seed).normal(0, noise, truth.shape)
    measured[::17] = np.nan
    return index, lattice, truth, measured


def test_best_places_keep_what_neighbours_have_in_common() -> None:
    index, lattice, truth, measured = field(0.3, 0.1)
    best = best_places(index, lattice, measured)
    assert np.isfinite(best).all()
    before, after = (np.sqrt(((p - truth) ** 2).mean()) for p in (lattice, best))
    assert after < 0.3 * before
    dead = ~np.isfinite(measured[:, 0])
    assert np.sqrt(((best - truth)[dead] ** 2).mean()) < 0.1
    # few lenslets stay on the lattice, and scatter alone leaves it
    assert np.array_equal(best_places(index[:50], lattice[:50], measured[:50]), lattice[:50])
    index, lattice, _, measured = field(0.0, 0.1)
    assert np.sqrt(((best_places(index, lattice, measured) - lattice) ** 2).mean()) < 0.01
    # one wild lenslet does not drag its neighbours
    index, lattice, truth, measured = field(0.3, 0.05)
    measured[600] += 5.0
    assert np.abs(best_places(index, lattice, measured) - truth).max() < 0.25


def test_the_residual_map_has_means_of_cells() -> None:
    places = np.array([[1.0, 1.0], [2.0, 2.0], [1.0, 19.0], [np.nan, 3.0]])
    values = np.array([[1.0, 10.0], [3.0, 20.0], [5.0, 30.0], [7.0, 40.0]])
    means = gridded(places, values, (10, 20), 2)
    assert means.shape == (2, 1, 2)
    assert means[:, 0, 0] == pytest.approx((2.0, 15.0)) and means[:, 0, 1] == pytest.approx((5.0, 30.0))
    assert np.isnan(gridded(places, values, (100, 20), 10)[:, 5, 0]).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_falloff_of_light_is_recovered(kind: str) -> None:
    truth = draw_white(kind=kind, falloff=0.4)
    fit = fit_lattice(truth.frame, dark=100.0)
    fall = vignetting_map(fit)
    rows, columns = truth.frame.shape
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    y, x = y * (rows - 1), x * (columns - 1)
    radius = (y**2 + x**2) / ((rows - 1) ** 2 + (columns - 1) ** 2)
    frame = fall.frame()
    assert frame.max() == pytest.approx(1.0, abs=1e-6)
    assert np.abs(frame - (1 - 0.4 * radius))[10:-10, 10:-10].max() < 0.02
    assert fall.falloff == pytest.approx(0.6, abs=0.02) and fall.scatter < 0.01
    assert np.array_equal(np.isnan(fall.lenslets), fit.dead)


@pytest.mark.long
def test_the_smooth_frame_can_be_used_as_white_frame() -> None:
    truth = draw_white(falloff=0.4, dead=0.0)
    fall = vignetting_map(fit_lattice(truth.frame, dark=100.0))
    corrected = (truth.frame - 100.0) * White(fall.frame(), dark=0.0).gain
    even = fit_lattice(np.clip(corrected, 0, None))
    assert np.nanstd(even.light) / np.nanmean(even.light) < 0.01


@pytest.mark.long
def test_a_few_lenslets_lower_the_degree_of_the_surface() -> None:
    fit = fit_lattice(draw_white((110, 110), pitch=17.0, dead=0.0).frame)
    fall = vignetting_map(fit, degree=6)
    assert 0.5 < fall.falloff < 1.0 and fall.surface.powers.sum(1).max() == 3


def test_scatter_is_that_of_the_lenslets_light() -> None:
    fit = fit_lattice(draw_white(scatter=0.03, snr=200.0, dead=0.0).frame, dark=100.0)
    assert vignetting_map(fit).scatter == pytest.approx(0.03, rel=0.15)


def quartic(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return 100 + 0.1 * row - 2e-4 * row * column + 1e-6 * column**3 - 3e-9 * row**4


def test_a_polynomial_is_found_under_outliers_and_on_every_pixel() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 1, (400, 2)) * (199, 299)
    values = quartic(*points.T)
    values[::20] = 0.0
    field = fit_field(points, values, (200, 300))
    y, x = np.mgrid[:200, :300]
    assert field.at(y, x) == pytest.approx(quartic(y, x), rel=1e-6)
    frame = field.frame()
    assert frame.dtype == np.float32 and frame.shape == (200, 300)
    assert np.abs(frame - quartic(y, x)).max() < 1e-3


def test_three_points_determine_a_term_and_fewer_are_refused() -> None:
    with pytest.raises(InputError, match="smooth field"):
        fit_field(np.zeros((2, 2)), np.zeros(2), (20, 20))
    for count, degree in ((3, 0), (8, 0), (9, 1), (17, 1), (18, 2), (30, 3), (44, 3), (45, 4)):
        assert determined_degree(count) == degree
        points = np.random.default_rng(1).uniform(0, 19, (count, 2))
        field = fit_field(points, np.full(count, 5.0), (20, 20))
        assert field.powers.sum(1).max() == degree and field.at(3, 4) == pytest.approx(5.0)
