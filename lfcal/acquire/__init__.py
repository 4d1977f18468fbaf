"""Recording a session so that nothing acknowledged is ever lost.

- ``options``, ``schedule``, ``_forecast``: everything a session will do, in order, and its cost
- ``session``, ``session_file``: a session is begun, resumed, recorded again in parts
- ``runner``: the strict loop, on ``_motion``, ``lighting`` and ``_exposing``
- ``guard``: the content of each frame is checked before it counts
- ``suspending``: a session that holds while temperature or lamp are off, and continues automatically
- ``control``, ``preview``, ``live_quality``, ``errors``: requests to a running session, and what it reports
- ``frame_plan``, ``live_coverage``: whole frames of a target instead of cutouts of a point, and what they show so far
- ``recording``: frames on the disk that survive a crash and a power cut; a session as a `FrameSource`
- ``redo``, ``finish``: positions to record again; H from a session; packing
- ``earlier``: what earlier runs recorded; ``stills``: white and dark frames of the whole sensor
- ``setup``, ``spots``: live set-up

Devices are those of `lfcal.devices`.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire._face import *  # noqa: F403
    from lfcal.acquire._shared import *  # noqa: F403

lazy_face(__name__)
