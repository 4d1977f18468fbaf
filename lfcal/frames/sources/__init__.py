"""Kinds of frame sources, one module per kind; `lfcal.frames.open_frames` selects the kind for a path.

- ``base``: the interface of a kind of source
- ``files``: positions of frames in files, from a manifest, their names, or their order
- ``folder``: frames in the files that a manifest lists
- ``array``: frames in one array
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.sources._shared import *  # noqa: F403

lazy_face(__name__)
