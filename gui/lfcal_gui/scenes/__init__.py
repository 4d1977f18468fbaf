"""Scenes that bring the window to typical states, for screenshots and layout checks.

``stage``
    A window that scenes control.
``sample``, ``parts``, ``recording``, ``trouble``
    The scenes: the sample session; the empty window, large pictures and a target; a session that is recorded; dialogs
    and errors.
"""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui.scenes._shared import *  # noqa: F403

lazy_face(__name__)
