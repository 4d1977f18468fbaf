import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.aperture import Trial, run
from lfcal.base.errors import InputError
from lfcal.psf.aperture import fit_aperture
from lfcal.psf.aperture._compare import circle
from lfcal.psf.aperture._edge import measured_edge
from lfcal.psf.aperture._locate import find_patch
from lfcal.psf.aperture._profile import edge_profile
from lfcal.psf.aperture._synthetic import Disturbance, IrisFault, depth_sum_of
from lfcal.psf.aperture._verdict import CERTAIN

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


@pytest.mark.parametrize("blades", [5, 8, 11])
def test_a_clean_iris_is_recovered_to_small_fractions_of_a_pixel(blades):
    image, truth = synthetic(blades, 0.3, 1, disturbance=CLEAN)
    found = fit_aperture(image)
    assert found.confident and found.blades == blades
    assert math.dist(found.centre, truth.centre) < 0.02
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


def test_rows_and_columns_of_the_centre_are_not_confused():
    image, truth = synthetic(7, 0.0, 2, side=131, disturbance=CLEAN)
    found = fit_aperture(image[:, 6:])
    assert found.centre == pytest.approx((truth.centre[0], truth.centre[1] - 6), abs=0.05)


@pytest.mark.few(1)
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


@pytest.mark.few(1)
@pytest.mark.parametrize("snr", [5, 20, 100])
def test_a_circle_is_told_as_round(snr):
    image, truth = synthetic(16, 1.0, 6, side=151, disturbance=Disturbance(1 / snr))
    found = fit_aperture(image)
    if snr == 5:
        # many nearly round blades cannot be excluded in this noise
        assert not found.confident or found.kind == "round"
        return
    assert (found.blades, found.kind, found.confident) == (0, "round", True)
    assert found.diameter_px == pytest.approx(truth.diameter_px, rel=0.02)
    assert math.dist(found.centre, truth.centre) < 1


@pytest.mark.few(3)
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


@pytest.mark.few(1)
@pytest.mark.parametrize("pattern", ["square", "hexagonal", "random"])
def test_ripple_hides_no_blades(pattern):
    image, _ = synthetic(9, 0.3, 12, side=187, disturbance=Disturbance(0.005, ripple=0.08, pattern=pattern))
    found = fit_aperture(image)
    assert found.confident and found.blades == 9
    assert abs(found.curvature - 0.3) < 3 * found.curvature_sigma


@pytest.mark.parametrize("radius", [37.0, 26.5, 18.5])
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


@pytest.mark.parametrize(
    ("blades", "curvature", "central", "noise"), [(9, 1.0, 0.35, 0.01), (6, 0.0, 0.35, 0.1), (8, 0.0, 0.7, 0.05)]
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


def test_a_cat_eye_is_told_and_its_outline_drawn():
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


@pytest.mark.parametrize("kind", ["noise", "zero", "constant"])
def test_darkness_is_refused(kind):
    rng = np.random.default_rng(0)
    image = {"noise": rng.normal(0, 1, (99, 99)), "zero": np.zeros((99, 99)), "constant": np.full((99, 99), 7.0)}[kind]
    found = fit_aperture(image)
    assert found.refusal == "too dim" and not found.confident
    assert "too dim" not in found.describe() and "noise" in found.describe()


@pytest.mark.parametrize("seed", [3, 4, 17, 24, 123, 307])
def test_values_of_no_patch_at_all_are_no_error_and_no_shape(seed):
    # tails so heavy that centre and size of what is "lit" ran away from the image
    found = fit_aperture(np.random.default_rng(seed).standard_cauchy((38, 37)))
    assert not found.confident and found.refusal


def test_an_edge_that_no_outline_changes_is_no_error():
    edge = measured_edge(*_lit(synthetic(side=61, disturbance=CLEAN)[0]))
    assert edge is not None
    # blurred until no harmonic is left of it
    found = circle(replace(edge, damping=np.zeros_like(edge.damping)))
    assert np.isfinite(found.chi2) and np.isfinite(found.parameters).all()


@pytest.mark.parametrize("shape", [(8, 20), (7, 7), (1, 15), (1, 1)])
def test_a_sum_of_too_few_pixels_has_no_outline(shape):
    found = fit_aperture(np.ones(shape))
    assert found.refusal == "too small" and not found.seen and not found.confident
    assert "too few pixels" in found.describe()


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


@pytest.mark.parametrize("shape", [(5,), (0, 40), (2, 9, 9)])
def test_what_is_no_image_is_an_input_error(shape):
    with pytest.raises(InputError, match="sum of a depth plane"):
        fit_aperture(np.zeros(shape))
