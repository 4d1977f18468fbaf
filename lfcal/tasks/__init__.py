"""Tasks: one record for each operation, from which command, form, script and job file are generated.

- ``task``: the base of all tasks, and how a task is run
- ``sets``: all tasks by the names of their commands
- ``text``: conversion of tasks to commands, Python and job files
- ``assembly``: frames to H
- ``transpose``, ``reduce``, ``export``, ``inspect``: H to HT, to a smaller file, to other programs, and its quality
- ``reconstruct``: light-field frames to volumes
- ``simulate``: a camera to H or frames
- ``target_frames``, ``cameras``, ``matrices``: inputs as tasks open them
- ``acquire``: recordings of scans, regions and targets, and until H is good enough
- ``plan``, ``plan_fit``, ``plan_target``: scans, positions for a fit, frames of a target
- ``outputs``: rules for output files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.tasks._face import *  # noqa: F403
    from lfcal.tasks._shared import *  # noqa: F403

lazy_face(__name__)
