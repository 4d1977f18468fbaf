"""Record a session without losing an acknowledged frame.

- ``options``, ``schedule``, ``_forecast``: settings, all steps of a session in order, and their cost
- ``session``, ``session_file``: start, continuation and partial repetition of a session
- ``runner``: the loop over all steps, with ``_motion``, ``lighting`` and ``_exposing``
- ``guard``: check of each frame's content before it is accepted
- ``suspending``: automatic pauses of a session while temperature or lamp are out of bounds
- ``control``, ``preview``, ``live_quality``, ``errors``: requests to a running session, and its reports
- ``frame_plan``, ``live_coverage``: whole frames of a target instead of cutouts of a point, and the positions that
  they show so far
- ``recording``: frames on disk that survive a crash and a power cut; a session as a `FrameSource`
- ``redo``, ``finish``: positions to record again; H from a session; packing
- ``earlier``: records of earlier runs; ``stills``: white and dark frames of the whole sensor
- ``setup``, ``spots``: measurements for setting up the rig

Devices are defined in `lfcal.devices`.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire._face import *  # noqa: F403
    from lfcal.acquire._shared import *  # noqa: F403

lazy_face(__name__)
