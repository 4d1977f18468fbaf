"""State and functions that pages and the window share, without Qt: frozen state and pure functions.

- ``project``: the one project: camera, plan, files, settings; undo, save, autosave, recent
- ``settings``: base of a page's settings, which the project stores by page
- ``page``: description of a page before it is opened, and the registry of pages
- ``form``: fields of forms, and conversion between values and text
- ``display``: conversion of arrays to images: levels, log, gamma, binning
- ``frame_view``: the visible part of a large frame, its statistics, and the lattice over it
"""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui.models._face import *  # noqa: F403
    from lfcal_gui.models._shared import *  # noqa: F403

lazy_face(__name__)
