"""HDF5 files of unknown origin, read through one gate; new ones written so that a full disk is only an error.

- ``errors``: what HDF5 says of damaged data, in one line
- ``probe``: a file is read by a child process first, as damaged ones may end or hang the process that opens them
- ``file``, ``attributes``, ``dataset``: the file, its attributes and its data, each entry checked as it is asked for
- ``writing``: new files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.base.h5._shared import *  # noqa: F403

lazy_face(__name__)
