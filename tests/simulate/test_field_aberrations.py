"""Aberrations over the field: at each place those of the wavefront that the law has there."""

from __future__ import annotations

import cmath
from dataclasses import replace

import numpy as np
import pytest

from lfcal.simulate.effects import FieldAberrations, Zernike
from lfcal.simulate.effects.described import effect_from, parse_effects
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, difference, responses, small_camera, small_plan, switched

CAMERA = small_camera(2400, 3000)
LAW = FieldAberrations(0.4, 0.3, 0.05, -0.1, 0.2, 8e3)


@pytest.mark.parametrize("anchor", [(100.0, 2800.0), (2200.0, 300.0)])
@pytest.mark.few(1)
def test_light_at_a_place_is_that_of_its_wavefront(anchor: tuple[float, float]) -> None:
    """Against a wavefront that is the same everywhere, its terms reckoned by hand."""
    plan = small_plan(3.0, CAMERA, anchor=anchor, cutout=31)
    y, x = outlook_of(plan, 0).field_um
    h, turn = np.hypot(y, x) / 8e3, cmath.phase(complex(x, y))
    coma, along = 0.4 * h, 0.3 * h**2
    linear = (-0.1 + 0.05j) * complex(x, y) / 8e3
    terms = (
        (3, 1, coma * np.cos(turn)),
        (3, -1, coma * np.sin(turn)),
        (2, 2, along * np.cos(2 * turn) + linear.real),
        (2, -2, along * np.sin(2 * turn) + linear.imag),
        (4, 0, 0.2 * h**2),
    )
    found, plain = responses(plan, (*BASE, LAW)), responses(plan, BASE)
    assert difference(found, responses(plan, (*BASE, Zernike(terms)))) < 1e-5
    # a wavefront on the axis adds to it, term by term
    both = responses(plan, (*BASE, Zernike(((3, 1, 0.1), (4, 0, -0.1))), LAW))
    summed = tuple((n, m, w + {(3, 1): 0.1, (4, 0): -0.1}.get((n, m), 0.0)) for n, m, w in terms)
    assert difference(both, responses(plan, (*BASE, Zernike(summed)))) < 1e-5
    assert difference(found, plain) > 0.05


def test_coma_points_from_the_axis_and_turns_with_the_field() -> None:
    """Places opposite to each other have opposite coma and the same astigmatism."""
    there, back = ({t[:2]: t[2] for t in LAW.terms_at(at)} for at in ((3e3, 4e3), (-3e3, -4e3)))
    assert there[3, 1] == pytest.approx(0.4 * 0.5) and there[3, -1] == pytest.approx(0.4 * 3 / 8)
    assert back[3, 1] == -there[3, 1] and back[4, 0] == there[4, 0]
    only = replace(LAW, astigmatism_y=0.0, astigmatism_x=0.0)
    assert {t[:2]: t[2] for t in only.terms_at((-3e3, -4e3))}[2, 2] == pytest.approx(0.3 * (16 - 9) / 64)
    assert LAW.terms_at((0.0, 0.0)) == ()


@pytest.mark.parametrize("v", [4.0, -3.0, 2.2])
@pytest.mark.parametrize("effect", [FieldAberrations(0.1, 0.0), FieldAberrations(0.0, 0.1), FieldAberrations(0.2, 0.1)])
@pytest.mark.few(4)
def test_estimates_are_honest(v: float, effect: FieldAberrations) -> None:
    plan = small_plan(v, CAMERA, anchor=(100.0, 2800.0))
    measured = switched(plan, effect)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_they_are_given_in_words_and_files() -> None:
    ((), (found,)) = (), parse_effects(["field_aberrations=coma:0.3,astigmatism:0.2,radius:8mm"])[1]
    assert found == FieldAberrations(0.3, 0.2, radius_um=8e3)
    assert effect_from("field_aberrations", {"coma": 0.3, "astigmatism": 0.2, "radius_um": 8e3}) == found
