"""The public names of `lfcal.accuracy`, each loaded on first use."""

from __future__ import annotations

from lfcal.accuracy.curves import CostPoint, Curve, marked
from lfcal.accuracy.drawing import draw_curves
from lfcal.accuracy.measure import CurveProgress, iter_measure_curve, measure_curve
from lfcal.accuracy.part import PARTS, AccuracyPart, AccuracyStep, Truth
from lfcal.accuracy.subject import Subject

__all__ = [
    "PARTS",
    "AccuracyPart",
    "AccuracyStep",
    "CostPoint",
    "Curve",
    "CurveProgress",
    "Subject",
    "Truth",
    "draw_curves",
    "iter_measure_curve",
    "marked",
    "measure_curve",
]
