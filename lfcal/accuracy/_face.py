"""The public names of `lfcal.accuracy`, each loaded on first use."""

from __future__ import annotations

from lfcal.accuracy.curves import Curve, Rung, marked
from lfcal.accuracy.drawing import draw_curves
from lfcal.accuracy.measure import CurveProgress, iter_measure_curve, measure_curve
from lfcal.accuracy.place import PLACES, AccuracyStep, Place, Truth
from lfcal.accuracy.subject import Subject

__all__ = [
    "PLACES",
    "AccuracyStep",
    "Curve",
    "CurveProgress",
    "Place",
    "Rung",
    "Subject",
    "Truth",
    "draw_curves",
    "iter_measure_curve",
    "marked",
    "measure_curve",
]
