"""What the values of a camera are called and shown as."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.camera import QUANTITIES, preset, quantities_of, value_at

CLEAR = "lattice.clear_um"


def shown(kind: str, clear: float | None) -> str:
    """Return how the clear diameter of lenslets 150 µm apart is shown."""
    camera = preset("lfm_20x05")
    lattice = replace(camera.lattice, kind=kind, pitch_um=150.0, row_pitch_um=None, clear_um=clear)
    camera = replace(camera, lattice=lattice)
    quantity = next(one for one in quantities_of(camera) if one.path == CLEAR)
    return quantity.text(value_at(camera, CLEAR))


@pytest.mark.parametrize(
    ("kind", "clear", "words"),
    [
        ("square", None, "squares without gaps"),
        ("square", 150.0, "150 µm, round"),
        ("square", 180.0, "180 µm, round, cut off where the next lenslet begins"),
        ("square", 212.1, "212.1 µm, without gaps"),
        ("hexagonal", None, "round, the pitch across"),
        ("hexagonal", 150.0, "150 µm, round"),
        ("hexagonal", 173.2, "173.2 µm, without gaps"),
    ],
)
def test_a_clear_diameter_is_shown_with_what_it_means(kind: str, clear: float | None, words: str) -> None:
    assert shown(kind, clear) == words


def test_both_meanings_are_told_where_the_array_is_not_known() -> None:
    quantity = next(one for one in QUANTITIES if one.path == CLEAR)
    assert "on the sensor" in quantity.label
    assert quantity.text(None) == "square: squares without gaps; hexagonal: round, the pitch across"
