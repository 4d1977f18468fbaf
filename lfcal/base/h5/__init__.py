"""HDF5 files: safe reading of files of unknown origin, and writing that survives a full disk.

- ``probe``: a child process reads a file first, because a damaged one may crash or hang the process that opens it
- ``reading``: file, attributes and data, each checked before it is read; ``chunks``: reading and decoding of data
  without HDF5
- ``writing``: new files; ``codecs``: optional codecs
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.base.h5._shared import *  # noqa: F403

lazy_face(__name__)
