"""Between a raw frame and a clean one.

- ``steps``, ``defects``, ``background``: single corrections; ``chain``: all of them in their order, in one pass
- ``defect_search``: defect pixels found over many frames
- ``noise``: the variance of a corrected sample
- ``recipe``: which corrections are asked for, with which calibration frames
- ``corrected``: a frame source seen through a chain
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.corrections._shared import *  # noqa: F403

lazy_face(__name__)
