"""The cost of accuracy, and the choice of effects to simulate.

- ``planner``: the effects that a scene needs; ``cost``, ``forecast``: computing time;
  ``calibration``: speed of this machine
- ``memory``: peak memory
- ``sampling``: sampling of an engine; ``probe``: search for the sampling of a plane; ``_ladder``: measured error
  against time
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.accuracy._shared import *  # noqa: F403

lazy_face(__name__)
