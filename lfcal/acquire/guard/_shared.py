"""Names of `lfcal.acquire.guard` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.acquire.guard.content import (
    CheckedFrame,
    Content,
    ContentGuard,
    FramePlace,
    MeasuredFrame,
    SensorLimits,
    measured,
    same_place,
)
from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt

__all__ = [
    "NO_DOUBT",
    "CheckedFrame",
    "Content",
    "ContentGuard",
    "Doubt",
    "FramePlace",
    "MeasuredFrame",
    "SensorLimits",
    "measured",
    "same_place",
]
