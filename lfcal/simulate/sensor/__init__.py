"""The simulated sensor: from light to frames.

- ``noise``: conversion of photons to sample values; ``white``: the white image
- ``responses``: light of planes and of depths near them, cached, and its place on an image
- ``camera_source``: a simulated session as frames
- ``session``: such a session written to a folder
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.sensor._shared import *  # noqa: F403

lazy_face(__name__)
