"""What a fit is to those that build on it: its model, and what it knows of the patterns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lfcal.camera import ScanPlan
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.judge import ModelError
from lfcal.fit.model import ModelPlanes
from lfcal.fit.nuisance import Spread
from lfcal.fit.setup import Setup

__all__ = ["Fitted", "FittedPlace"]


class FittedPlace(Protocol):
    """A position."""

    @property
    def z(self) -> int:
        """Depth plane."""
        ...

    @property
    def y(self) -> int:
        """Row."""
        ...

    @property
    def x(self) -> int:
        """Column."""
        ...


class Fitted(Protocol):
    """What of `lfcal.fit.Fit` a hybrid H is made of; attributes are as there."""

    @property
    def planned(self) -> ScanPlan:
        """The scan."""
        ...

    @property
    def ideal_places(self) -> Setup:
        """The setup with sources where H has them."""
        ...

    @property
    def levels(self) -> PatternLevels:
        """Gain and background of each plane."""
        ...

    @property
    def spread(self) -> Spread:
        """How far sources were from their places, and how steady the lamp was."""
        ...

    @property
    def outliers(self) -> Sequence[FittedPlace]:
        """Patterns that were left out."""
        ...

    @property
    def left_out_error(self) -> ModelError:
        """Error of the model's patterns."""
        ...

    def planes(self) -> ModelPlanes:
        """Return what computes the planes of the model."""
        ...
