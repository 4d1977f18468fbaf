"""The lfcal window: from the description of a camera to the reconstructed volume."""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui._face import *  # noqa: F403

lazy_face(__name__)
