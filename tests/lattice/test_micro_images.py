"""Lattices that views are cut on: of a camera, of a part of its sensor, of one lens type."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.lattice import cropped, extract_views, fit_lattice, lattice_of, type_lattice
from tests.lattice.lattices import Straight
from tests.lattice.white_frames import draw_white

TYPES = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))


def camera_of(kind: str, turn: float = 0.013) -> Camera:
    types = TYPES if kind == "hexagonal" else TYPES[:1]
    lattice = LensletLattice(kind, 82.0, 400.0, types, turn, (7.0, -11.0), type_step=2 if len(types) == 3 else 1)
    return Camera("c", MainLens(), lattice, Sensor((330, 400), 5.0))


@pytest.mark.parametrize("kind", [pytest.param("square", marks=pytest.mark.long), "hexagonal"])
def test_a_described_camera_gives_what_its_white_image_gives(kind: str) -> None:
    truth = draw_white((330, 400), pitch=16.4, kind=kind, rotation=0.013, dead=0.0, snr=200.0, falloff=0.0)
    fit = fit_lattice(truth.frame)
    camera = camera_of(kind)
    camera = replace(camera, lattice=fit.to_lattice(camera))
    lattice = lattice_of(camera)
    assert (lattice.kind, lattice.shape) == (fit.kind, fit.shape)
    assert (lattice.pitch_px, lattice.row_pitch_px, lattice.rotation_rad) == pytest.approx(
        (fit.pitch_px, fit.row_pitch_px, fit.rotation_rad)
    )
    np.testing.assert_allclose(lattice.basis_px(), fit.basis_px())
    frame = np.random.default_rng(0).random(fit.shape)
    np.testing.assert_allclose(extract_views(frame, lattice).images, extract_views(frame, fit).images, atol=1e-5)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_points_and_lenslets_are_each_other_s_inverse(kind: str) -> None:
    lattice = lattice_of(camera_of(kind, 0.7), (100, 120), (40, 60))
    y, x = np.mgrid[0:100:7, 0:120:11].astype(float)
    index = lattice.lenslet_at(y, x)
    np.testing.assert_allclose(lattice.centres_px(index[..., 0], index[..., 1]), np.stack([y, x], -1), atol=1e-9)


def test_a_part_of_the_sensor_is_the_sensor_s_part() -> None:
    camera = camera_of("hexagonal")
    whole, part = lattice_of(camera), lattice_of(camera, (150, 170), (30, 50))
    np.testing.assert_allclose(part.centres_px(3, -2), whole.centres_px(3, -2) - (30, 50))
    frame = np.random.default_rng(0).random((330, 400))
    cut = extract_views(frame[30:180, 50:220], part)
    (y, x), step = cut.grid.corner_px, cut.step_px
    # the same lenslets, looked up one by one in the views of the whole frame along the lattice
    seen = {tuple(np.round(c - (30, 50), 6)) for c in extract_views(frame, whole).grid.centres_px}
    assert {tuple(np.round(c, 6)) for c in cut.grid.centres_px} <= seen
    assert cut.shape[0] * step[0] > 150 - 2 * 16.4 and cut.shape[1] * step[1] > 170 - 2 * 16.4
    assert min(y, x) >= cut.radius_px - 1


def test_frames_that_do_not_lie_on_the_sensor_are_refused_with_the_numbers() -> None:
    camera = camera_of("square")
    with pytest.raises(InputError, match=r"330 rows and 400 columns.*got 150 rows and 170 columns.*--origin"):
        lattice_of(camera, (150, 170))
    with pytest.raises(InputError, match=r"150 rows and 170 columns starting at row 200, column 0"):
        lattice_of(camera, (150, 170), (200, 0))
    for origin in ((-1, 0), (0, 0.5)):
        with pytest.raises(InputError, match="origin"):
            lattice_of(camera, (150, 170), origin)  # type: ignore[arg-type]
    assert cropped(lattice_of(camera), (330, 400)).shape == (330, 400)


@pytest.mark.parametrize("step", [1, 2])
def test_the_lenslets_of_a_type_are_a_lattice(step: int) -> None:
    camera = replace(camera_of("hexagonal"), lattice=replace(camera_of("hexagonal").lattice, type_step=step))
    every = lattice_of(camera)
    q, r = (v.ravel() for v in np.mgrid[-6:7, -6:7])
    places, types = every.centres_px(q, r), camera.lattice.type_of(q, r)
    for k in range(3):
        lattice = type_lattice(every, camera.lattice.type_of, k)
        index = lattice.lenslet_at(*places[types == k].T)
        np.testing.assert_allclose(index, np.rint(index), atol=1e-9)
        np.testing.assert_allclose(lattice.centres_px(*np.rint(index).T), places[types == k], atol=1e-9)
        found = lattice.among(list(zip(q.tolist(), r.tolist(), strict=True)))
        np.testing.assert_array_equal(found, np.rint(index).astype(int))
        others = lattice.lenslet_at(*places[types != k].T)
        assert (np.abs(others - np.rint(others)).max(1) > 0.3).all()
        assert lattice.pitch_px == pytest.approx(math.sqrt(3) * every.pitch_px)
        assert lattice.row_pitch_px == pytest.approx(math.sqrt(3) * every.row_pitch_px)
        assert lattice.rotation_rad == pytest.approx(every.rotation_rad - math.pi / 6)
        ideal = Straight("hexagonal", math.degrees(lattice.rotation_rad), (0, 0), lattice.pitch_px)
        np.testing.assert_allclose(lattice.basis_px(), ideal.basis_px(), atol=1e-9)


def test_a_lattice_without_types_has_none() -> None:
    camera = camera_of("square")
    with pytest.raises(InputError, match="a hexagonal lattice with a lens type 1, got a square lattice"):
        type_lattice(lattice_of(camera), camera.lattice.type_of, 1)


def test_views_of_a_type_lie_on_the_samples_of_all() -> None:
    """A frame in which each lenslet shows its type: views of a type show that type alone, at all samples."""
    camera = camera_of("hexagonal")
    every = lattice_of(camera)
    y, x = np.mgrid[:330, :400].astype(float)
    index = np.rint(every.lenslet_at(y, x)).astype(int)
    frame = 10.0 + camera.lattice.type_of(index[..., 0], index[..., 1])
    all_views = extract_views(frame, every, radius_px=4.0)
    for k in range(3):
        views = extract_views(frame, type_lattice(every, camera.lattice.type_of, k), radius_px=4.0, raster=every)
        np.testing.assert_allclose(views.images, 10.0 + k, atol=1e-5)
        assert views.step_px == all_views.step_px
        away = (np.array(views.grid.corner_px) - np.array(all_views.grid.corner_px)) / views.step_px
        assert away == pytest.approx(np.rint(away), abs=1e-9)
