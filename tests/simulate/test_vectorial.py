"""Light as a vector field, and a specimen of another index: fields, engines, effects."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import LensletLattice, LensType, Microscope
from lfcal.simulate.engines import _debye as debye
from lfcal.simulate.engines import _tile_llvm, microscope
from lfcal.simulate.engines._debye import (
    SCALAR,
    debye_field,
    debye_fields,
    debye_nodes,
    field_shares,
    pupil_phase,
    radial_field,
)
from lfcal.simulate.engines._fields_sum import FieldsSum
from lfcal.simulate.engines._radial import bessel
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.microscope import DebyePlane
from lfcal.simulate.scene import Scene, Specimen
from tests.simulate.dipole_oracle import dipole_light, dipole_pupil
from tests.simulate.microscope_oracle import DipoleFields
from tests.simulate.scenes import microscope_scene, relative_error

WATER = 1.33


def scene_of(z: float, na: float, index: float, magnification: float = 20.0, **changes: object) -> Scene:
    """Return the small microscope's plane with another objective, vectorial."""
    optics = Microscope(magnification, na, index)
    image = -(magnification**2) * z / index
    values = {"objective": optics, "f_number": optics.working_f_number, "image_um": image, "vectorial": True}
    return microscope_scene(z, **(values | changes))


def light_at(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the light of all of a scene's fields at points (x, y) on the array."""
    r = np.hypot(x, y)
    fields = (debye_field(scene, r, order=one.order) * one.angular(x, y) for one in debye_fields(scene))
    return sum((np.abs(field) ** 2 for field in fields), np.zeros(r.shape))


OBJECTIVES = [
    (0.5, 1.0, None, 0.0),
    (1.2, WATER, None, 1.5),
    (1.4, 1.400001, None, -0.5),
    (0.95, 1.0, Specimen(WATER, 2.0), 1.0),
    (1.4, 1.518, Specimen(WATER, 0.0), 0.0),
    (1.4, 1.518, Specimen(WATER, 0.0), 0.1),
    (1.4, 1.518, Specimen(WATER, 3.0), -1.0),
    (1.4, 1.518, Specimen(1.4, 3.0), 2.0),
]


@pytest.mark.parametrize(("na", "index", "specimen", "z"), OBJECTIVES)
def test_dipoles_on_the_array_against_sums_over_the_pupil(na, index, specimen, z):
    scene = scene_of(z, na, index, 60.0, specimen=specimen)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-60, 60, (2, 12))
    x[0] = y[0] = 0
    pupil = dipole_pupil(scene)
    wanted = dipole_light(pupil, x, y)
    assert np.abs(light_at(scene, x, y) - wanted).max() < 1e-12 * wanted.max()
    one, two = field_shares(scene)[1:]
    assert pupil.energy[2].sum() == pytest.approx(one, rel=1e-12)
    assert pupil.energy[0, 1] == pytest.approx(two / 4, rel=1e-10)
    scalar = light_at(replace(scene, vectorial=False), x, y)
    assert np.abs(scalar - wanted).max() > 1e-2 * wanted.max()


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("z", "na", "specimen", "position"),
    [(0.0, 0.8, None, (2, 3)), (0.0, 0.8, Specimen(WATER, 1.0), (7, 1))],
)
def test_responses_against_sums_over_the_pupil(z, na, specimen, position):
    scene = scene_of(z, na, 1.0, cutout=(21, 21), specimen=specimen)
    wanted = DipoleFields(scene).response(scene, scene.source_um(*position), position)
    found = DebyePlane(scene, Sampling(nodes_per_px=4)).rows([position[0]], [position[1]])[0, 0]
    scalar = DebyePlane(replace(scene, vectorial=False)).rows([position[0]], [position[1]])[0, 0]
    assert relative_error(found, wanted) < 5e-4
    assert relative_error(scalar, wanted) > 0.015


@pytest.mark.long
def test_the_sum_keeps_the_symmetries_of_the_array():
    """Mirrored and transposed responses against the reference, which computes each for itself."""
    lattice = LensletLattice("square", 144.0, 1440.0, (LensType(1440.0),))
    scene = scene_of(2.0, 0.9, 1.0, lattice=lattice, period=(18, 18), cutout=(25, 25))
    engine = DebyePlane(scene, Sampling(nodes_per_px=4))
    engine.rows(range(0, 18, 4), range(0, 18, 4))  # 0, 4, 8 from a lenslet's centre, and 6 and 2 of the mirrored ones
    assert engine.certificate.responses == 15
    reference = engine_for(scene, "reference", Sampling(6))
    assert isinstance(reference, FieldsSum)
    wanted = reference.rows([16], [5], workers=1)[0, 0]
    assert relative_error(engine.rows([16], [5])[0, 0], wanted) < 0.01
    assert relative_error(engine.rows([5], [16])[0, 0], wanted) > 0.05


@pytest.mark.long
def test_other_arrays_add_the_fields_lenslet_by_lenslet():
    lattice = LensletLattice("hexagonal", 72.0, 1440.0, (LensType(1440.0),), rotation_rad=0.1)
    scene = scene_of(0.0, 0.9, 1.0, lattice=lattice, aperture="circle", period=(16, 9), cutout=(21, 21))
    engine = engine_for(scene, "debye", Sampling(nodes_per_px=3))
    assert isinstance(engine, FieldsSum) and isinstance(engine, PlaneEngine)
    wanted = engine_for(scene, "reference", Sampling(4)).rows([3], [2])[0, 0]
    assert relative_error(engine.rows([3], [2])[0, 0], wanted) < 0.02
    assert 0.9 < engine.certificate.energy_out <= engine.certificate.energy_in <= 1
    scalar = engine_for(replace(scene, vectorial=False), "debye", Sampling(nodes_per_px=3))
    assert relative_error(scalar.rows([3], [2])[0, 0], wanted) > 0.03
    shift = np.zeros((16, 9, 2))
    shift[3, 2] = (2.0, -1.0)
    moved = engine.displaced(shift).rows([3], [2])[0, 0]
    assert relative_error(moved, engine.point(3 * 8.0 + 2.0, 2 * 8.0 - 1.0)) < 1e-6
    assert engine.predicted_seconds(10) > 0


def test_one_field_alone_is_not_taken_for_the_whole():
    scene = scene_of(0.0, 0.8, 1.0)
    with pytest.raises(InputError, match="mode of the microscope's field"):
        WavePlane(scene)
    with pytest.raises(InputError, match="order"):
        debye_field(replace(scene, vectorial=False), np.zeros(1), order=1)


# -- limits -----------------------------------------------------------------------------------------------------


def test_a_small_aperture_is_scalar():
    for na, worst in ((0.1, 3e-3), (0.02, 2e-4)):
        scene = scene_of(5.0, na, 1.0)
        scalar = DebyePlane(replace(scene, vectorial=False)).rows([2], [3])[0, 0]
        assert relative_error(DebyePlane(scene).rows([2], [3])[0, 0], scalar) < worst
    assert debye_fields(scene_of(5.0, 3e-4, 1.0)) == (SCALAR,)
    assert len(debye_fields(scene_of(5.0, 0.01, 1.0))) == 3


def test_an_equal_index_and_a_plane_before_the_interface_change_nothing():
    scene = scene_of(-2.0, 0.8, 1.2)
    r = np.linspace(0, 200, 50)
    for order in range(3):
        plain = debye_field(scene, r, order=order)
        for specimen in (Specimen(1.2, 30.0), Specimen(1.5, 1.9)):
            assert np.array_equal(debye_field(replace(scene, specimen=specimen), r, order=order), plain)
        near = debye_field(replace(scene, specimen=Specimen(1.2 + 1e-9, 30.0)), r, order=order)
        assert 0 < np.abs(near - plain).max() < 1e-5 * np.abs(plain).max()


@pytest.mark.parametrize(
    ("n1", "n2", "depth", "z"),
    [(1.518, WATER, 50.0, 3.0), (1.0, WATER, 1e3, -20.0), (WATER, WATER + 1e-9, 1e4, 0.0), (1.33, 1.38, 1e3, -1e3)],
)
def test_phase_behind_an_interface_against_forty_digits(n1, n2, depth, z):
    """Gibson and Lanni's phase as it is printed; in double precision it cancels on the axis and for near indices."""
    scene = scene_of(z, 0.9 * n1, n1, specimen=Specimen(n2, depth))
    theta = np.array([1e-9, 1e-4, 0.1, 0.5, 1.0, 1.1])
    mp.mp.dps = 40
    k = 2 * mp.pi / mp.mpf(scene.wavelength_um)

    def printed(t):
        a, b, d = mp.mpf(n1), mp.mpf(n2), mp.mpf(depth)
        second = mp.sqrt(b**2 - (a * mp.sin(t)) ** 2)
        found = (d + mp.mpf(z)) * (second - b) - d * (a * mp.cos(t) - a)
        return complex(k * found)

    wanted = np.array([printed(mp.mpf(float(t))) for t in theta])
    found = pupil_phase(scene, theta)
    scale = np.abs(wanted) + 1e-15 * 2 * math.pi / scene.wavelength_um * abs(z) * theta**2
    assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()
    assert (np.abs(found - wanted) < 1e-12 * scale).all()


def test_light_beyond_total_reflection_fades_with_the_depth():
    """At NA 1.4 in oil a third of a dipole's light on the interface has no place in water; 2 µm deep, none is left."""
    dark = []
    for depth in (0.0, 0.2, 2.0):
        scene = scene_of(0.0, 1.4, 1.518, 60.0, specimen=Specimen(WATER, depth))
        pupil = dipole_pupil(scene)
        beyond = np.hypot(pupil.kx, pupil.ky) * 60 * scene.wavelength_um / (2 * math.pi) > WATER
        dark.append(float(pupil.power[beyond].sum()))
        r = np.linspace(0, 60, 30)
        light = light_at(scene, r, np.zeros(30))
        assert np.abs(light - dipole_light(pupil, r, np.zeros(30))).max() < 1e-12 * light.max()
    assert dark[0] > 0.3 and 0.1 < dark[1] < 0.2 and dark[2] < 0.01


@pytest.mark.few(6)
@pytest.mark.parametrize("index", [WATER, 1.4 * (1 - 1e-6), 1.4, 1.4 * (1 + 1e-6), 1.5179])
@pytest.mark.parametrize(("depth", "z"), [(0.0, 0.0), (0.0, 1e-12), (20.0, -20.0), (100.0, 50.0)])
def test_indices_about_the_aperture_converge(index, depth, z):
    scene = scene_of(z, 1.4, 1.518, 60.0, specimen=Specimen(index, depth))
    r = np.linspace(0, 3000, 20)
    peak = np.abs(debye_field(scene, r)).max()
    for order in range(3):
        twice = debye_field(scene, r, nodes=2 * debye_nodes(scene, 3000.0), order=order)
        assert np.isfinite(twice).all()
        assert np.abs(debye_field(scene, r, order=order) - twice).max() < 1e-10 * peak


def test_splines_of_odd_fields():
    scene = scene_of(2.0, 0.8, 1.0)
    r = np.linspace(0, 150, 700)
    for order in range(3):
        exact = debye_field(scene, r, order=order)
        assert np.abs(radial_field(scene, 150.0, order)(r) - exact).max() < 2e-5 * np.abs(exact).max()


def test_bessel_functions_at_any_argument():
    x = np.array([0.0, 5e-324, 1e-200, 1e-8, 0.0199999, 0.02, 0.0200001, 0.5, 3.0, 900.0])
    mp.mp.dps = 30
    for order in range(3):
        exact = np.array([float(mp.besselj(order, mp.mpf(float(v)))) for v in x])
        assert np.abs(bessel(order, x) - exact).max() < 1e-13


def test_no_denormal_numbers_in_the_matrices():
    engine = DebyePlane(scene_of(0.0, 0.01, 1.0, specimen=Specimen(WATER, 1.0)))
    engine.rows([0, 2], [1])
    stored = (*engine._quarters, *engine._lefts.values(), *engine._rights.values())
    for values in (*engine._matrices.values(), *(part for parts in stored for part in parts)):
        assert not ((values != 0) & (np.abs(values) < np.finfo(np.float32).tiny)).any()


def test_what_is_not_asked_for_costs_nothing(monkeypatch):
    calls: list[str] = []

    def counted(module, name):
        own = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given, **named: calls.append(name) or own(*given, **named))

    counted(_tile_llvm, "row_light")
    counted(microscope, "radial_field")
    counted(debye, "pupil_phase")
    monkeypatch.setattr(Specimen, "crossing", lambda *given: calls.append("crossing"))
    scene = replace(scene_of(2.0, 0.8, 1.0), vectorial=False)
    engine = DebyePlane(scene)
    engine.rows([2], [3])
    assert sorted(calls) == ["pupil_phase", "radial_field", "row_light"]
    assert {m.shape[0] for m in engine._matrices.values()} == {1}
    calls.clear()
    DebyePlane(replace(scene, vectorial=True)).rows([2], [3])
    assert calls.count("row_light") == 5 and calls.count("radial_field") == 3 and "crossing" not in calls


def test_rays_far_from_the_axis_reach_the_lenslets_they_reach():
    """A cone of NA 0.95 lights M z tan(alpha), three times M z sin(alpha): lenslets out there were left dark."""
    lattice = LensletLattice("square", 144.0, 2880.0, (LensType(2880.0),))
    changes = {"lattice": lattice, "pixel_um": 16.0, "cutout": (131, 131), "vectorial": False}
    scene = scene_of(8.0, 0.95, 1.0, 40.0, **changes)
    assert scene.shadow_radius_um == pytest.approx(40 * 8 * math.tan(math.asin(0.95)))
    wanted = DebyePlane(scene, Sampling(nodes_per_px=3)).rows([1], [2])[0, 0]
    found = WavePlane(scene, Sampling(nodes_per_px=3, margin_px=12, energy_floor=0.05), "D").rows([1], [2])[0, 0]
    assert relative_error(found, wanted) < 0.1  # the floor's; 0.16 with the lenslets dark
    glass = replace(scene, specimen=Specimen(WATER, 10.0))
    wide = 40 * abs(18 * math.tan(math.asin(0.95 / WATER)) - 10 * math.tan(math.asin(0.95)))
    assert glass.shadow_radius_um == pytest.approx(wide, rel=1e-3)
