"""Lists of frames from other programs: assignment of columns, and the stage position of each frame.

- ``table``: text tables with any separator, and the columns for file, position and exposure, by name or as stated
- ``listing``: the frames of a table, with their positions as step numbers or stage coordinates
- ``entries``: the manifest of a list, and the search for its files
- ``list_file``: opening of a list: a text table or Micro-Manager metadata
- ``_grid``: planes, rows and columns in stage coordinates
- ``_depths``: depths of planes, from z and from the steps
- ``motion``: motion of the light with the stage
- ``placing``: conversion of stage coordinates to positions of a scan plan
- ``derived``: derivation of a scan plan from a list
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.lists._shared import *  # noqa: F403

lazy_face(__name__)
