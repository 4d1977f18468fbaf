"""Image files, one module a format: each says by a file's first bytes whether it can read it.

- ``image_file``: what a format must provide, the checks they share, and the format of a file, found among these
  modules and those of other packages
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.formats._face import *  # noqa: F403
    from lfcal.frames.formats._shared import *  # noqa: F403

lazy_face(__name__)
