"""The camera that a fit of H found, as other pages use it. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lfcal_gui.models.stamp import Stamp

if TYPE_CHECKING:
    from lfcal.fit import Setup


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """What a fit found of the camera behind an H.

    Attributes
    ----------
    stamp
        The file of H, as it was when it was fitted.
    setup
        Camera and effects as found, sources where H has them.
    """

    stamp: Stamp
    setup: Setup
