"""Recalibrate a camera with ordinary frames, whose objects are unknown.

- ``_frames``: frames in electrons, checked; ``_window``: windows of the sensor on which they are compared with a model
- ``_patterns``: H over a window, without a period, and sums over it
- ``_scene``: the object and dark field of a frame; ``score``: the remaining information about the camera
- ``_modes``: combinations of unknowns that frames determine, and those that they do not
- ``model``: frames of a window with the model that explains them; ``recalibrate``: the complete fit; ``files``: its
  files
- ``_drift``: drift of the array in a frame, for an H that stays fixed; ``_alarm``: its statistical test
- ``watch``: a series of frames; ``watched``: its results; ``watch_files``: their files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.recalibrate._face import *  # noqa: F403
    from lfcal.recalibrate._shared import *  # noqa: F403

lazy_face(__name__)
