"""Lists of frames that other programs wrote: which column is what, and where on the stage each frame was taken.

- ``table``: text tables of any separator, and which column holds file, place and exposure, by its name or as stated
- ``listing``: the frames of a table, with places in numbers of steps or in lengths
- ``entries``: the manifest of a list, with its files found in the folder
- ``list_file``: the file of a list, text table or Micro-Manager's metadata, opened
- ``_grid``: planes, rows and columns in stage coordinates
- ``_depths``: depths of planes, z held against the steps
- ``motion``: where the light goes as the stage moves
- ``placing``: stage coordinates to positions of a scan plan
- ``derived``: the scan plan that a list was recorded by
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.lists._shared import *  # noqa: F403

lazy_face(__name__)
