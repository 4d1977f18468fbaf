"""Frame sources, and corrections of frames.

- ``source``: the protocol of all frame sources, and parts of a frame; ``view``: a source that views another one
- ``opening``: `open_frames`, which opens any kind of frames; ``sources``: the kinds of source that it opens
- ``formats``: image files, one module per format
- ``manifest``, ``positions``: the position of each frame; ``lists``: positions from the lists of other programs
- ``part``: frames that show a part of the sensor; ``cfa``, ``channels``: colour filter patterns, and channels of
  mosaics
- ``described``: facts that a scan plan adds to the frames' metadata; ``aligned``: left-aligned samples
- ``orientation``: the eight flips and turns, and frames turned upright; ``white_orientation``: that of a white image
- ``half_cell``: completion of a half-cell scan
- ``recorded``: times of recording
- ``damage``: frames that cannot be read, which are reported and left out
- ``corrections``: single corrections, their chain, the recipe, and the corrected view made from it
- ``photon_transfer``: measurement of a sensor from flats and darks
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames._face import *  # noqa: F403
    from lfcal.frames._shared import *  # noqa: F403

lazy_face(__name__)
