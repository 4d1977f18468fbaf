"""What accuracy costs, and which effects to simulate.

- ``planner``: the effects a scene calls for; ``cost``, ``forecast``: seconds
- ``sampling``: how finely an engine computes; ``_ladder``: measured error against seconds
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.accuracy._shared import *  # noqa: F403

lazy_face(__name__)
