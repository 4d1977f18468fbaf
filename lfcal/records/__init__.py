"""Settings that users choose; each field is declared once with its help, unit, range and choices.

- ``option``: declaration, reading, checks and storage of a field
- ``reading``: parsing of values from text, the same for every command, form and job file
- ``corrections``: the corrections applied to frames
- ``assembly``: assembly of frames to H, and storage of H
- ``solvers``: settings of each solver of volumes
- ``light_fields``: resampling of frames to H, projection, and the grid of voxels
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.records._shared import *  # noqa: F403

lazy_face(__name__)


def _before_others() -> None:
    """Make mypy check `record`, a decorator, before the modules that use it; it is never called."""
    from lfcal.records.option import record  # noqa: F401
