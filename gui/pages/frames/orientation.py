"""Which way the imported frames lie: what the pattern's path says, and what to offer. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.camera import ScanPlan
from lfcal.frames.orientation import AS_IS, ORIENTATIONS
from lfcal.frames.oriented import OrientedSource, oriented
from lfcal.frames.source import FrameSource
from lfcal.psf.orientation import FoundOrientation, find_orientation

__all__ = ["CHOICES", "Advice", "advice", "lie_of", "look", "turned"]

CHOICES = tuple(
    (one.name, "upright as they are" if one.name == AS_IS else f"{one.name}: {one.words}")
    for one in ORIENTATIONS.values()
)
"""Orientations, with the words shown."""


@dataclass(frozen=True)
class Advice:
    """What to say of the frames, and the orientation to offer; empty where turning them is no help."""

    words: str
    apply: str


def turned(source: FrameSource, plan: ScanPlan, name: str) -> FrameSource:
    """Return the frames as orientation ``name`` turns them."""
    return oriented(source, ORIENTATIONS[name], plan.camera.sensor.shape)


def lie_of(view: FrameSource) -> str:
    """Return the orientation that a view was turned by."""
    known = view.metadata.get("orientation")
    return AS_IS if known is None else str(known["applied"])


def look(view: FrameSource, plan: ScanPlan) -> FoundOrientation:
    """Return which way the frames behind a turned or upright ``view`` lie as they are delivered."""
    return find_orientation(view.source if isinstance(view, OrientedSource) else view, plan)


def advice(found: FoundOrientation, chosen: str) -> Advice | None:
    """Return what to say where frames turned by ``chosen`` certainly do not lie as was ``found``, else None."""
    if found.name in ("", chosen):
        return None
    if found.name == AS_IS:
        return Advice("The frames lie upright as they are delivered, but are turned", AS_IS)
    words = found.words[0].upper() + found.words[1:]
    if found.cause == "scan":
        return Advice(f"{words}: correct the positions, or the plan's stage axes", "")
    return Advice(words, found.name)
