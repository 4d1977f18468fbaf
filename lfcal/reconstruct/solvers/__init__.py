"""Solvers, found by registry; other distributions bring theirs (``docs/extending.md``).

- ``choice``: all solvers by name; ``solver``: what one is; ``records``: what it reports
- ``multiplicative`` (Richardson-Lucy alone, with a penalty, extrapolated), ``ordered_subsets`` (of pixels, of views),
  ``sieve``, ``image_space``: the multiplicative ones; ``_em`` is the iteration they share
- ``least_squares``: conjugate gradients, for linear problems
- ``measurement``, ``penalty``, ``_subsets``, ``smoothing``: what solvers are made of
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct.solvers._face import *  # noqa: F403
    from lfcal.reconstruct.solvers._shared import *  # noqa: F403

lazy_face(__name__)
