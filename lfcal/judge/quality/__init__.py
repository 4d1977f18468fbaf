"""Quality metrics of a PSF matrix.

- ``_inspect``: reads every plane once and returns a `QualityReport`; ``report`` defines the report; ``_units``: the
  same inspection, plane by plane
- ``metric``: definition of a metric; ``metrics`` contains all metrics, ``catalogue`` finds them
- ``measure``: measurements of one plane that metrics share, from ``_dark``, ``pattern_table``, ``_sums``,
  ``_positions``, ``_turned``, ``_steps``
- ``across``: measurements of all planes that metrics share
- ``_field``, ``_lattice``, ``_kernels``: decomposition of fields, phases and compiled passes used by these
- ``_periodicity``: accuracy of the tiling, from control frames over the field
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge.quality._face import *  # noqa: F403
    from lfcal.judge.quality._shared import *  # noqa: F403

lazy_face(__name__)
