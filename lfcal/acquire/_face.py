"""The public names of `lfcal.acquire`: each is loaded on first use."""

from __future__ import annotations

from lfcal.acquire._forecast import SessionForecast, forecast
from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped, SuspectFrame
from lfcal.acquire.finish import iter_assemble_session, iter_finish
from lfcal.acquire.frame_plan import FramePlan
from lfcal.acquire.live_coverage import CoverageState, LiveCoverage
from lfcal.acquire.live_quality import LiveQuality, QualityState
from lfcal.acquire.options import Options
from lfcal.acquire.preview import LiveFrame, Preview
from lfcal.acquire.recording import (
    CheckFrame,
    DamagedFrame,
    Kind,
    Note,
    RecordingSource,
    SessionReport,
    Suspicion,
    TargetRecording,
    iter_verify,
    open_session,
    read_checks,
    verify,
)
from lfcal.acquire.redo import RedoList, read_suspects
from lfcal.acquire.runner import Observer, Outcome
from lfcal.acquire.schedule import Schedule, ScheduledFrame, coarse_order, window_shape
from lfcal.acquire.session import check_devices, iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.acquire.suspending import Bound, Suspender
from lfcal.devices import open_rig

__all__ = [
    "AcquisitionStopped",
    "Bound",
    "CheckFrame",
    "Control",
    "CoverageState",
    "DamagedFrame",
    "FramePlan",
    "Kind",
    "LiveCoverage",
    "LiveFrame",
    "LiveQuality",
    "Note",
    "Observer",
    "Options",
    "Outcome",
    "Preview",
    "QualityState",
    "RecordingSource",
    "RedoList",
    "Schedule",
    "ScheduledFrame",
    "SessionFile",
    "SessionForecast",
    "SessionReport",
    "SuspectFrame",
    "Suspender",
    "Suspicion",
    "TargetRecording",
    "check_devices",
    "coarse_order",
    "forecast",
    "iter_assemble_session",
    "iter_finish",
    "iter_record",
    "iter_verify",
    "open_rig",
    "open_session",
    "read_checks",
    "read_suspects",
    "record",
    "verify",
    "window_shape",
]
