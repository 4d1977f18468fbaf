"""Lists of frames that other programs wrote: which column is what, and where on the stage each frame was taken.

- ``table``: text tables of any separator, with decimal points or commas
- ``columns``: which column holds file, place and exposure, by their names or as told
- ``listing``: the frames of a table, with places in numbers of steps or in lengths
- ``names``: files as other systems write them, found in the folder
- ``micromanager``: what Micro-Manager writes beside its frames
- ``grid``: planes, rows and columns in stage coordinates
- ``step_error``: how well places tell the step of a plane
- ``depths``: depths of planes, z held against the steps
- ``motion``: where the light goes as the stage moves
- ``placing``: stage coordinates to positions of a scan plan
- ``derived``: the scan plan that a list was recorded by
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.lists._shared import *  # noqa: F403

lazy_face(__name__)
