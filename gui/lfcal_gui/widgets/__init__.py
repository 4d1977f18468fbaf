"""Widgets that several pages share: images with axes and colour bar, frames, plots, forms, cards, the period map."""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui.widgets._shared import *  # noqa: F403

lazy_face(__name__)
