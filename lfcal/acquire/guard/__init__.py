"""The content guard: each frame is checked before it is accepted.

- ``doubts``: possible faults of a frame, with their messages
- ``content``: detection of content from an earlier exposure, and of light, position of the light, dark level and
  clipping that differ from neighbouring frames

A frame is compared with earlier frames, never with a model, so that the check works for any camera and pattern. An
unusual frame is not a fault yet. `lfcal.acquire.runner` takes the frame again, and then a known position, to see
whether the rig has changed or the pattern is unusual.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.guard._shared import *  # noqa: F403

lazy_face(__name__)
