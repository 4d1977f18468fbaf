"""Simulation of the light of a point through a described camera, with only the effects that a scene needs.

- ``scene``: description of one depth plane for an engine, with pupil and specimen
- ``engines``: engines from rays to the coherent reference, their sampling, and their energy balance
- ``effects``: physical effects as objects with their a-priori estimates, found by registry
- ``accuracy``: cost of a simulation, choice of effects and sampling, the ladder of levels
- ``staging``, ``response``: effects applied to one plane
- ``plane_task``: one plane of H with all settings that determine its values
- ``simulate``: H, in memory, in a file or in units; ``progressive``: in passes
- ``sensor``: sensor frames of a simulated session; ``noise_forecast``: the noise that a scan leaves in H
- ``assumed_values``: how much results change with values that are only assumed
- ``cutout_light``: the light inside the cutout; ``undescribed``: effects that the camera does not describe
- ``sample``: the sample sessions of the package
- ``volume``: light fields of extended objects through the same H
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate._face import *  # noqa: F403
    from lfcal.simulate._shared import *  # noqa: F403

lazy_face(__name__)
