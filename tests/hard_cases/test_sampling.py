"""Grids, windows, precisions and sizes at which sums alias, drift or slow down."""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from lfcal.simulate.engines import _kernels as kernels
from lfcal.simulate.engines._geometric import GeometricPlane
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import EnergyError, Sampling
from lfcal.simulate.engines.masks import disc_table
from lfcal.simulate.engines.microscope import DebyePlane
from lfcal.simulate.scene import PupilIris
from tests.hard_cases.record import hard_case, worst
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, relative_error

QUICK = Sampling(nodes_per_px=3, margin_px=4)


@hard_case(
    "Window wider than lambda B / (2 dx)",
    wrong="aliases are counted as light: an energy of 7.65 instead of 1",
    measure="output energy divided by input energy, if the sampling follows the window (otherwise an error is raised)",
    bound=1.02,
)
def test_wide_window():
    with pytest.raises(EnergyError, match="samples_per_px") as error:
        WavePlane(camera_scene(3.0), Sampling(1.0, 4, 25)).point(0.0, 0.0)
    stated = re.search(r"got ([\d.]+) times", str(error.value))
    assert stated is not None
    assert float(stated[1]) > 1.3
    engine = WavePlane(camera_scene(3.0), Sampling(None, 4, 25))
    engine.point(0.0, 0.0)
    return engine.certificate.worst


@hard_case(
    "Hard-edged apertures",
    wrong="the area of a hard mask on samples of 2.75 µm has an error of 4e-4",
    measure="largest error of the area of the low-pass filtered mask, over positions between two samples",
    bound=5e-5,
)
def test_aperture_area():
    radius, dx = 85.0, 2.75
    table, step = disc_table(radius, dx, 100.0)
    x = np.arange(-36, 37) * dx
    errors = []
    for place in (0.0, 0.3, 1.1):
        r2 = (x[None, :] - place) ** 2 + (x[:, None] + place / 2) ** 2
        mask = np.interp(r2, step * np.arange(table.size), table) * (r2 < 99.0**2)
        errors.append(abs(mask.sum() * dx**2 / (math.pi * radius**2) - 1))
    return worst(*errors)


@pytest.mark.long  # kernels in double precision take seconds to compile
@hard_case(
    "Single precision in the far field",
    wrong="phases of thousands of radians lose digits in single precision",
    measure="relative L1 difference from double precision",
    bound=2e-6,
)
def test_single_far():
    single, double = (
        WavePlane(camera_scene(4.0), Sampling(None, 3, 4, double=d)).point(4.0, 9.0) for d in (False, True)
    )
    return relative_error(single, double)


@hard_case(
    "Single precision far from the origin",
    wrong="in single precision, neighbouring numbers near one metre differ by 0.1 µm",
    measure="relative L1 change of the response a million pixels away",
    bound=1e-5,
)
def test_far_from_origin():
    px = 5.4321  # no whole number of it is exact in single precision
    lattice = replace(camera_scene().lattice, pitch_um=15 * px, clear_um=14.5 * px)
    engine = WavePlane(camera_scene(3.0, pixel_um=px, lattice=lattice), QUICK)
    here, there = (engine.rows([0], [x])[0, 0] for x in (0, 45 * 22222))
    return relative_error(there, here)


@hard_case(
    "Denormal numbers in a matrix",
    wrong="a hundred denormal numbers make a product three times slower",
    measure="number of denormal entries in the matrices of the microscope",
    bound=0.0,
)
def test_no_denormals():
    tiny, found = np.finfo(np.float32).tiny, 0
    for scene in (microscope_scene(1.0, cutout=(91, 91)), microscope_scene(1.0, cutout=(31, 31), vectorial=True)):
        engine = DebyePlane(scene, Sampling(nodes_per_px=2))
        engine.rows([0, 4], [0, 3])
        stored = (*engine._quarters, *engine._lefts.values(), *engine._rights.values())
        for values in (*engine._matrices.values(), *(part for parts in stored for part in parts)):
            found += int(((values != 0) & (np.abs(values) < tiny)).sum())
    return float(found)


@hard_case(
    "Matrix products within threads",
    wrong="a BLAS library starts threads inside each thread, which is ten times slower",
    measure="multiply-adds of one call divided by the number at which threads start, minus 1; error of the product",
    bound=1e-5,
)
def test_small_products():
    rng = np.random.default_rng(0)
    a, b = rng.random((300, 90), np.float32), rng.random((90, 200), np.float32)
    out = np.empty((300, 200), np.float32)
    kernels._product(a, b, out)
    wrong = relative_error(out, a.astype(float) @ b.astype(float))
    sizes = []
    plain = inspect.unwrap(getattr(kernels._product, "py_func", kernels._product))
    with pytest.MonkeyPatch.context() as patch:  # the same function, not compiled: each of its products is seen
        dot = np.dot
        patch.setattr(np, "dot", lambda a, b, out: sizes.append(a.size * b.shape[1]) or dot(a, b, out))
        plain(a, b, out)
    return worst(max(sizes) / (1 << 18) - 1, wrong)


@hard_case(
    "Cutout of one pixel",
    wrong="windows larger than the image are written outside it",
    measure="change of the central pixel relative to a large cutout, all levels",
    bound=5e-5,
)
def test_one_pixel():
    small, large = camera_scene(3.0, cutout=(1, 1)), camera_scene(3.0, cutout=(41, 41))
    between = (8.0, 2.0)  # the lenslet is farther away than the cutout is large
    changes = []
    for make in (lambda s: WavePlane(s, QUICK), GeometricPlane):
        one, many = make(small).point(*between), make(large).point(*between)
        changes.append(abs(float(one[0, 0] / many[20, 20]) - 1))
    return worst(*changes)


@hard_case(
    "Cutouts of extreme shape",
    wrong="code assumes square arrays, or confuses rows and columns",
    measure="change of the pixels shared with a square cutout, divided by the peak (light from outside is estimated)",
    bound=1e-4,
)
def test_long_cutouts():
    wide, tall, square = ((3, 81), (81, 3), (81, 81))
    images = {
        shape: WavePlane(camera_scene(3.0, cutout=shape), QUICK).point(3.0, 2.0) for shape in (wide, tall, square)
    }
    whole = images[square]
    parts = [(images[wide], whole[39:42]), (images[tall], whole[:, 39:42])]
    return worst(*(float(np.abs(a - b).max() / whole.max()) for a, b in parts))


@hard_case(
    "Period of one position",
    wrong="positions are taken modulo 1, and ranges of rows are empty",
    measure="change relative to the same position of a long period",
    bound=0.0,
)
def test_period_of_one():
    one, many = camera_scene(3.0, period=(1, 1)), camera_scene(3.0)
    found = WavePlane(one, QUICK)
    assert found.predicted_seconds(1) > 0
    return relative_error(found.rows([0], [0]), WavePlane(many, QUICK).rows([0], [0]))


@hard_case(
    "Threads",
    wrong="two threads add to the same array",
    measure="largest difference between one thread and three threads",
    bound=0.0,
)
def test_threads():
    engine = WavePlane(camera_scene(1.1), QUICK)  # fields of lenslets are added: scratch arrays are reused
    ys, xs = range(6), [0, 7, 20]
    return float(np.abs(engine.rows(ys, xs, workers=1) - engine.rows(ys, xs, workers=3)).max())


@hard_case(
    "Chief ray on the border of two pixels",
    wrong="the cutout jumps, or a row of light is lost",
    measure="change of the light between the two possible cutouts, divided by the peak",
    bound=1e-3,
)
def test_pixel_border():
    engine = WavePlane(camera_scene(3.0), Sampling(nodes_per_px=4, margin_px=8))
    below, above = engine.point(0.0, 0.5 * PIXEL - 1e-6), engine.point(0.0, 0.5 * PIXEL + 1e-6)
    return float(np.abs(below[:, 1:] - above[:, :-1]).max() / below.max())


@hard_case(
    "Squares of faint responses",
    wrong="the squares of unnormalised responses of 1e-21 are zero",
    measure="smallest normal number divided by the square of 1e-4 of the peak, at v = 1e4",
    bound=1e-6,
)
def test_faint_squares():
    image = GeometricPlane(camera_scene(1e4, iris=PupilIris())).point(0.0, 0.0)
    return float(np.finfo(np.float32).tiny / (1e-4 * float(image.max())) ** 2)


@pytest.mark.long
@hard_case(
    "Windows a pixel wider than the spots",
    wrong="the light of a lenslet falls off slowly, and the part outside the window is lost",
    measure="missing or excess light of narrow windows in a wide cutout, compared with windows thirty pixels wider",
    bound=0.006,
)
def test_narrow_windows():
    scene = camera_scene(4.0, cutout=(91, 91))
    narrow, wide = (
        WavePlane(scene, Sampling(nodes_per_px=4, margin_px=margin, coherent=False)).point(2 * PIXEL, -3 * PIXEL)
        for margin in (1, 30)
    )
    return abs(float(narrow.sum(dtype=np.float64) / wide.sum(dtype=np.float64)) - 1)
