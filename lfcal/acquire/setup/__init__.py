"""Live set-up: measurements needed before a session, independent of the window.

- ``lfcal.acquire.spots``: position, sharpness and displacement of the spot
- ``stage_fit``: stage-to-image scale, rotation and sign from a few moves, and the movement in depth
- ``optical_axis``: the lateral position at which a movement in depth does not move the image
- ``exposure``: exposure time for each plane
- ``live``: the live view with histogram, exact saturation, and the planned position of the image
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.setup._face import *  # noqa: F403
    from lfcal.acquire.setup._shared import *  # noqa: F403

lazy_face(__name__)
