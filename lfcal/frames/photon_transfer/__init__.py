"""Measurement of a sensor by photon transfer, from flats and darks (EMVA 1288 release 4; Janesick 2007).

- ``_values``: a number with its standard error
- ``frame_list``: flats and darks found in folders and files, with their exposures
- ``_converter``: properties of the converter from sample values: bits in use, alignment, clipping
- ``_darks``: read noise, black level, dark current
- ``_pairs``: mean and variance of pixels of similar brightness, from pairs of flats
- ``_flats``: levels of equal light, linearity, fixed pattern and defective pixels
- ``_curve``: the photon-transfer curve: gain, saturation; ``_checks``: indications that frames are not raw
- ``measurement``: the complete measurement; ``result``: the values as text, as a plot, and in a camera
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.frames.photon_transfer._shared import *  # noqa: F403

lazy_face(__name__)
