"""Tasks: one record for each operation. Its command, form, Python call and job file are generated from the record.

- ``task``: the base of all tasks, and how a task is run
- ``sets``: all tasks by the names of their commands
- ``text``: conversion of tasks to commands, Python and job files
- ``assembly``: frames to H
- ``transpose``, ``reduce``, ``export``: H to HT, to a smaller file, to files of other programs
- ``inspect``: the quality of H
- ``fit``, ``fit_validate``, ``fit_check``, ``fit_object``, ``fit_frames``: fits of a camera, their checks, and
  recalibration with ordinary frames
- ``depth``: one light-field frame to a depth map
- ``reconstruct``: light-field frames to volumes, or the expected time and memory
- ``simulate``: a camera to H or frames
- ``target_frames``, ``cameras``, ``matrices``: inputs as tasks open them
- ``watch``: whether H is still valid for ordinary frames
- ``acquire``: recording of scans, regions and targets, for planned positions or until H is accurate enough
- ``plan``, ``plan_fit``, ``plan_target``: scans, positions for a fit, frames of a target
- ``outputs``: rules for output files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.tasks._face import *  # noqa: F403
    from lfcal.tasks._shared import *  # noqa: F403

lazy_face(__name__)
