"""Names of `lfcal.simulate.sensor` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import FrameKind, expose, temporal_noise
from lfcal.simulate.sensor.responses import Responses, Window, place
from lfcal.simulate.sensor.session import (
    check_session_folder,
    discard_unfinished,
    encode_png,
    frame_name,
    iter_write_session,
    unfinished,
    write_session,
)
from lfcal.simulate.sensor.white import white_tile

__all__ = [
    "FrameKind",
    "Responses",
    "SimulatedCamera",
    "Window",
    "check_session_folder",
    "discard_unfinished",
    "encode_png",
    "expose",
    "frame_name",
    "iter_write_session",
    "place",
    "temporal_noise",
    "unfinished",
    "white_tile",
    "write_session",
]
