"""Where frames come from, one module a kind of source; `lfcal.frames.open_frames` finds the one that fits.

- ``base``: what a kind of source must say of itself
- ``folder``: frames in files, as a manifest, their names, or their order lists them
- ``array``: frames in one array
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.sources._shared import *  # noqa: F403

lazy_face(__name__)
