"""The cost of accuracy: curves of error against seconds, bytes or frames for one camera or H.

- ``curves``: `Rung`, `Curve`, the Pareto front, the cheapest rung for an error
- ``subject``: the measured scan plan or H, and samples of it that are quick to process
- ``place``: `Place`, one module of ``places`` each, found by registry
- ``measure``: measurement of curves, rung by rung, within a time limit; results are kept if it is stopped
- ``drawing``: curves on one page
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.accuracy._face import *  # noqa: F403
    from lfcal.accuracy._shared import *  # noqa: F403

lazy_face(__name__)
