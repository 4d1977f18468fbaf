"""What a described camera does to the light of a point: only the effects a scene calls for.

- ``scene``: one depth plane as an engine needs it, with its pupil and specimen
- ``engines``: from rays to the coherent reference, their sampling, and the energy they account for
- ``effects``: physical effects as objects with their a-priori estimates, found by registry
- ``accuracy``: what a simulation costs, which effects to simulate, how finely to compute, the ladder of levels
- ``staging``, ``response``: effects put to work on one plane
- ``plane_task``: one plane of H, and all that decides its values
- ``simulate``: H, in memory, in a file or in units; ``progressive``: in passes
- ``sensor``: sensor frames of a simulated session; ``noise_forecast``: the noise that a scan leaves in H
- ``assumed_values``: what hangs on values that are only assumed
- ``volume``: light fields of extended objects through the same H
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate._face import *  # noqa: F403
    from lfcal.simulate._shared import *  # noqa: F403

lazy_face(__name__)
