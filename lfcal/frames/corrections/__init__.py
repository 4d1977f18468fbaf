"""Corrections that convert raw frames to corrected frames.

- ``steps``: single corrections; ``defects``: detection and repair of defective pixels
- ``chain``: all corrections in their order, in one pass
- ``recipe``: the chain that the user's settings and calibration frames define
- ``_corrected``: a frame source that applies a chain, with the noise of its samples
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.corrections._shared import *  # noqa: F403

lazy_face(__name__)
