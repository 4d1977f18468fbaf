"""The wave level: against the coherent reference, tables, light beyond windows; what all levels share."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import fresnel

from lfcal.base import WorkAbandoned, abandonable
from lfcal.camera import LensletLattice, LensType
from lfcal.simulate import Sampling
from lfcal.simulate.engines import EnergyError, PlaneEngine, engine_for, tables
from lfcal.simulate.engines import _tails as tails
from lfcal.simulate.engines import _wave as wave
from lfcal.simulate.engines._oblong import OblongPlane
from lfcal.simulate.engines._polygon import area, half_planes
from lfcal.simulate.engines._tail_kernels import add_tails
from lfcal.simulate.engines._tails import Tail
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import PupilIris, Scene, seidel
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, moments, relative_error

FINE = Sampling(nodes_per_px=4, margin_px=12, energy_floor=1e-3, coherent=True)
QUICK = Sampling(nodes_per_px=3, margin_px=5)


def at_both(scene, sampling=FINE, y=2 * PIXEL, x=-3 * PIXEL, samples=4.0):
    """Return the cutouts of the wave level and of the reference."""
    return WavePlane(scene, sampling).point(y, x), ReferencePlane(scene, Sampling(samples)).point(y, x)


@pytest.mark.few(2)
@pytest.mark.parametrize(("v", "bound"), [(3.0, 0.02), (1.15, 0.02), (-2.0, 0.02), (-0.5, 0.03)])
def test_responses_are_those_of_the_reference(v, bound):
    found, wanted = at_both(camera_scene(v, cutout=(61, 61)))
    assert relative_error(found, wanted) < bound
    assert np.allclose(moments(found), moments(wanted), atol=0.02)
    assert relative_error(np.roll(found, 1, 1), wanted) > 5 * bound, "a displacement by one pixel shows"


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "change",
    [
        {"wavefront": seidel(spherical=0.3, coma=0.2), "iris": PupilIris()},
        {"pixel_fill": 0.7},
        {"pupil_um": 20e3},
        {"aperture": "cell"},
    ],
)
def test_against_the_reference_with(change):
    scene = camera_scene(3.0, cutout=(61, 61), **change)
    sampling = replace(FINE, nodes_per_px=5) if "pixel_fill" in change else FINE  # narrow pixels need more nodes
    found, wanted = at_both(scene, sampling)
    assert relative_error(found, wanted) < 0.03
    plain = WavePlane(camera_scene(3.0, cutout=(61, 61)), FINE).point(2 * PIXEL, -3 * PIXEL)
    assert relative_error(plain, wanted) > 0.04


@pytest.mark.parametrize("flag", ["exact_rays", "exact_defocus"])
@pytest.mark.few(1)
def test_exact_angles_follow_the_reference(flag):
    """A fast cone on long lenslets: sines and tangents differ by more than the levels do."""
    pitch = 15 * PIXEL
    gap = 3.2 * pitch
    lattice = LensletLattice("square", pitch, gap, (LensType.focused_at(4.0, gap),), clear_um=pitch * 0.95)
    scene = camera_scene(4.0, lattice=lattice, image_um=4 * gap, f_number=3.2, cutout=(61, 61), period=(15, 15))
    found, wanted = at_both(replace(scene, **{flag: True}), samples=6.0)
    paraxial = WavePlane(scene, FINE).point(2 * PIXEL, -3 * PIXEL)
    assert relative_error(paraxial, wanted) > 0.05
    assert relative_error(found, wanted) < 0.5 * relative_error(paraxial, wanted)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_arrays_may_be_turned(kind):
    pitch = 15 * PIXEL
    gap = 5 * pitch
    lattice = LensletLattice(kind, pitch, gap, (LensType.focused_at(3.0, gap),), 0.3, (7.0, -3.0), clear_um=78.0)
    found, wanted = at_both(camera_scene(2.5, lattice=lattice, cutout=(61, 61)))
    assert relative_error(found, wanted) < 0.03


def test_a_single_lenslet_is_the_fresnel_pattern_of_its_aperture():
    """One square cell under a flat field: products of Fresnel integrals, pixel by pixel."""
    pitch = 15 * PIXEL
    gap = 5 * pitch
    lattice = LensletLattice("square", pitch, gap, (LensType(1e9),))
    scene = camera_scene(4.0, lattice=lattice, image_um=1e7, aperture="cell", cutout=(31, 31), period=(15, 15))
    engine = WavePlane(scene, Sampling(None, 6, 7, energy_floor=0.0))
    lens = engine.tables.kinds[0]
    n = lens.field.re.shape[0]
    flat = replace(lens, field=lens.field._replace(re=np.ones((n, n), np.float32), im=np.zeros((n, n), np.float32)))
    energy = np.zeros((n, n), np.float32)
    energy[n // 2, n // 2] = 1.0  # only the lenslet at the source
    engine.tables = replace(engine.tables, kinds=(replace(flat, energy=energy),), floor=0.5, reach_um=1.0)
    found = engine.point(0.0, 0.0)
    q = math.sqrt(2 / (scene.wavelength_um * gap))
    fine = (np.arange(31 * 24) - 31 * 12 + 0.5) * PIXEL / 24
    (s2, c2), (s1, c1) = fresnel(q * (fine + pitch / 2)), fresnel(q * (fine - pitch / 2))
    line = np.abs((c2 - c1) + 1j * (s2 - s1)) ** 2 / 2
    line = line.reshape(31, 24).mean(1) * PIXEL
    wanted = np.outer(line, line)
    inner = slice(5, 26)
    assert relative_error(found[inner, inner], wanted[inner, inner]) < 6e-3


def test_energy_out_never_exceeds_energy_in():
    for v in (3.0, -3.0, 0.5):
        engine = WavePlane(camera_scene(v, cutout=(121, 121)), QUICK)
        images = engine.rows([0, 7], [0, 11, 30])
        book = engine.certificate
        assert book.responses > 0 and book.energy_out <= book.energy_in * 1.002 and book.worst <= 1.02
        assert images.sum() <= book.energy_out * 1.001 and images.sum() == pytest.approx(book.energy_in, rel=0.06), v
    with pytest.raises(EnergyError, match="samples_per_px above 1"):  # a window wider than its samples allow
        WavePlane(camera_scene(3.0), Sampling(1.0, 3, 20)).point(0.0, 0.0)


def test_rows_points_and_offsets_are_the_same_responses():
    offsets = np.zeros((26, 45, 2))
    offsets[3, 5] = (1.3, -2.1)
    scene = camera_scene(3.0, offsets_um=offsets)
    engine = WavePlane(scene, QUICK)
    rows = engine.rows([3, 4], [5, 6, -40], workers=2)
    assert relative_error(rows[1, 1], engine.point(4 * PIXEL, 6 * PIXEL)) < 1e-6
    assert relative_error(rows[0, 0], engine.point(3 * PIXEL + 1.3, 5 * PIXEL - 2.1)) < 1e-6
    assert relative_error(rows[0, 2], rows[0, 0]) < 1e-5  # a period of 45 px further on, with its offset
    out = np.empty_like(rows)
    assert engine.rows([3, 4], [5, 6, -40], out=out, workers=1) is out
    assert np.array_equal(out, rows)


def test_every_level_is_a_plane_engine():
    for level in ("geometric", "wave", "reference"):
        sampling = Sampling(4.0) if level == "reference" else QUICK
        engine = engine_for(camera_scene(3.0, cutout=(31, 31)), level, sampling)
        assert isinstance(engine, PlaneEngine) and engine.level == level
        image = engine.rows([0], [0])[0, 0]
        assert image.dtype == np.float32 and np.isfinite(image).all()
        assert engine.predicted_seconds(10) == pytest.approx(10 * engine.predicted_seconds(1))
        assert engine.certificate.responses > 0
    rays = camera_scene(lenslet_diffraction=False)
    for level, scene in (("debye", camera_scene()), ("fast", camera_scene()), ("wave", rays)):
        with pytest.raises(ValueError, match=";"):
            engine_for(scene, level)


@pytest.mark.parametrize("level", ["grid", "wave"])
def test_a_block_of_rows_may_be_abandoned(level: str) -> None:
    engine = engine_for(camera_scene(4.0, cutout=(15, 15), period=(4, 3)), level)
    rows = []

    def wanted() -> bool:
        rows.append(engine.certificate.responses)
        return len(rows) <= 2

    with abandonable(wanted), pytest.raises(WorkAbandoned):
        engine.rows(range(4), range(3), workers=1)
    assert len(rows) == 3 and rows[2] > rows[1] > rows[0] == 0


def summed(scene, level, sampling, row, column):
    """Return the response on pixels 5 wide and 7 high, by sums over square ones."""
    (nt, ns), fifth = scene.cutout, scene.pixel_um / 5
    fine = replace(scene, pixel_um=fifth, pixel_aspect=1.0, cutout=(7 * nt, 5 * ns))
    image = engine_for(fine, level, sampling).rows([7 * row], [5 * column])[0, 0]
    return image.reshape(nt, 7, ns, 5).sum(axis=(1, 3))


@pytest.mark.parametrize(
    ("level", "scene", "bound"),
    [
        ("debye", microscope_scene(5.0, cutout=(27, 35), pixel_aspect=1.4), 1e-3),
        ("wave", camera_scene(3.0, cutout=(27, 35), pixel_aspect=1.4), 0.02),
        ("geometric", camera_scene(3.0, cutout=(27, 35), pixel_aspect=1.4), 0.15),
    ],
)
def test_oblong_pixels_have_the_light_of_the_square_ones_within(level, scene, bound):
    engine = engine_for(scene, level, Sampling(nodes_per_px=4, margin_px=8))
    assert isinstance(engine, OblongPlane) and isinstance(engine, PlaneEngine)
    wanted = summed(scene, level, Sampling(nodes_per_px=1, margin_px=40), 2, 3)
    found = engine.rows([2], [3])[0, 0]
    assert relative_error(found, wanted) < bound
    assert found.sum() == pytest.approx(wanted.sum(), rel=2e-3)
    assert np.allclose(engine.point(2 * 1.4 * scene.pixel_um, 3 * scene.pixel_um), found, atol=1e-6)
    # a source half a pixel off, and pixels taken for square ones, would show
    assert relative_error(engine.point(2.4 * 1.4 * scene.pixel_um, 3 * scene.pixel_um), wanted) > 1.5 * bound
    square = engine_for(replace(scene, pixel_aspect=1.0), level).rows([2], [3])[0, 0]
    assert relative_error(square, wanted) > 1.5 * bound


NARROW = Sampling(nodes_per_px=4, margin_px=1, coherent=False)
WIDE = Sampling(nodes_per_px=4, margin_px=30, coherent=False)
AT = (2 * PIXEL, -3 * PIXEL)


def square_scene() -> Scene:
    """Return square lenslets of 20 px that fill their cells, 0.3 out of focus."""
    pitch = 20 * PIXEL
    lattice = LensletLattice("square", pitch, 6 * pitch, (LensType.focused_at(3.5, 6 * pitch),))
    return camera_scene(3.0, lattice=lattice, image_um=18 * pitch, f_number=6.0, aperture="cell", cutout=(81, 81))


def without(patch: pytest.MonkeyPatch) -> None:
    """Leave tails out."""
    patch.setattr(tails, "add_tails", lambda *given: None)


def point(scene: Scene, sampling: Sampling) -> np.ndarray:
    """Return a response as float64."""
    return WavePlane(scene, sampling).point(*AT).astype(np.float64)


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", [camera_scene(4.0, cutout=(91, 91)), square_scene()], ids=["round", "square"])
def test_narrow_windows_have_the_light_of_wide_ones(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow, wide = point(scene, NARROW), point(scene, WIDE)
    without(monkeypatch)
    cut = point(scene, NARROW)
    assert abs(narrow.sum() / wide.sum() - 1) < 0.006
    assert cut.sum() / wide.sum() < 0.98
    assert relative_error(narrow, wide) < 0.6 * relative_error(cut, wide)


@pytest.mark.long
def test_tails_replace_most_of_what_wide_windows_have(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = camera_scene(4.0, cutout=(91, 91))
    truth = GridPlane(scene, Sampling(samples_per_px=6, margin_px=40)).point(*AT)
    narrow, wide = (relative_error(point(scene, s), truth) for s in (NARROW, WIDE))
    without(monkeypatch)
    cut = relative_error(point(scene, NARROW), truth)
    assert narrow - wide < 0.45 * (cut - wide)


def test_sums_of_fields_have_no_tails_and_whole_windows_add_none() -> None:
    assert WavePlane(camera_scene(4.0), Sampling(coherent=True))._tails == ()
    assert len(WavePlane(camera_scene(4.0), NARROW)._tails) == 3
    spots, image = np.zeros(1, wave.SPOT), np.zeros((1, 9, 9), np.float32)
    spots["energy_in"], spots["energy_out"] = 1.0, 1.1
    assert Tail(np.ones((5, 5), np.float32), 1.05, 0.1, True).add(spots, 1, image) == 0 and not image.any()


def test_tails_end_with_the_cutout() -> None:
    pattern = np.arange(49, dtype=np.float32).reshape(7, 7)
    for row, column in ((-4, -4), (7, 7), (-30, 2), (2, 30)):
        spots, image = np.zeros(1, wave.SPOT), np.zeros((1, 9, 9), np.float32)
        spots["top"], spots["left"] = row, column
        add_tails(spots, np.array([2.0]), pattern, 2, image)
        wanted = np.zeros((109, 109), np.float32)
        wanted[row + 48 : row + 55, column + 48 : column + 55] = 2 * pattern
        assert np.array_equal(image[0], wanted[50:59, 50:59]), (row, column)


def test_a_small_cutout_has_the_tails_of_lenslets_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = camera_scene(4.0, cutout=(9, 9)), camera_scene(4.0, cutout=(91, 91))
    wanted = point(large, NARROW)[41:50, 41:50]
    found = relative_error(point(small, NARROW), wanted)
    monkeypatch.setattr(Tail, "add_far", lambda *given: None)
    assert found < 0.2 * relative_error(point(small, NARROW), wanted)


def test_tails_keep_the_energy() -> None:
    """Except for what lies farther than tails are followed."""
    engine = WavePlane(camera_scene(4.0, cutout=(151, 151)), NARROW)
    light = float(engine.rows([2], [3, 9]).sum(dtype=np.float64))
    book = engine.certificate
    assert light == pytest.approx(book.energy_out, rel=2e-3)
    assert 0.99 < book.energy_out / book.energy_in < 1


def through_the_array(scene: Scene, source_um: tuple[float, float]) -> float:
    """Return the share of a cone's rays, even over a round shadow, that meet a lenslet's clear disc in its cell."""
    n = np.arange(200_000) + 0.5
    r, angle = scene.shadow_radius_um * np.sqrt(n / n.size), n * np.pi * (3 - np.sqrt(5))
    rays = np.stack([source_um[0] + r * np.cos(angle), source_um[1] + r * np.sin(angle)], axis=1)
    reach = scene.shadow_radius_um + 200.0
    q, p = (v.ravel() for v in np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)))
    centres = scene.lattice.centres_um(q, p)
    centres = centres[(np.abs(centres) < reach).all(1)]
    nearest, _ = cKDTree(centres).query(rays)
    assert scene.lattice.clear_um is not None
    return float((nearest <= scene.lattice.clear_um / 2).mean())


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("kind", "clear"), [("square", 1.41), ("square", 1.2), ("hexagonal", 1.15), ("hexagonal", 1.08)]
)
def test_lenslets_wider_than_their_cells_end_there(kind: str, clear: float) -> None:
    scene = camera_scene(3.0, iris=PupilIris(), cutout=(75, 75), period=(1, 1))
    pitch = scene.lattice.pitch_um
    lattice = replace(scene.lattice, kind=kind, types=(LensType.focused_at(3.0, 412.5),), clear_um=clear * pitch)
    scene = replace(scene, lattice=lattice)
    wanted = through_the_array(scene, (0.0, 0.0))
    rays = float(engine_for(scene, "geometric").rows([0], [0])[0, 0].sum())
    assert rays == pytest.approx(wanted, abs=0.002)  # without the cells 1.3 and more
    waves = [
        float(engine_for(scene, "wave", Sampling(nodes_per_px=5, margin_px=12)).rows([0], [0])[0, 0].sum()),
        float(engine_for(scene, "grid", Sampling(samples_per_px=5)).rows([0], [0])[0, 0].sum()),
        float(engine_for(scene, "reference", Sampling(samples_per_px=5)).rows([0], [0])[0, 0].sum()),
    ]
    assert max(waves[1:]) < 1.0  # windows whose intensities are added err by 2 %
    assert waves == pytest.approx([wanted] * 3, abs=0.02)


@pytest.mark.parametrize("shear", [0.0, 0.05])
def test_discs_wider_than_their_cells_tile_the_plane(shear: float) -> None:
    shapes = (("square", 72.0, 84.0), ("hexagonal", 72.0, 84.0), ("hexagonal", 40.0, 70.0), ("hexagonal", 30.0, 62.0))
    for kind, row, clear in shapes:
        lattice = LensletLattice(
            kind, 80.0, 400.0, (LensType(400.0),), 0.2, row_pitch_um=row, clear_um=clear, shear_rad=shear
        )
        scene = camera_scene(3.0, lattice=lattice)
        assert not scene.gapless and not scene.round_lenslets
        outline = tables.aperture_outline(scene)
        assert area(outline) / (80.0 * row) == pytest.approx(lattice.fill_factor, rel=1e-3)
        places = np.random.default_rng(1).uniform(-120, 120, (4000, 2))
        centres, _ = lattice.lenslets_within(400.0, 400.0)
        away = places[:, None] - centres[None]
        normals, limits = half_planes(outline)
        inside = ((away @ normals.T) <= limits).all(-1)
        assert inside.sum(1).max() == 1
        nearest = np.hypot(*away.transpose(2, 0, 1)).min(1)
        assert (inside.any(1) == (nearest < clear / 2)).mean() > 0.999, (kind, row)
        assert scene.fill_factor == lattice.fill_factor
