"""Settings that users give. Each field is declared once with its help, unit, range and choices.

- ``option``: declaring, reading, checking and storing a field
- ``reading``: parsing of values from text, the same for every command, form and job file
- ``corrections``: the corrections applied to frames
- ``assembly``: how frames become H, and how H is stored
- ``solvers``: settings of each solver of volumes
- ``light_fields``: how frames are resampled to H and projected, and how voxels are placed
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.records._shared import *  # noqa: F403

lazy_face(__name__)


def _before_others() -> None:
    """Make mypy check `record`, a decorator, before the modules that use it; it is never called."""
    from lfcal.records.option import record  # noqa: F401
