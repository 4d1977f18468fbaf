"""What accuracy costs, everywhere it is paid: curves of error against seconds, bytes or frames for one camera or H.

- ``curves``: `Rung`, `Curve`, the Pareto front, the cheapest rung for an error
- ``subject``: the scan plan or H that is measured, and samples of it that are quick to work with
- ``place``: `Place`, a module of ``places`` each, found by registry
- ``measure``: places to curves, rung by rung, within seconds; what was measured is kept when it is stopped
- ``drawing``: curves on one page
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.accuracy._face import *  # noqa: F403
    from lfcal.accuracy._shared import *  # noqa: F403

lazy_face(__name__)
