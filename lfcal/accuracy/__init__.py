"""What accuracy costs, everywhere it is paid: curves of error against seconds, bytes or frames for one camera or H.

- ``base``: `Rung`, `Curve`, the Pareto front, the cheapest rung for an error
- ``subject``: the scan plan or H that is measured, and samples of it that are quick to work with
- ``place``: `Place`, a module of ``places`` each, found by registry; ``catalogue`` has them by name
- ``measure``: places to curves, rung by rung, within seconds; what was measured is kept when it is stopped
- ``curve_file``, ``drawing``: curves as JSON, and on one page
"""

from lfcal.accuracy.base import Curve, Rung, marked
from lfcal.accuracy.catalogue import PLACES
from lfcal.accuracy.curve_file import read_curves, write_curves
from lfcal.accuracy.drawing import draw_curves
from lfcal.accuracy.measure import CurveProgress, iter_curve, iter_curves, measure_curve
from lfcal.accuracy.place import Place, Step, Truth
from lfcal.accuracy.subject import Subject

__all__ = [
    "PLACES",
    "Curve",
    "CurveProgress",
    "Place",
    "Rung",
    "Step",
    "Subject",
    "Truth",
    "draw_curves",
    "iter_curve",
    "iter_curves",
    "marked",
    "measure_curve",
    "read_curves",
    "write_curves",
]
