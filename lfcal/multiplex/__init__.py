"""Plenoptic multiplexing after I. Ihrke, G. Wetzstein, W. Heidrich, "A Theory of Plenoptic Multiplexing" (CVPR 2010).

- ``modulator``: separable bases Sigma and Pi, rank, pseudo-inverse, products; made by ``colour_filters``, ``masks``,
  ``spectra`` (filters as curves), ``exposures`` (assorted pixels, shutters, cameras), ``polarisation``,
  ``tiles`` (super-pixels of any shape), ``matrix_file``; ``naming``: by the names people write
- ``demultiplexing``: frames to samples and back; ``_spatial`` (theorem 1), ``_fourier`` (theorem 2), ``filters``
- ``weighted``: saturated and dead pixels left out; ``general``: any modulator, by iterations
- ``lattice``: super-pixels of any pitch and angle (``super_pixels``), also with weights; ``heterodyne``: both theorems
  there
- ``noise``: transmission, amplification, gain over chi^2 (equations 12 to 14), noise-optimal decorrelation; gains of
  each sample and of the sensor; ``_sensor_noise``: noise and black level of the user's sensor
- ``scenes``, ``acquisition``: a light field recorded with each modulator (figure 7)
- ``quality``: ringing, error, time and MTF of each route and filter; ``_colour_error``: CIEDE2000
- ``_demosaicing``: colours estimated under a prior of images, along edges
- ``search``: filter sets and masks of the best gain; ``masks``: also the bound that no mask exceeds
- ``design``: layouts and masks that can be made, with a certificate
- ``coding``: several points lit together, and whether that pays; ``code_display``: on a display
- ``recorded``: frames as files state them
- ``paper``: the paper's figures as data and as PNG; ``figures``: all of them as files; ``drawing``: the rest as PNG
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.multiplex._face import *  # noqa: F403
    from lfcal.multiplex._shared import *  # noqa: F403

lazy_face(__name__)
