"""The full coherent reference: its parts, its convergence, its error messages."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import LensletLattice, LensType
from lfcal.simulate.engines import reference
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.reference import ReferencePlane, pixel_bins
from lfcal.simulate.scene import PupilIris
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, moments, relative_error


def test_pixel_weights_integrate_what_is_band_limited():
    n, per_px = 60, 4
    x = np.arange(n) / per_px
    for fill, first in ((1.0, 24.0), (0.7, 21.3)):
        bins = pixel_bins(n, per_px, 3, first, fill)
        centres = first / per_px + np.arange(3)
        for waves in (0, 4, 13):
            f = waves / (n / per_px)
            wanted = fill * np.sinc(f * fill) * np.cos(2 * np.pi * f * centres + 0.3)
            assert np.abs(bins @ np.cos(2 * np.pi * f * x + 0.3) - wanted).max() < 1e-14
    half_weights = np.array([0.5, 1, 1, 1, 0.5]) / per_px  # the trapezoid rule is far off at one wave per pixel
    wave = np.cos(2 * np.pi * 0.9 * np.arange(-2, 3) / per_px)
    assert abs(half_weights @ wave - np.sinc(0.9)) > 0.1 * np.sinc(0.9)


def test_exact_transfer_is_paraxial_for_small_angles_and_never_nan():
    f = np.fft.fftfreq(128, 40.0)
    exact, _ = sensor_propagator(f, 0.55, 800.0, True)
    paraxial, _ = sensor_propagator(f, 0.55, 800.0, False)
    assert np.abs(exact - paraxial[:, None] * paraxial[None, :]).max() < 1e-3
    steep, _ = sensor_propagator(np.fft.fftfreq(64, 0.2), 0.55, 800.0, True)
    assert np.isfinite(steep).all()
    assert (np.abs(steep) <= 1 + 1e-12).all()
    assert steep[32, 32] == 0  # evanescent


@pytest.mark.long
def test_finer_grids_come_to_the_same():
    scene = camera_scene(2.5, cutout=(45, 45))
    coarse, fine = (ReferencePlane(scene, Sampling(n)).point(3.0, 5.0) for n in (6.0, 9.0))
    assert relative_error(coarse, fine) < 0.01


def test_rows_are_points_and_follow_the_source():
    scene = camera_scene(2.5, cutout=(45, 45), iris=PupilIris())
    engine = ReferencePlane(scene, Sampling(5.0))
    row = engine.rows([1], [2, 47])[0]
    assert np.array_equal(row[0], engine.point(1 * PIXEL, 2 * PIXEL))
    assert relative_error(row[1], row[0]) < 1e-5  # a period of the array further
    between = engine.point(1 * PIXEL, 2.3 * PIXEL)
    assert 0 < moments(row[0])[1] - moments(between)[1] + 0.3 < 0.6
    certificate = engine.certificate
    assert certificate.responses == 4
    assert certificate.energy_out <= certificate.energy_in


def test_what_it_refuses():
    with pytest.raises(InputError, match="whole number"):
        ReferencePlane(camera_scene(), Sampling(2.5))
    with pytest.raises(InputError, match="samples on each side"):
        ReferencePlane(camera_scene(400.0), Sampling(8.0))


def test_lenslets_that_lie_alike_on_the_grid_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lattice = LensletLattice("square", 72.0, 1440.0, (LensType(1440.0),), offset_um=(3.0, -11.0))
    scene = microscope_scene(0.0, lattice=lattice, cutout=(21, 21))
    made = []
    own = ReferencePlane._lens_at
    monkeypatch.setattr(ReferencePlane, "_lens_at", lambda *given: made.append(given) or own(*given))
    held = ReferencePlane(scene, Sampling(samples_per_px=2)).rows([2], [3])
    assert len(made) == 1
    monkeypatch.setattr(ReferencePlane, "_lens", own)
    anew = ReferencePlane(scene, Sampling(samples_per_px=2)).rows([2], [3])
    assert relative_error(held, anew) < 1e-7


def test_lenslets_that_lie_otherwise_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "REFERENCE_CACHE_BYTES", 1e6)
    engine = ReferencePlane(camera_scene(2.5, cutout=(45, 45)), Sampling(5.0))
    engine.rows([1], [2])
    assert 0 < sum(lens.nbytes for lens in engine._cached.values()) <= 1e6
