"""Long computations in units of work that survive a killed process, because each finished unit is a file.

- ``unit``: a unit's task, its input files, and the fingerprint that identifies its result
- ``runs``: `iter_run`, which runs the units that are not finished on an executor, and joining of finished files
- ``choice``: the choice of executor and of what happens to an earlier run; `iter_made`, which joins the units' files
- ``records``: results of units other than planes and volumes
- ``executors``: threads of this process, processes, and workers of dask.distributed
- ``journal``: events and state of a run, as shown by `lfcal status` and the window
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.work._face import *  # noqa: F403
    from lfcal.work._shared import *  # noqa: F403

lazy_face(__name__)
