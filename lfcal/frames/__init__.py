"""Where frames come from and how they are cleaned.

- ``source``: the protocol all frames share, and parts of a frame; ``view``: a source that looks at another one
- ``opening``: `open_frames`, the only door; ``sources``: the kinds of source behind it
- ``formats``: image files, one module a format
- ``manifest``, ``positions``: which frame was taken where; ``lists``: the same from what other programs wrote
- ``part``: frames that are a part of the sensor; ``cfa``, ``channels``: colour filter patterns, and mosaics by channel
- ``described``: what a scan plan adds to what frames say of themselves; ``aligned``: left-aligned samples
- ``orientation``: the eight flips and turns, and frames turned upright
- ``damage``: frames that cannot be read, named and left out
- ``corrections``: single corrections, their chain, the recipe, and the corrected view made from it
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames._face import *  # noqa: F403
    from lfcal.frames._shared import *  # noqa: F403

lazy_face(__name__)
