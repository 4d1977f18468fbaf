"""Which frames may be kept: whole, fresh, of the promised shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from lfcal.devices.errors import IncompleteFrame, StaleFrame, WrongFrame
from lfcal.devices.protocols import Frame

__all__ = ["check_frame"]

SLACK_S = 1e-4


def check_frame(frame: Frame, shape: tuple[int, int], dtype: np.dtype[Any], last_number: int, arrived_s: float) -> None:
    """Raise unless ``frame`` may be kept.

    Parameters
    ----------
    frame
        As the camera gave it.
    shape, dtype
        What the region of interest and the camera promise.
    last_number
        Number of the last frame seen.
    arrived_s
        Time at which the stage had arrived and settled, on the rig's clock (s).

    Raises
    ------
    IncompleteFrame, StaleFrame, WrongFrame
    """
    if frame.status != "complete":
        raise IncompleteFrame.expected(
            "camera buffer", "complete", frame.status, "check cable, packet size and bandwidth"
        )
    if frame.data.shape != shape or frame.data.dtype != dtype:
        raise WrongFrame.expected(
            "camera frame",
            f"{shape} {dtype}",
            f"{frame.data.shape} {frame.data.dtype}",
            "another program changed the camera; start again",
        )
    if frame.number <= last_number:
        raise StaleFrame.expected(
            "frame number", f"above {last_number}", frame.number, "the camera repeated an old buffer"
        )
    if frame.started_s is not None and frame.started_s < arrived_s - SLACK_S:
        raise StaleFrame.expected(
            "exposure",
            "started after arrival",
            f"{arrived_s - frame.started_s:.3g} s before",
            "trigger the camera, or flush its buffers",
        )
