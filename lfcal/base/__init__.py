"""What every part stands on.

- ``axes``: array conventions shared by every part
- ``errors``, ``checks``: messages that name what was expected, what was found, what to do
- ``files``, ``system``: files written whole or not at all; calls that differ between systems
- ``h5``, ``npy``: files of unknown origin, and new ones
- ``progress``, ``threads``, ``registry``, ``compiled``: long work, processors, plug-ins, kernels
- ``notes``: what long work says by the way
- ``units``, ``_plain``, ``figures``, ``version``: numbers in words, plain values, pictures, which lfcal this is
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face as lazy_face  # given on to the window

if TYPE_CHECKING:
    from lfcal.base._face import *  # noqa: F403
    from lfcal.base._shared import *  # noqa: F403

lazy_face(__name__)
