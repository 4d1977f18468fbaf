"""Live set-up: what a person needs to see before the session begins; no window in here.

- ``lfcal.acquire.spots``: where the spot is, how sharp, how far it moved
- ``stage_fit``: stage-to-image scale, rotation and sign from a few moves, and how far the stage moves in depth
- ``optical_axis``: where moving in depth does not move the image
- ``exposure``: exposure time for each plane
- ``live``: the live view with histogram and exact saturation, and where the plan expects the image
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.setup._face import *  # noqa: F403
    from lfcal.acquire.setup._shared import *  # noqa: F403

lazy_face(__name__)
