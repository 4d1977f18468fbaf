"""Workflows that combine recording and fitting.

- ``regions``: several regions of the field in one session, and H of all of them in one file
- ``points``: the points of a target's frames, also as patterns of parts of the field
- ``point_assembly``: H of the points that match positions of a scan
- ``point_fit``: one camera fitted to the points, and its files
- ``turned_frames``: detection of frames that are flipped or turned relative to their camera
- ``adaptive``: recording, fitting and choosing the next positions in turn, until the error of H is small enough
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.campaign._face import *  # noqa: F403
    from lfcal.campaign._shared import *  # noqa: F403

lazy_face(__name__)
