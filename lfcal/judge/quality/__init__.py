"""How good a PSF matrix is.

- ``_inspect``: reads every plane once and returns a `QualityReport`; ``report`` is what that is; ``_units``: the
  same in units of a plane
- ``metric``: what a metric is; ``metrics`` holds them, ``catalogue`` finds them
- ``measure``: what metrics share of one plane, from ``_dark``, ``pattern_table``, ``_sums``, ``_positions``,
  ``_turned``, ``_steps``
- ``across``: what they share of all planes
- ``_field``, ``_lattice``, ``_kernels``: parts, phases and compiled passes that these are made of
- ``_periodicity``: how true the tiling is, from control frames over the field
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge.quality._face import *  # noqa: F403
    from lfcal.judge.quality._shared import *  # noqa: F403

lazy_face(__name__)
