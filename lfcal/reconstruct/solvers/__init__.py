"""Solvers, one module each, found by registry; other distributions bring theirs (``docs/adding_a_solver.md``).

- ``choice``: all solvers by name; ``solver``: what one is; ``records``: what it reports
- ``richardson_lucy``, ``total_variation``, ``tikhonov``, ``biggs_andrews``, ``nesterov``, ``ordered_subsets``,
  ``phase_space``, ``isra``: the multiplicative ones; ``em`` is the iteration they share
- ``least_squares``: conjugate gradients, for linear problems
- ``measurement``, ``penalty``, ``acceleration``, ``subsets``, ``smoothing``: what solvers are made of
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct.solvers._face import *  # noqa: F403
    from lfcal.reconstruct.solvers._shared import *  # noqa: F403

lazy_face(__name__)
