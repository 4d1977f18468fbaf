"""Long work in units that survive a kill: each writes one file, and is done when that file is there.

- ``unit``: what is to be done, from which files, and the fingerprint that tells a result of these from any other
- ``runs``: units through an executor, those that are done left out, and their files joined meanwhile; `iter_run`
- ``choice``: by whom, and what becomes of an earlier run; `iter_made` joins the units' files
- ``records``: what units found that is no plane or volume
- ``executors``: threads of this process, processes, workers of dask.distributed
- ``journal``: what a run did and does, as `lfcal status` and the window show it
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.work._face import *  # noqa: F403
    from lfcal.work._shared import *  # noqa: F403

lazy_face(__name__)
