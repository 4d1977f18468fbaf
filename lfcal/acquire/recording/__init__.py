"""The crash-safe recording: frames and records are written in place and synchronised, and are readable at any time.

- ``records``: the record of every frame, and checksums of both
- ``recording_file``: one recording file, written in place and read; ``store``: the files of one session;
  ``writer``: the writing thread
- ``durable``: the lock of a session folder, and a check of the free space
- ``_recorded``: expected and existing content of a file, even without its header or end
- ``_verify``: check which frames are intact, damaged, or were never taken, and repair
- ``source``: a recorded session as frames, of cutouts or of a whole target; ``opening``: either of them
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.recording._shared import *  # noqa: F403

lazy_face(__name__)
