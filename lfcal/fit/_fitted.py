"""What a fit is to those that build on it: its model, and what it knows of the patterns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work
from lfcal.camera import Camera, ScanPlan
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.judge import ModelError
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
    def camera(self) -> Camera:
        """The camera as found."""
        ...

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

    @property
    def provenance(self) -> dict[str, Any]:
        """What H of the fitted camera says of where it comes from."""
        ...

    def iter_plane(self, z: int, workers: int | None = None) -> Work[NDArray[np.float32]]:
        """Compute a plane of the model."""
        ...
