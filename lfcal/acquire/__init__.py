"""Recording a session so that nothing acknowledged is ever lost.

- ``options``, ``blocks``, ``schedule``, ``forecast``: everything a session will do, in order, and what it costs
- ``session``, ``session_file``, ``origin``: a session is begun, resumed, recorded again in parts
- ``runner``, ``attempts``, ``taking``, ``motion``, ``lighting``, ``exposing``, ``combining``: the strict loop in parts
- ``guard``, ``known``: each frame held against what it should be before it counts, and against earlier runs
- ``suspending``: a session that holds while temperature or lamp are off, and goes on by itself
- ``control``, ``preview``, ``live_quality``, ``errors``: requests to a running session, and what it reports
- ``frame_plan``, ``live_coverage``: whole frames of a target instead of cutouts of a point, and what they show so far
- ``recording``: frames on the disk that survive a crash and a power cut; a session as a `FrameSource`
- ``redo``, ``suspects``, ``finish``: positions to record again; H from a session; packing
- ``setup``, ``spots``: live set-up

Devices are those of `lfcal.devices`.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire._face import *  # noqa: F403
    from lfcal.acquire._shared import *  # noqa: F403

lazy_face(__name__)
