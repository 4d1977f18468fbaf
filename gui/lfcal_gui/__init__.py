"""The workstation: one window from the camera's description to the reconstructed volume."""

from typing import TYPE_CHECKING

from lfcal.base import lazy_face

if TYPE_CHECKING:
    from lfcal_gui._face import *  # noqa: F403

lazy_face(__name__)
