"""What a file of volumes says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["VolumeFacts"]


@dataclass(frozen=True, slots=True)
class VolumeFacts:
    """What a file says of its volumes.

    Attributes
    ----------
    depths_um
        Depth of each plane (µm).
    voxel_um
        Voxel size (y, x) in object space (µm).
    details
        What else to keep, plain JSON types.
    origin_um
        Where the middle of the first voxel (y, x) lies (µm from the axis), where that is known.
    times_s
        When the frame behind each volume of a series was taken (s), where that is known.
    """

    depths_um: NDArray[np.float64] | None = None
    voxel_um: tuple[float, float] | None = None
    details: dict[str, Any] = field(default_factory=dict)
    origin_um: tuple[float, float] | None = None
    times_s: Sequence[float] | None = None
