"""The crash-safe recording: frames and records in place, one sync each, readable at any moment.

- ``records``: what is noted with every frame, and the proof that both are whole
- ``recording_file``: one recording file, written in place and read; ``store``: the files of one session;
  ``writer``: the writing thread
- ``durable``: the lock of a session folder, and a check of the free space
- ``_recorded``: what belongs into a file and what of it is there, without its header or end too
- ``_verify``: what of a session is whole, damaged, or was never taken, and its repair
- ``source``: a recorded session as frames, of cutouts or of a whole target; ``opening``: either of them
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.recording._shared import *  # noqa: F403

lazy_face(__name__)
