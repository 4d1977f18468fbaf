"""What needs both recording and fit.

- ``patterns``: the patterns of a session as a fit takes them
- ``steps``: when such a session ends, what is known after each fit, how it ended
- ``regions``: several regions of the field in one session, and H of all of them in one file
- ``points``: the points of a target's frames; ``point_frames``: each that shows a position as a frame of its own
- ``point_parts``: points as patterns of parts of the field; ``point_fit``: one camera from them; ``point_files``: its
  files; ``point_facts``: what the frames say of the target
- ``adaptive``: record, fit, choose the next positions, until the error of H is as small as wanted
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.campaign._face import *  # noqa: F403
    from lfcal.campaign._shared import *  # noqa: F403

lazy_face(__name__)
