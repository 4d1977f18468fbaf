"""The cost of accuracy: curves of error against seconds, bytes or frames for one camera or H.

- ``curves``: points (`CostPoint`) and curves (`Curve`), the Pareto front, the cheapest point for an error
- ``subject``: the measured scan plan or H, and samples of it that are quick to process
- ``part``: `AccuracyPart`, a part of the processing whose curve can be measured; one module in ``parts`` for each
- ``measure``: measurement of curves, point by point, within a time limit; results are kept if it is stopped
- ``drawing``: curves on one page
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.accuracy._face import *  # noqa: F403
    from lfcal.accuracy._shared import *  # noqa: F403

lazy_face(__name__)
