"""Shared foundations of all packages.

- ``axes``: array conventions shared by all packages
- ``errors``, ``checks``: validation, and messages that state what was expected, what was found, and what to do
- ``files``, ``system``: atomic writing of files; calls that differ between operating systems
- ``opencv``: OpenCV, checked
- ``h5``, ``npy``: safe reading of HDF5 and NPY files of unknown origin, and writing of new ones
- ``ome_zarr``: safe reading of OME-Zarr
- ``progress``, ``threads``, ``registry``, ``compiled``: long work, processors, plug-ins, kernels
- ``notes``: messages that long work reports while it runs
- ``finding``, ``page``: problems found in data with their verdict, and HTML pages
- ``window_libraries``: system libraries that the window needs
- ``units``, ``_plain``, ``figures``, ``version``: numbers as text, plain values, plots, the version of lfcal
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face as lazy_face  # re-exported for the window

if TYPE_CHECKING:
    from lfcal.base._face import *  # noqa: F403
    from lfcal.base._shared import *  # noqa: F403

lazy_face(__name__)
