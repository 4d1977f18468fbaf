"""The crash-safe recording: frames and records in place, one sync each, readable at any moment.

- ``records``: what is noted with every frame, and the proof that both are whole
- ``slots``: one recording file, written in place; ``store``: the files of one session; ``writer``: the writing thread
- ``durable``: the lock of a session folder, and a look at the free space
- ``verify``: what of a session is whole, damaged, or was never taken; ``recovery``: files without header or end;
  ``repair``: a session made ready to take its damaged frames again
- ``reader``: one recording file, read; ``contents``: what belongs into it; ``recorded``: what is left of it
- ``source``: a recorded session as frames; ``darks``: its dark frames
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.acquire.recording._shared import *  # noqa: F403

lazy_face(__name__)
