"""Cameras, stages and lamps behind small protocols, found by name.

- ``protocols``: what a camera, a stage, a light and a clock must do; `Rig` holds them together
- ``errors``: what can go wrong with a device, by kind
- ``registry``: which backends there are, why others are not, and their options
- ``rig``: the devices of a session; ``calling``, ``checked``: time limits of their calls, checks of their answers
- ``backends``: real devices
- ``simulated``: a camera and a stage that need no hardware
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.devices._face import *  # noqa: F403
    from lfcal.devices._shared import *  # noqa: F403

lazy_face(__name__)
