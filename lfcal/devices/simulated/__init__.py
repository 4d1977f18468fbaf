"""A simulated camera and stage.

- ``backend``: the backend, and `simulated_rig` for scripts and tests
- ``_camera``, ``_stage``: the devices; ``_optics``: the light that reaches the sensor; ``_targets``: the light of many
  points
- ``faults``: faults that can be injected
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.devices.simulated._shared import *  # noqa: F403

lazy_face(__name__)
