"""HDF5 files of unknown origin, read through one gate; new ones written so that a full disk is only an error.

- ``probe``: a file is read by a child process first, as damaged ones may end or hang the process that opens them
- ``reading``: the file, its attributes and its data, each checked before it is read; ``chunks``: data read and decoded
  without HDF5
- ``writing``: new files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.base.h5._shared import *  # noqa: F403

lazy_face(__name__)
