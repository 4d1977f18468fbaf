"""Distortion of the lattice: its terms, inverse and derivative, and the lattice that has it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError
from lfcal.camera import Camera, LatticeDistortion, LensletLattice, LensType, MainLens, Sensor

CUBIC = LatticeDistortion(
    "polynomial", (30.0, -20.0), 5000.0, ((4.0, -3.0, 2.0, 9.0, 1.0, -2.0, 3.0), (1.0, 2.0, -5.0, -1.0, 4.0, 2.0, -8.0))
)

RADIAL = LatticeDistortion("radial", (150.0, 90.0), 5000.0, ((12.0, -3.0),))
THREE = (LensType(1000.0), LensType(1100.0), LensType(1200.0))


def points(reach: float = 6000.0) -> np.ndarray:
    return np.random.default_rng(3).uniform(-reach, reach, (400, 2))


def test_displacements_are_what_the_terms_say() -> None:
    u, v = (1030.0 - 30.0) / 5000, (-2520.0 + 20.0) / 5000
    x = 4 * u * u - 3 * u * v + 2 * v * v + 9 * u**3 + u * u * v - 2 * u * v * v + 3 * v**3
    y = u * u + 2 * u * v - 5 * v * v - u**3 + 4 * u * u * v + 2 * u * v * v - 8 * v**3
    assert CUBIC.apply((1030.0, -2520.0)) == pytest.approx((1030.0 + x, -2520.0 + y), abs=1e-10)
    u, v = 2000.0 / 5000, -1000.0 / 5000
    gain = 12 * (u * u + v * v) - 3 * (u * u + v * v) ** 2  # Brown's
    assert RADIAL.apply((2150.0, -910.0)) == pytest.approx((2150 + gain * u, -910 + gain * v), abs=1e-10)
    assert (CUBIC.degree, RADIAL.degree) == (3, 5)
    assert LatticeDistortion("radial", (0.0, 0.0), 100.0, ((3.0,),)).largest == pytest.approx(3.0)


@pytest.mark.parametrize("distortion", [CUBIC, RADIAL, replace(RADIAL, terms=((-20.0, 7.0, 3.0, -2.0),))])
def test_inverse_and_derivative_are_right_everywhere(distortion: LatticeDistortion) -> None:
    """Also far outside the sensor, where a polynomial alone would fold back."""
    for reach in (5000.0, 30000.0):
        assert np.abs(distortion.invert(distortion.apply(points(reach))) - points(reach)).max() < 1e-7
    assert distortion.invert(np.zeros((0, 2))).shape == (0, 2)
    far = 3 * distortion.scale
    at, h = np.array([[800.0, -3000.0], distortion.centre, [far, -far / 2]]), 0.5
    for axis in (0, 1):
        step = h * np.eye(2)[axis]
        slope = (distortion.apply(at + step) - distortion.apply(at - step)) / (2 * h)
        assert distortion.jacobian(at)[..., axis] == pytest.approx(slope, abs=1e-8)
        assert distortion.jacobian(at[0])[:, axis] == pytest.approx(slope[0], abs=1e-8)
    # it is smooth where it continues along straight lines
    outward = np.array([math.cos(0.7), math.sin(0.7)])
    edge = np.array(distortion.centre) + 1.25 * distortion.scale * outward
    for step in (-1.0, 1.0):
        change = distortion.apply(edge + step * outward) - distortion.apply(edge)
        assert change == pytest.approx(step * distortion.jacobian(edge) @ outward, abs=1e-4)
    assert np.isfinite(distortion.jacobian([[1e300, 0.0]])).all()
    moved, shift = distortion.scaled(0.2, (70.0, -11.0)), np.array([70.0, -11.0])
    assert np.allclose(moved.apply(0.2 * points() + shift), 0.2 * distortion.apply(points()) + shift)
    assert moved.largest == pytest.approx(0.2 * distortion.largest)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"model": "spline"}, ""),
    ({"scale": 0.0}, ""),
    ({"centre": (1.0, math.nan)}, ""),
    *(({"terms": terms}, "") for terms in ((), ((1.0, 2.0, 3.0),), ((1.0, 2.0), (1.0, 2.0)), 3.0)),
    *(({"terms": ((1.0, 2.0, k), (1.0, 2.0, 3.0)[:n])}, "") for k, n in ((3.0, 2), (math.inf, 3))),
    ({"scale": 5000.0, "terms": ((1e15,) * 7, (1e15,) * 7)}, "distortion of the lattice: expected one that keeps"),
    ({"terms": ((1e308,) * 7, (1e308,) * 7)}, "terms of the distortion: expected a number ≥ -1e"),
    *(({"model": "radial", "terms": (terms,)}, "") for terms in ((), (1.0,) * 5, (-5000.0,))),
    ({"model": "radial", "terms": ((-200.0,),)}, r"less than 0\.1 of its size, got one that shrinks an area to 0\.04"),
    *(({"model": "radial", "terms": ((k,),)}, "got one that reverses their order") for k in (-400.0, -1000.0, -1e7)),
    ({"model": "radial", "scale": 1e-300, "terms": ((1e15,),)}, "got terms too large to evaluate"),
]


def test_bad_values_are_refused_in_one_line() -> None:
    good = LatticeDistortion("polynomial", (0.0, 0.0), 1000.0, ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    for values, match in BAD:
        with pytest.raises(InputError, match=match or ".") as caught:
            replace(good, **values)
        assert "\n" not in str(caught.value), values
    with pytest.raises(InputError, match="expected finite numbers, got NaN or infinity in 2 of them"):
        good.invert([[np.nan, 1.0], [3.0, 4.0], [np.inf, 0.0]])


def bent(distortion: LatticeDistortion = CUBIC, kind: str = "hexagonal") -> LensletLattice:
    types = THREE if kind == "hexagonal" else THREE[:1]
    return LensletLattice(
        kind, 70.0, 400.0, types, 0.05, (5.0, 9.0), shear_rad=0.004, clear_um=66.0, distortion=distortion
    )


def test_centres_are_displaced_and_indices_lead_back() -> None:
    lattice = bent()
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-40, 41, 5), np.arange(-40, 41, 5)))
    a = 70.0 * np.array([math.cos(0.05), math.sin(0.05)])
    b = a / 2 + 70.0 * math.sqrt(3) / 2 * np.array(
        [-math.sin(0.05) + math.tan(0.004) * math.cos(0.05), math.cos(0.05) + math.tan(0.004) * math.sin(0.05)]
    )
    straight = q[:, None] * a + r[:, None] * b + (5.0, 9.0)
    assert np.allclose(lattice.centres_um(q, r), CUBIC.apply(straight), atol=1e-9)
    assert np.allclose(lattice.lenslet_at(lattice.centres_um(q, r)), np.stack([q, r], -1), atol=1e-9)


def test_lenslets_within_a_box_are_all_there_and_keep_their_types() -> None:
    lattice = bent(LatticeDistortion("radial", (0.0, 0.0), 3000.0, ((260.0,),)))
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-90, 91), np.arange(-90, 91)))
    every = lattice.centres_um(q, r)
    inside = (np.abs(every[:, 0] - 500) <= 2600) & (np.abs(every[:, 1] + 300) <= 1900)
    got, types = lattice.lenslets_within(2600.0, 1900.0, (500.0, -300.0))
    order, wanted = np.lexsort(got.T), np.lexsort(every[inside].T)
    assert np.allclose(got[order], every[inside][wanted])
    assert np.array_equal(types[order], lattice.type_of(q, r)[inside][wanted])


@pytest.mark.parametrize("kind", ["hexagonal", "square"])
def test_the_local_lattice_is_the_neighbourhood(kind: str) -> None:
    lattice = bent(kind=kind)
    about = (3100.0, -2400.0)
    local = lattice.local(about)
    assert local.distortion is None
    near, kinds = lattice.lenslets_within(150.0, 150.0, about)
    got, types = local.lenslets_within(150.0, 150.0, about)
    nearest = np.hypot(*(near[:, None] - got[None]).transpose(2, 0, 1))
    # the straight lattice is an affine approximation, with a second-order error over two pitches
    assert nearest.min(1).max() < 0.05
    assert np.array_equal(kinds, types[nearest.argmin(1)])
    # the whole lattice's own vectors are off by more over so short a way
    moved = local.basis_um() - lattice.basis_um()
    assert 3 * np.hypot(*moved.T).max() > 0.3


def test_a_camera_keeps_it_in_its_description() -> None:
    camera = Camera("c", MainLens(), bent(RADIAL), Sensor((300, 400), 5.0))
    assert Camera.from_json(camera.to_json()) == camera
    assert camera.local((10, 20)).lattice.distortion is None
    old = camera.to_dict()
    del old["lattice"]["distortion"], old["lattice"]["shear_rad"], old["marks"]
    opened = Camera.from_dict(old | {"version": 1})
    assert opened.lattice.distortion is None and opened.lattice.shear_rad == 0.0
    broken = camera.to_dict()
    broken["lattice"]["distortion"]["terms"] = [[1.0], "a"]
    with pytest.raises(FileFormatError):
        Camera.from_dict(broken)


def test_the_lattice_may_be_scaled_and_is_local_everywhere_without_distortion() -> None:
    lattice = bent()
    twice = lattice.scaled(2.0)
    assert np.allclose(twice.centres_um(7, -3), 2 * lattice.centres_um(7, -3))
    assert (twice.gap_um, twice.types) == (lattice.gap_um, lattice.types)
    plain = LensletLattice("hexagonal", 70.0, 400.0, THREE, math.pi)
    assert plain.local((1000.0, 2000.0)) == plain
