"""Plenoptic multiplexing after I. Ihrke, G. Wetzstein, W. Heidrich, "A Theory of Plenoptic Multiplexing" (CVPR 2010).

- ``modulator``: separable bases Sigma and Pi, rank, pseudo-inverse, products; made by ``colour_filters``, ``masks``,
  ``spectra`` (filters as curves), ``exposures`` (assorted pixels, shutters, cameras), ``polarisation``, ``tiles``
  (super-pixels of any shape), ``matrix_file``; ``naming``: by names
- ``demultiplexing``: frames to samples and back; ``_spatial`` (theorem 1), ``_fourier`` (theorem 2), ``filters``
- ``weighted``: without saturated and dead pixels; ``general``: any modulator, by iteration
- ``lattice``: super-pixels of any pitch and angle (``super_pixels``), also with weights; ``heterodyne``: both theorems
  there
- ``noise``: transmission, amplification, gain over chi^2 (equations 12 to 14), noise-optimal decorrelation; gains of
  each sample and of the sensor; ``_sensor_noise``: noise and black level of the user's sensor
- ``scenes``, ``acquisition``: a light field recorded with each modulator (figure 7)
- ``quality``: ringing, error, time and MTF of each route and filter; ``_colour_error``: CIEDE2000
- ``_demosaicing``: colours estimated under a prior of images, along edges
- ``search``: filter sets and masks with the best gain; ``masks``: also the upper bound for any mask
- ``design``: manufacturable layouts and masks, with a bound on better ones
- ``coding``: several points lit together, and whether that is an advantage; ``code_display``: on a display
- ``recorded``: frames with metadata of their files
- ``paper``: the paper's figures as data and as PNG; ``figures``: all of them as files; ``drawing``: other plots
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.multiplex._face import *  # noqa: F403
    from lfcal.multiplex._shared import *  # noqa: F403

lazy_face(__name__)
