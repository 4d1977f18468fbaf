"""Cameras, stages and lamps behind small protocols, found by name.

- ``protocols``: interfaces of camera, stage, light and clock; `Rig` combines them
- ``errors``: kinds of device errors
- ``registry``: available backends, the reasons why others are unavailable, and the options of each
- ``rig``: the devices of a session; ``calling``, ``checked``: time limits of calls, and checks of their results
- ``backends``: real devices
- ``simulated``: a camera and a stage that need no hardware
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.devices._face import *  # noqa: F403
    from lfcal.devices._shared import *  # noqa: F403

lazy_face(__name__)
