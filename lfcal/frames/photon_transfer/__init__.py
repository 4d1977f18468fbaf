"""The sensor measured from flats and darks by photon transfer (EMVA 1288 release 4; Janesick 2007).

- ``values``: a number with its standard error
- ``frame_list``: flats and darks found in folders and files, with their exposures
- ``converter``: what the sample values themselves tell: bits in use, alignment, clipping
- ``darks``: read noise, black level, dark current
- ``pairs``: mean and variance of pixels of like brightness, from pairs of flats; ``levels``: flats of equal light
- ``curve``: the photon-transfer curve: gain, saturation; ``linearity``: signal over exposure
- ``pattern``: fixed pattern and defect pixels; ``checks``: what does not look like raw frames
- ``measurement``: all of it; ``result``: the figures, and a camera with them
- ``summary``: in words; ``figure``: the curve as a picture
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.photon_transfer._shared import *  # noqa: F403

lazy_face(__name__)
