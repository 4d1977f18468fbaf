"""Executors, which process the units of a run; other packages add theirs by the entry point ``lfcal.executors``."""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.work.executors._face import *  # noqa: F403
    from lfcal.work.executors._shared import *  # noqa: F403

lazy_face(__name__)
