"""Solvers, found by registry; other packages can add theirs (``docs/extending.md``).

- ``choice``: all solvers by name; ``solver``: definition of a solver; ``records``: its progress and result
- ``multiplicative`` (Richardson-Lucy alone, with a penalty, extrapolated), ``ordered_subsets`` (of pixels, of views),
  ``sieve``, ``image_space``: multiplicative solvers; ``_em`` is their common iteration
- ``least_squares``: conjugate gradients, for linear problems
- ``measurement``, ``penalty``, ``_subsets``, ``smoothing``: components of solvers
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct.solvers._face import *  # noqa: F403
    from lfcal.reconstruct.solvers._shared import *  # noqa: F403

lazy_face(__name__)
