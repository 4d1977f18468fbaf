"""Inspection by model: patterns beside those that their camera should give, and the faults that differences name.

- ``evidence``: patterns beside their camera, each with its light, its source and its depth; ``compared``: which of them
- ``faults``: what may have gone wrong, one family a module, found by name
- ``cost``: what each adds to the error of a reconstruction, on a patch of H
- ``search``: one fault after the other; ``inspection``: what was found beside the metrics that need no model
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge._face import *  # noqa: F403
    from lfcal.judge._shared import *  # noqa: F403

lazy_face(__name__)
