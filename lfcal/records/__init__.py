"""Settings that people give, each field declared once with its help, unit, range and choices.

- ``option``: how a field is declared, read, checked and stored
- ``reading``: what texts of values mean, the same for every command, form and job file
- ``corrections``: which corrections are made of frames
- ``assembly``: how frames become H, and how H is stored
- ``solvers``: settings of each solver of volumes
- ``light_fields``: how frames are brought onto H, projected, and written as voxels
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.records._shared import *  # noqa: F403

lazy_face(__name__)


def _before_others() -> None:
    """Make mypy check `record`, a decorator, before the modules that use it; never called."""
    from lfcal.records.option import record  # noqa: F401
