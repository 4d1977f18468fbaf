"""The content guard: each frame is checked before it counts.

- ``doubts``: what can be wrong with a frame, and the words for it
- ``content``: content of an earlier exposure, and light, place, dark level and clipping that differ from the frames
  around it

A frame is judged by what was recorded before it, never by a model: any camera and any pattern will do. What only looks
unusual is no fault yet: `lfcal.acquire.runner` takes the frame again, and then a frame that is known, to see whether
the rig changed or the pattern.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.guard._shared import *  # noqa: F403

lazy_face(__name__)
