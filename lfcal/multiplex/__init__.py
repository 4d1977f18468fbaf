"""Plenoptic multiplexing after I. Ihrke, G. Wetzstein, W. Heidrich, "A Theory of Plenoptic Multiplexing" (CVPR 2010).

- ``modulator``: separable bases Sigma and Pi, rank, pseudo-inverse, products; made by ``colour_filters``, ``masks``,
  ``spectral_filters`` (curves: ``spectra``), ``exposures`` (assorted pixels, shutters, cameras), ``polarisation``,
  ``tiles`` (super-pixels of any shape), ``matrix_file``; ``naming``: by the names people write
- ``demultiplexing``: frames to samples and back; ``spatial`` (theorem 1), ``fourier`` (theorem 2), ``filters``
- ``weighted``: saturated and dead pixels left out; ``general``: any modulator, by iterations
- ``lattice``: super-pixels of any pitch and angle (``super_pixels``); ``heterodyne``: both theorems there;
  ``lattice_taps``: with weights
- ``noise``: transmission, amplification, gain over chi^2 (equations 12 to 14), noise-optimal decorrelation;
  ``sensor_noise``: that of the user's sensor; ``black_level``: of its frames
- ``gains``: of each sample and of the sensor; ``colour_error``, ``resolution``: CIEDE2000 and MTF beside them
- ``scenes``, ``acquisition``: a light field recorded with each modulator (figure 7)
- ``quality``: ringing, error and time of each route and filter
- ``demosaicing``: colours estimated from what images are like (``estimation``), along edges
- ``search``: filter sets and masks of the best gain; ``mask_bounds``: what no mask exceeds
- ``design``: layouts and masks that can be made, with a certificate
- ``codes``, ``coding``: several points lit at once, and whether that pays; ``code_display``: on a display
- ``paper``: the paper's figures as data; ``drawing``, ``paper_drawing``: as PNG
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.multiplex._face import *  # noqa: F403
    from lfcal.multiplex._shared import *  # noqa: F403

lazy_face(__name__)
