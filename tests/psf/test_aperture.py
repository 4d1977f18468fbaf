"""The outline of the iris in a depth sum: shape, size with its error, blades, faults, and the iris of all planes."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, special

from benchmarks.aperture import Trial, run
from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.psf.aperture import Aperture, expected_aperture, fit_aperture, footprint_px, joint_iris, working_f_number
from lfcal.psf.aperture._arcs import Arcs
from lfcal.psf.aperture._compare import circle
from lfcal.psf.aperture._edge import measured_edge
from lfcal.psf.aperture._locate import despike, find_patch
from lfcal.psf.aperture._profile import edge_profile
from lfcal.psf.aperture._ripple import find_ripple
from lfcal.psf.aperture._synthetic import Disturbance, IrisFault, depth_sum_of
from lfcal.psf.aperture._verdict import CERTAIN
from lfcal.psf.aperture.shape import blade_radius, polygon_area, with_error

CLEAN = Disturbance(noise=1e-3, ripple=0, tilt=0, vignetting=0, hot=0, ellipticity=0, pedestal=0)


def synthetic(blades=7, curvature=0.2, seed=0, side=121, disturbance=None):
    return depth_sum_of(side, blades, curvature, disturbance or Disturbance(), np.random.default_rng(seed))


def _lit(image):
    image = image / image.max()
    return image, find_patch(image)


def test_the_edge_profile_of_a_disc_is_its_radius():
    rows, columns = np.indices((101, 101))
    disc = np.clip(30.0 - np.hypot(rows - 49.0, columns - 52.0) + 0.5, 0, 1)
    assert np.abs(edge_profile(disc, 49.0, 52.0, 30.0) - 30.0).max() < 0.1


@pytest.mark.parametrize("blades", [pytest.param(5, marks=pytest.mark.long), 11])
def test_a_clean_iris_is_recovered_to_small_fractions_of_a_pixel(blades):
    image, truth = synthetic(blades, 0.3, 1, disturbance=CLEAN)
    found = fit_aperture(image[:, 4:])  # rows and columns of the centre differ
    assert found.confident and found.blades == blades
    assert math.dist(found.centre, (truth.centre[0], truth.centre[1] - 4)) < 0.02
    assert found.apothem_px == pytest.approx(truth.apothem_px, rel=2e-3)
    assert found.area_px2 == pytest.approx(truth.area_px2, rel=3e-3)
    assert found.curvature == pytest.approx(0.3, abs=0.02)
    assert found.kind == "rounded polygon" and abs(found.curvature - 0.3) < 3 * found.curvature_sigma
    assert found.blur_px == pytest.approx(2.0, rel=0.15)


def test_rotation_is_that_of_a_vertex_and_follows_the_image():
    image, truth = synthetic(6, 0.1, 3, disturbance=CLEAN)
    step = 2 * math.pi / 6
    found = fit_aperture(image)
    assert abs((found.rotation_rad - truth.rotation_rad + step / 2) % step - step / 2) < math.radians(0.3)
    mirrored = fit_aperture(image[:, ::-1])  # counter-test: a mirrored image turns the other way
    expected = (math.pi - truth.rotation_rad) % step
    assert abs((mirrored.rotation_rad - expected + step / 2) % step - step / 2) < math.radians(0.3)
    assert abs((mirrored.rotation_rad - truth.rotation_rad + step / 2) % step - step / 2) > math.radians(3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("blades", "curvature", "snr"), [(5, 0.0, 1.0), (9, 0.0, 1.0), (7, 0.3, 2.0), (9, 0.6, 2.0), (10, 0.6, 5.0)]
)
def test_blades_are_counted_in_noise(blades, curvature, snr):
    for number in range(2):
        outcome = run(Trial(blades, curvature, snr, number, 187))
        assert outcome.right
        assert outcome.centre_px < (0.9 if snr < 2 else 0.4)


@pytest.mark.long
def test_nothing_confident_is_wrong_far_below_the_noise():
    for number in range(2):
        for blades in (5, 11):
            outcome = run(Trial(blades, 0.6, 0.5, number, 121))
            assert outcome.right or not outcome.confident


def test_vignetting_and_ellipticity_are_measured():
    image, _ = synthetic(8, 0.0, 5, side=151, disturbance=Disturbance(0.01, vignetting=0.3, tilt=0, ellipticity=0.03))
    found = fit_aperture(image)
    assert found.confident
    assert found.vignetting == pytest.approx(0.3 * found.apothem_px**2 / (0.42 * 151) ** 2, abs=0.05)
    assert found.ellipticity == pytest.approx(0.058, abs=0.01)
    assert abs(found.ellipse_axis_rad) % math.pi == pytest.approx(math.pi / 2, abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize("snr", [5, 20, 100])
def test_a_circle_is_recognised_as_round(snr):
    image, truth = synthetic(16, 1.0, 6, side=151, disturbance=Disturbance(1 / snr))
    found = fit_aperture(image)
    if snr == 5:
        # many nearly round blades cannot be excluded in this noise
        assert not found.confident or found.kind == "round"
        return
    assert (found.blades, found.kind, found.confident) == (0, "round", True)
    assert found.diameter_px == pytest.approx(truth.diameter_px, rel=0.02)
    assert math.dist(found.centre, truth.centre) < 1


@pytest.mark.few(1)
@pytest.mark.parametrize("pattern", ["square", "hexagonal", "random"])
@pytest.mark.parametrize("pitch", [26.0, 40.0])
@pytest.mark.parametrize("ripple", [0.02, 0.08])
def test_ripple_on_a_round_stop_makes_no_blades(pattern, pitch, ripple):
    disturbance = Disturbance(0.005, ripple=ripple, ripple_pitch_px=pitch, pattern=pattern)
    image, _ = synthetic(9, 1.0, 11, side=187, disturbance=disturbance)
    found = fit_aperture(image)
    assert found.kind in ("", "round") and not found.counts[0].gain < -CERTAIN
    if pattern != "random":
        assert found.confident
        assert found.ripple == pytest.approx(0.5 * ripple, rel=0.3)


@pytest.mark.long
@pytest.mark.parametrize("pattern", ["square", "hexagonal", "random"])
def test_ripple_hides_no_blades(pattern):
    image, _ = synthetic(9, 0.3, 12, side=187, disturbance=Disturbance(0.005, ripple=0.08, pattern=pattern))
    found = fit_aperture(image)
    assert found.confident and found.blades == 9
    assert abs(found.curvature - 0.3) < 3 * found.curvature_sigma


@pytest.mark.parametrize("radius", [37.0, 18.5])
def test_the_blur_of_the_edge_is_not_taken_for_curved_blades(radius):
    """The tips of a clean small iris are no spikes, and harmonics are damped by a blur that is known."""
    rng = np.random.default_rng(1)
    image, _ = depth_sum_of(121, 9, 0.0, CLEAN, rng, fill=radius / 121)
    found = fit_aperture(image)
    assert found.confident and found.kind == "polygon"
    assert found.curvature < 2 * found.curvature_sigma < 0.2


@pytest.mark.few(1)
@pytest.mark.parametrize(("stuck", "out"), [(2, -0.2), (6, 0.08), (0, -0.08)])
def test_a_stuck_blade_is_named_with_how_far(stuck, out):
    disturbance, fault = Disturbance(0.5), IrisFault(stuck, out)
    image, truth = depth_sum_of(187, 7, 0.3, disturbance, np.random.default_rng(5), fill=0.36, fault=fault)
    found = fit_aperture(image)
    assert found.confident and (found.kind, found.blades) == ("stuck blade", 7)
    assert found.stuck.blade == stuck
    away = found.stuck.direction_rad - truth.stuck.direction_rad
    assert abs((away + math.pi) % (2 * math.pi) - math.pi) < 0.1
    assert abs(found.stuck.out_px - truth.stuck.out_px) < 3 * found.stuck.sigma_px < 3
    way = "out" if out > 0 else "in"
    assert f"blade {stuck + 1} at " in found.describe() and f"too far {way}" in found.describe()


def test_something_dark_inside_is_an_obstruction():
    fault = IrisFault(obstructed=0.2)
    image, truth = depth_sum_of(151, 8, 0.0, Disturbance(0.05), np.random.default_rng(2), fault=fault)
    found = fit_aperture(image)
    assert found.confident and (found.kind, found.blades) == ("obstructed", 8)
    place = truth.centre[0], truth.centre[1] + 0.5 * truth.apothem_px
    assert math.dist(found.obstruction.centre, place) < 2
    assert found.obstruction.share == pytest.approx(math.pi * (0.2 * truth.apothem_px) ** 2 / truth.area_px2, rel=0.3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("blades", "curvature", "central", "noise"),
    [(6, 0.0, 0.35, 0.1), (9, 1.0, 0.35, 0.01), (8, 0.0, 0.7, 0.05)],
)
def test_an_annular_stop_is_named_with_its_size(blades, curvature, central, noise):
    fault = IrisFault(central=central)
    image, truth = depth_sum_of(151, blades, curvature, Disturbance(noise), np.random.default_rng(3), fault=fault)
    found = fit_aperture(image)
    assert found.confident and (found.kind, found.blades) == ("annular", truth.blades)
    assert found.area_px2 == pytest.approx(truth.area_px2, rel=0.02)
    dark = math.pi * (central * truth.apothem_px) ** 2
    assert found.obstruction.share == pytest.approx(dark / truth.area_px2, rel=0.1)
    percent = round(100 * math.sqrt(found.obstruction.share))
    assert f"central obstruction of {percent} % of the diameter" in found.describe()


@pytest.mark.long
def test_a_central_obstruction_is_named_where_the_shape_is_unclear():
    image, _ = depth_sum_of(151, 9, 1.0, Disturbance(0.3), np.random.default_rng(3), fault=IrisFault(central=0.4))
    found = fit_aperture(image)
    assert found.refusal == "unclear" and math.isnan(found.confidence)
    assert "unknown shape" in found.describe() and "central obstruction" in found.describe()


def test_a_spot_in_focus_is_no_aperture_and_not_called_dim():
    rows, columns = np.indices((17, 17)) - 8.0
    image = np.exp(-((rows**2 + columns**2) / 2.3**2)) + np.random.default_rng(1).normal(0, 1e-3, rows.shape)
    found = fit_aperture(image)
    assert found.refusal == "in focus" and not found.confident and math.isnan(found.confidence)
    assert "in focus" in found.describe()


def test_an_iris_cut_off_by_the_cutout_is_refused():
    image, _ = synthetic(7, 0.0, 1, side=151)
    assert fit_aperture(image[:, 25:]).refusal == "cut off"
    assert fit_aperture(image[30:-30, 30:-30]).refusal == "cut off"


def test_a_cat_eye_is_recognised_and_its_outline_drawn():
    rows, columns = np.indices((151, 151)) - 75.0
    lens = (np.hypot(rows, columns - 9) < 58) & (np.hypot(rows, columns + 9) < 58)
    image = ndimage.gaussian_filter(lens.astype(float), 2) + np.random.default_rng(1).normal(0, 0.03, lens.shape)
    found = fit_aperture(image)
    assert (found.kind, found.confident, found.blades) == ("cat's eye", True, 0)
    row, column = found.outline(720).T
    assert np.ptp(row) == pytest.approx(2 * math.sqrt(58**2 - 9**2), abs=1.5)
    assert np.ptp(column) == pytest.approx(2 * 49, abs=1)


@pytest.mark.long
def test_an_outline_of_no_known_iris_is_refused():
    rows, columns = np.indices((151, 151)) - 75.0
    angle = np.arctan2(rows, columns)
    star = np.hypot(rows, columns) < 50 * (1 + 0.15 * np.cos(3 * angle) + 0.1 * np.cos(8 * angle))
    found = fit_aperture(ndimage.gaussian_filter(star.astype(float), 2))
    assert found.refusal == "irregular" and not found.confident and not found.kind
    assert math.isnan(found.confidence)
    assert "blades" not in found.describe()


def test_darkness_and_sums_of_too_few_pixels_are_refused():
    for image in (np.random.default_rng(0).normal(0, 1, (99, 99)), np.zeros((99, 99)), np.full((99, 99), 7.0)):
        found = fit_aperture(image)
        assert found.refusal == "too dim" and not found.confident
        assert "too dim" not in found.describe() and "noise" in found.describe()
    for shape in ((8, 20), (7, 7), (1, 15), (1, 1)):
        found = fit_aperture(np.ones(shape))
        assert found.refusal == "too small" and not found.seen and not found.confident
        assert "too few pixels" in found.describe()
    for shape in ((5,), (0, 40), (2, 9, 9)):
        with pytest.raises(InputError, match="sum of a depth plane"):
            fit_aperture(np.zeros(shape))


def test_values_of_no_patch_at_all_are_no_error_and_no_shape():
    # tails so heavy that centre and size of what is "lit" ran away from the image
    for seed in (3, 4, 17, 24, 123, 307):
        found = fit_aperture(np.random.default_rng(seed).standard_cauchy((38, 37)))
        assert not found.confident and found.refusal


def test_an_edge_that_no_outline_changes_is_no_error():
    edge = measured_edge(*_lit(synthetic(side=61, disturbance=CLEAN)[0]))
    assert edge is not None
    # blurred until no harmonic is left of it
    found = circle(replace(edge, damping=np.zeros_like(edge.damping)))
    assert np.isfinite(found.chi2) and np.isfinite(found.parameters).all()


def test_not_a_number_and_hot_pixels_do_not_move_the_answer():
    image, truth = synthetic(9, 0.0, 8)
    image[40:43, 60] = np.nan
    image[10, 10] = np.inf
    image[50, 50] = 1e6
    found = fit_aperture(image)
    assert found.confident and found.blades == 9
    assert math.dist(found.centre, truth.centre) < 0.15


def test_the_unit_of_the_image_does_not_matter():
    image, _ = synthetic(8, 0.2, 3)
    one, other = fit_aperture(image), fit_aperture(image * 6.4e7)
    assert one.centre == pytest.approx(other.centre, abs=1e-3)
    assert one.snr == pytest.approx(other.snr, rel=1e-3)


# -- shapes and f-numbers ----------------------------------------------------------------------------------------------


def test_every_edge_point_lies_on_the_arc_of_its_blade() -> None:
    rotation, apothem = 0.3, 40.0
    theta = np.linspace(0, 2 * math.pi, 997)
    for blades, curvature in itertools.product((5, 8, 11), (0.0, 0.4, 0.9)):
        r = blade_radius(theta, blades, rotation, apothem, curvature)
        step = 2 * math.pi / blades
        middle = rotation + step * (np.floor((theta - rotation) / step) + 0.5)
        x, y = r * np.cos(theta - middle), r * np.sin(theta - middle)
        if curvature == 0:
            assert np.allclose(x, apothem)
        else:
            radius = apothem / curvature
            assert np.allclose(np.hypot(x + radius - apothem, y), radius)
    assert np.allclose(blade_radius(theta, 7, 0.1, 3.0, 1.0), 3.0), "a curvature of one is a circle"
    theta = np.linspace(0, 2 * math.pi, 200_001)[:-1]
    for blades, curvature in ((5, 0.0), (6, 0.35), (9, 0.8), (7, 1.0)):
        r = blade_radius(theta, blades, 0.2, 12.0, curvature)
        assert polygon_area(blades, 12.0, curvature) == pytest.approx(math.pi * np.mean(r**2), rel=1e-6)


def test_vertices_and_outlines_lie_as_stated_rows_downwards():
    aperture = Aperture(4, (10.0, 20.0), math.radians(30), 5.0, polygon_area(4, 5.0))
    row, column = aperture.vertices()[0]
    reach = 5 / math.cos(math.pi / 4)
    assert (row - 10, column - 20) == pytest.approx((reach * 0.5, reach * math.sqrt(3) / 2))
    # a stretched outline is longer along its axis
    aperture = Aperture(0, (0.0, 0.0), 0.0, 50.0, math.pi * 2500, 1.0, ellipticity=0.1, ellipse_axis_rad=0.7)
    row, column = aperture.outline(3600).T
    reach = np.hypot(row, column)
    assert reach.min() / reach.max() == pytest.approx(0.9, abs=1e-6)
    k = int(np.argmax(reach))
    assert math.atan2(row[k], column[k]) % math.pi == pytest.approx(0.7, abs=2e-3)


def test_an_aperture_checks_its_values():
    good = {"blades": 5, "centre": (0.0, 0.0), "rotation_rad": 0.0, "apothem_px": 1.0, "area_px2": 1.0}
    for values in ({"blades": 2}, {"refusal": "shy"}, {"refusal": "circle", "confident": True}):
        with pytest.raises(InputError):
            Aperture(**good | values)


def test_an_f_number_is_the_slope_of_diameters_and_has_their_error():
    a = np.array([-4000.0, -2500, 1500, 3000, 5000])  # on both sides of the native plane
    found = working_f_number(np.abs(a - 120) / 5.2 / 5.5, a, 5.5)
    assert found.value == pytest.approx(5.2, rel=1e-9) and found.offset_um == pytest.approx(120)
    # one wrong diameter and the blur of the edge
    a = np.linspace(1000, 5000, 9)
    diameters = a / 4.8 / 5.5 + 2.0
    diameters[4] *= 1.3
    assert working_f_number(diameters, a, 5.5).value == pytest.approx(4.8, rel=0.01)
    through_zero = (a @ a) / (a @ diameters) / 5.5  # counter-test: without a constant the blur goes into the slope
    assert abs(through_zero - 4.8) > 0.05
    # N = (a2 - a1)/(D2 - D1): of independent errors s, dN = sqrt(2) s N²/(a2 - a1)
    a = np.array([1000.0, 3000.0])
    diameters = a / 5.0 / 5.5
    assert math.isnan(working_f_number(diameters, a, 5.5).standard_error)
    found = working_f_number(diameters, a, 5.5, [0.5, 0.5])
    assert found.standard_error == pytest.approx(math.sqrt(2) * 0.5 * 5.5 * 25 / 2000, rel=1e-6)
    with_scatter = working_f_number([40.0, 80.0, 100.0], [1000.0, 2000.0, 3000.0], 5.5, [1e-6] * 3)
    assert with_scatter.standard_error > 0.1


def test_an_f_number_needs_diameters_that_change_between_two_depths():
    for diameters, shifts, words in (
        ([10.0], [1.0], "expected one diameter for each of two or more depths, got 1 diameter and 1 depth"),
        ([10.0] * 2, [2.0, 2.0], "expected two or more different depths, got equal depths"),
        ([10.0] * 2, [1.0, math.nan], "expected finite numbers, got NaN or infinity"),
        # the slope of equal diameters is a rounding error, not 0; N was 2e16
        ([10, 10], [264, 528], "expected diameters that change with depth, got a constant diameter"),
        ([7.3] * 5, [100, 210, 333, 470, 900], "got a constant diameter"),
        ([0, 0], [264, 528], "got a constant diameter"),
    ):
        with pytest.raises(InputError, match=words):
            working_f_number(diameters, shifts, 5.5)
    # on both sides of the native plane, equal diameters determine N
    assert working_f_number([10, 10], [-264, 264], 5.5).value == pytest.approx(4.8)


# -- arcs --------------------------------------------------------------------------------------------------------------


ANGLES = np.linspace(0, 2 * math.pi, 500, endpoint=False)


def test_a_regular_iris_has_the_radius_of_its_closed_form():
    for blades, curvature in ((5, 0.0), (9, 0.4), (12, 0.9)):
        arcs = Arcs(40.0, curvature, blades, 0.3)
        assert np.allclose(arcs.radius(ANGLES), blade_radius(ANGLES, blades, 0.3, 40.0, curvature))


def test_rays_from_elsewhere_end_on_the_same_outline():
    arcs = Arcs(30.0, 0.2, 7, 0.1, stuck=2, stuck_share=-0.1, rim=(4.0, 0.8, 0.5), stretch=0.05, shear=-0.03)
    row, column = 4.0, -6.0
    radius = arcs.radius(ANGLES, row, column)
    y, x = row + radius * np.sin(ANGLES), column + radius * np.cos(ANGLES)
    assert np.allclose(np.hypot(x, y), arcs.radius(np.arctan2(y, x)))
    # a stretch brings the outline onto the arcs
    radius = Arcs(30.0, stretch=0.1, shear=0.05).radius(ANGLES)
    x, y = radius * np.cos(ANGLES), radius * np.sin(ANGLES)
    assert np.allclose(np.hypot(1.1 * x + 0.05 * y, 0.05 * x + 0.9 * y), 30.0)


def test_a_stuck_blade_is_moved_by_its_share():
    middle = np.array([0.2 + 4.5 * math.pi / 3])
    # straight blades of a hexagon meet where a blade has moved by a third of the apothem, which 15 % is not
    for share in (-0.15, 0.1):
        arcs = Arcs(30.0, 0.0, 6, 0.2, stuck=4, stuck_share=share)
        assert arcs.radius(middle)[0] == pytest.approx(30.0 * (1 + share))
        assert arcs.radius(middle + math.pi)[0] == pytest.approx(30.0)


def test_a_rim_cuts_at_its_distance_with_its_own_circle():
    arcs = Arcs(30.0, rim=(1.0, 0.7, 0.5))
    radius = arcs.radius(ANGLES)
    x, y = radius * np.cos(ANGLES), radius * np.sin(ANGLES)
    # a circle of radius 60, whose nearest point lies 21 from the middle
    behind = 60.0 - 21.0
    away = np.hypot(x + behind * math.cos(1.0), y + behind * math.sin(1.0))
    assert (np.isclose(away, 60.0) | np.isclose(radius, 30.0)).all()
    assert np.isclose(away, 60.0).sum() > 100 and np.isclose(radius, 30.0).sum() > 100


# -- expected shadows --------------------------------------------------------------------------------------------------


BENCH = preset("bench")


def test_the_expected_shadow_follows_rays():
    gap, optics = BENCH.lattice.gap_um, BENCH.optics
    for virtual_depth in (4.0, -3.0):
        depth = BENCH.depth_of(virtual_depth)
        found = expected_aperture(BENCH, depth, (61, 71))
        # a ray from the pupil's rim to the image, met by the sensor on its way
        rim, image = (
            optics.focal_length_um / optics.f_number / 2,
            optics.image_distance_um + BENCH.image_shift_um(depth),
        )
        height = rim + (0 - rim) * (optics.image_distance_um + gap) / image
        assert found.diameter_px == pytest.approx(2 * abs(height) / BENCH.sensor.pixel_um)
        assert found.centre == (30, 35) and found.blades == optics.blades
        step = 2 * math.pi / optics.blades
        # rays that have crossed the axis draw the iris turned by half
        turned = 0.0 if height > 0 else math.pi
        assert found.rotation_rad == pytest.approx((optics.blade_rotation_rad + turned) % step)


def test_a_microscope_and_an_open_lens_are_round():
    scope = preset("lfm_20x05")
    assert expected_aperture(scope, 22.0, (101, 101)).kind == "round"
    open_lens = replace(BENCH, optics=replace(BENCH.optics, blades=0))
    assert expected_aperture(open_lens, open_lens.depth_of(3.0), (61, 61)).blades == 0


def test_a_lenslet_spreads_light_over_its_own_image():
    # 58.3 µm, of which the strongest type's lenslets leave four fifths on a sensor of 5.5 µm
    assert footprint_px(BENCH) == pytest.approx(0.8 * 58.3 / 5.5)
    assert footprint_px(BENCH, (2.0, 2.0)) == pytest.approx(2 * footprint_px(BENCH))
    assert footprint_px(None) == 0


# -- the iris of all planes --------------------------------------------------------------------------------------------


def plane(blades, curvature, seed, *, noise=0.3):
    disturbance = Disturbance(noise, ellipticity=0.0)
    image, truth = depth_sum_of(131, blades, curvature, disturbance, np.random.default_rng(seed))
    # all planes of an iris share its rotation: to turn the image would blur it, so the result of the fit is turned
    return fit_aperture(image), truth


def upright(found, truth, turned):
    """Return what the fit said, as if the iris had its first vertex at 0.2 rad, or upside down."""
    shift = 0.2 + (math.pi if turned else 0.0) - truth.rotation_rad
    counts = tuple(replace(c, rotation_rad=(c.rotation_rad + shift) % (2 * math.pi / c.blades)) for c in found.counts)
    return replace(found, counts=counts)


def planes(blades, curvature, noise, sides):
    found = [plane(blades, curvature, seed, noise=noise) for seed in range(len(sides))]
    return [upright(*one, side) for one, side in zip(found, sides, strict=True)]


@pytest.mark.long
def test_planes_that_are_unclear_add_to_a_clear_one():
    sides = [False, True, False, True]
    seen = [*planes(9, 0.6, 0.2, sides[:1]), *planes(9, 0.6, 0.5, sides)[1:]]
    assert seen[0].confident and not all(a.confident for a in seen)
    iris = joint_iris(seen, sides)
    assert iris.confident and iris.blades == 9 and iris.planes == len(seen)
    assert abs(iris.curvature - 0.6) < 3 * iris.curvature_sigma
    assert iris.rotation_rad == pytest.approx(0.2, abs=0.03)
    assert iris.curvature_sigma < min(c.curvature_sigma for a in seen for c in a.counts if c.blades == 9)


def test_planes_that_are_each_unclear_state_no_iris():
    """A partly blocked iris made two unclear planes, whose joint count had a small error and was wrong."""
    seen = [replace(a, kind="", confident=False, refusal="unclear") for a in planes(6, 0.0, 0.05, [False, True])]
    assert joint_iris(seen, [False, True]) is None
    assert joint_iris([*planes(6, 0.0, 0.05, [False]), seen[1]], [False, True]).blades == 6


@pytest.mark.long
def test_a_side_taken_for_the_other_contradicts():
    sides = [False, True, False, True]
    seen = planes(9, 0.0, 0.05, sides)
    right = joint_iris(seen, sides)
    wrong = joint_iris(seen, [False] * 4)
    assert right.confident and right.blades == 9
    # half a step apart in every second plane
    assert wrong.blades != 9 or wrong.margin < right.margin / 2


def test_round_stops_stay_round_and_nothing_stays_nothing():
    seen = planes(9, 1.0, 0.02, [False, True])
    iris = joint_iris(seen, [False, True])
    assert (iris.blades, iris.confident) == (0, True) and "round" in iris.describe()
    assert joint_iris([fit_aperture(np.zeros((31, 31)))], [None]) is None


# -- spikes ------------------------------------------------------------------------------------------------------------


def test_spikes_go_and_corners_stay():
    """A clean corner lies far off the median of its neighbours, as a hot pixel does, but within their range."""
    image = np.zeros((41, 41))
    assert despike(image) is image, "without noise it is left alone"
    image[10:31, 10:31] = 1.0
    image += np.random.default_rng(0).normal(0, 1e-3, image.shape)
    hot = image.copy()
    hot[20, 20] += 1.0
    hot[5, 5] += 0.5
    clean = despike(hot)
    assert abs(clean[20, 20] - 1) < 0.01 and abs(clean[5, 5]) < 0.01
    untouched = np.ones(image.shape, bool)
    untouched[20, 20] = untouched[5, 5] = False
    assert np.array_equal(clean[untouched], hot[untouched])


# -- ripple ------------------------------------------------------------------------------------------------------------


def disc(waves, noise, seed=0, side=161):
    """Return an even disc with (pitch, direction, amplitude, phase) waves, and the waves alone."""
    y, x = np.indices((side, side)) - 80.0
    total = np.zeros((side, side))
    for pitch, turn, size, phase in waves:
        q = 2 * math.pi / pitch
        total += size * np.cos(q * (x * math.cos(turn) + y * math.sin(turn)) + phase)
    lit = np.hypot(x, y) < 70
    return lit * (1 + total) + np.random.default_rng(seed).normal(0, noise, lit.shape), total


@pytest.mark.parametrize(
    "waves", [[(26, 0.3, 0.03, 1.0)], [(40, t, 0.02, p) for t, p in ((0.1, 0), (1.15, 2), (2.2, 4))]]
)
def test_waves_are_found_inside_and_hold_at_the_edge(waves):
    flat, truth = disc(waves, 0.02)
    found = find_ripple(flat, 80.0, 80.0, 60.0)
    assert len(found.waves) == len(waves)
    y, x = np.indices(flat.shape) - 80.0
    ring = (np.hypot(x, y) > 60) & (np.hypot(x, y) < 70)
    error = found.at(x, y) - truth
    assert np.std(error[ring]) < 0.12 * np.std(truth[ring])
    clean = found.removed(flat, 80.0, 80.0, 75.0)
    inside = np.hypot(x, y) < 68
    assert np.std(clean[inside]) < 1.05 * 0.02


def test_noise_and_shading_are_no_ripple():
    flat, _ = disc([], 0.05)
    y, x = np.indices(flat.shape) - 80.0
    assert find_ripple(flat, 80.0, 80.0, 60.0).amplitude == 0
    shaded = flat * (1 - 0.3 * (x**2 + y**2) / 4900 + 0.1 * x / 70)
    found = find_ripple(shaded, 80.0, 80.0, 60.0)
    assert found.amplitude == 0 and math.isnan(found.pitch_px)


# -- size --------------------------------------------------------------------------------------------------------------


def diffracted_disc(radius, fringe_px, side=73, blur_px=1.5, over=5):
    """Return a disc behind whose edge light is diffracted as by a straight one (Born & Wolf 8.7.3), then blurred."""
    n = side * over
    at = (np.arange(n) + 0.5) / over - 0.5 - (side - 1) / 2
    inside = radius - np.hypot(at[:, None], at)
    s, c = special.fresnel(inside / fringe_px)
    light = 0.5 * ((0.5 + c) ** 2 + (0.5 + s) ** 2)
    fine = ndimage.gaussian_filter(light, blur_px * over)
    return fine.reshape(side, over, side, over).mean((1, 3))


@pytest.mark.parametrize(("radius", "fringe"), [(13.5, 2.0), (24.1, 3.0)])
def test_light_that_diffraction_takes_outwards_belongs_to_the_outline(radius, fringe):
    found = fit_aperture(diffracted_disc(radius, fringe))
    truth = math.pi * radius**2
    assert abs(found.area_px2 - truth) < 0.02 * truth
    assert abs(found.area_px2 - truth) < 2 * found.area_sigma_px2 < 0.08 * truth
    assert found.diameter_sigma_px == pytest.approx(found.area_sigma_px2 / (math.pi * found.diameter_px / 2), rel=1e-6)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(("noise", "blur"), [(0.02, 2.0), (0.3, 2.0), (0.3, 4.0), (1.0, 1.0)])
def test_the_area_lies_within_its_stated_error_and_that_is_small(noise, blur):
    off = []
    for seed in range(8):
        image, truth = depth_sum_of(131, 7, 0.3, Disturbance(noise, blur), np.random.default_rng(seed))
        found = fit_aperture(image)
        assert found.area_sigma_px2 < 0.03 * truth.area_px2
        off.append((found.area_px2 - truth.area_px2) / found.area_sigma_px2)
    assert 0.05 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_shading_is_no_loss_of_area():
    image, truth = depth_sum_of(131, 7, 0.3, Disturbance(0.0, 1.5, vignetting=0.25), np.random.default_rng(3))
    assert fit_aperture(image).area_px2 == pytest.approx(truth.area_px2, rel=2e-3)


def test_without_an_even_level_no_error_is_stated_and_no_size_corrected():
    spot = diffracted_disc(4.0, 2.0, side=41)
    found = fit_aperture(spot)
    assert found.seen and math.isnan(found.area_sigma_px2) and math.isnan(found.diameter_sigma_px)
    assert "±" not in found.describe()


def test_sizes_are_stated_with_their_errors():
    found = fit_aperture(diffracted_disc(18.8, 2.5))
    assert f"diameter {found.diameter_px:.1f} ± {found.diameter_sigma_px:.1f} px" in found.describe()
    assert with_error(12.3, 0.0, 1) == "12.3 ± 0.0" and with_error(0.5, 0.00004, 1) == "0.500 ± 0.000"
