"""The window brought to states worth looking at, one after the other: for pictures and for rules of layout.

``stage``
    A window that is led from outside.
``sample``, ``parts``, ``recording``, ``trouble``
    The states: a new window; the sample session; a session that is recorded; pictures as large as those of real
    cameras; dialogs; what goes wrong.
"""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui.scenes._shared import *  # noqa: F403

lazy_face(__name__)
