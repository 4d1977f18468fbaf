"""Readers of image files, one module per format; most formats are recognised by the first bytes of a file.

- ``image_file``: the interface of a format, shared checks, and the choice of the format for a file, including formats
  from other packages
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.formats._face import *  # noqa: F403
    from lfcal.frames.formats._shared import *  # noqa: F403

lazy_face(__name__)
