"""Stages of backends that have none: one that raises, one that assumes that another program moves."""

from __future__ import annotations

import math

from lfcal.devices.errors import StageError
from lfcal.devices.protocols import Limits, Point

__all__ = ["ExternalStage", "NoStage"]

_ANYWHERE: Limits = ((-math.inf, math.inf), (-math.inf, math.inf), (-math.inf, math.inf))


class NoStage:
    """The place where a stage belongs."""

    name = "no stage"
    limits = _ANYWHERE

    def move(self, target: Point) -> None:
        """Refuse."""
        raise StageError("stage: this camera has none; name the backend of the stage")

    def moving(self) -> bool:
        """Return False."""
        return False

    def position(self) -> Point:
        """Refuse."""
        raise StageError("stage: this camera has none; name the backend of the stage")

    def stop(self) -> None:
        """Do nothing."""

    def home(self) -> None:
        """Refuse."""
        self.move((0.0, 0.0, 0.0))

    def close(self) -> None:
        """Do nothing."""


class ExternalStage:
    """A source that another program or a person moves: its place is taken to be where it was asked to be."""

    name = "moved by another program"
    moved_elsewhere = True
    limits = _ANYWHERE

    def __init__(self) -> None:
        self._target: Point = (0.0, 0.0, 0.0)

    def move(self, target: Point) -> None:
        """Remember the target."""
        self._target = target

    def moving(self) -> bool:
        """Return False."""
        return False

    def position(self) -> Point:
        """Return the last target (µm)."""
        return self._target

    def stop(self) -> None:
        """Do nothing."""

    def home(self) -> None:
        """Go to the origin."""
        self._target = (0.0, 0.0, 0.0)

    def close(self) -> None:
        """Do nothing."""
