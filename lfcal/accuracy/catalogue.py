"""Every place by name: those of `lfcal.accuracy.places`, and those of other distributions."""

from __future__ import annotations

from lfcal.accuracy.place import Place
from lfcal.base import Registry

__all__ = ["PLACES", "find_places"]

GROUP = "lfcal.accuracy"
"""Entry point group of places of other distributions."""


def _check(part: Place) -> None:
    if not isinstance(part, Place):
        raise TypeError(f"expected a Place, got {type(part).__name__}")


def find_places() -> Registry[Place]:
    """Return a registry of all places, in the order of the work."""
    return Registry(
        "place of accuracy",
        "lfcal.accuracy.places",
        "PLACE",
        GROUP,
        order=lambda place: (place.rank, place.name),
        check=_check,
    )


PLACES = find_places()
"""All places, in the order of the work."""
