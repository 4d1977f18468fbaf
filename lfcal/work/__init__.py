"""Long work in units that survive a kill: each unit writes one file, and is done when that file exists.

- ``unit``: the work of one unit, its input files, and the fingerprint that identifies its result
- ``runs``: run units on an executor, skip those that are done, and join their files meanwhile; `iter_run`
- ``choice``: the executor, and what happens to an earlier run; `iter_made` joins the units' files
- ``records``: results of units other than planes and volumes
- ``executors``: threads of this process, processes, workers of dask.distributed
- ``journal``: events and state of a run, as shown by `lfcal status` and the window
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.work._face import *  # noqa: F403
    from lfcal.work._shared import *  # noqa: F403

lazy_face(__name__)
