"""Plenoptic multiplexing after I. Ihrke, G. Wetzstein, W. Heidrich, "A Theory of Plenoptic Multiplexing" (CVPR 2010).

- ``modulator``: separable bases Sigma and Pi, rank, pseudo-inverse; ``colour_filters`` and ``masks`` make them
- ``demultiplexing``: frames to samples and back; ``spatial`` (theorem 1), ``fourier`` (theorem 2), ``filters``
- ``lattice``: super-pixels of any pitch and angle
- ``noise``: transmission, amplification, gain over chi^2 (equations 12 to 14)
- ``scenes``, ``acquisition``: a light field recorded with each modulator (figure 7)
- ``quality``: ringing, error and time of each route and filter
- ``demosaicing``: colours estimated from what images are like (``estimation``), along edges
- ``search``: filter sets and masks of the best gain; ``mask_bounds``: what no mask exceeds
- ``drawing``: the paper's figures as PNG
"""

from lfcal.multiplex.acquisition import Acquisition, acquire_light_field
from lfcal.multiplex.colour_filters import CFA_PATTERNS, cfa
from lfcal.multiplex.demultiplexing import arrange, demultiplex, multiplex
from lfcal.multiplex.lattice import SuperPixelLattice, channel_grid, demultiplex_lattice, lattice_channels
from lfcal.multiplex.mask_bounds import best_binary_mask, mask_gain_bound
from lfcal.multiplex.masks import MASKS, mask, mask_at_distance, mask_pattern, shadow_shift_px
from lfcal.multiplex.modulator import Modulator, modulator_from_matrix
from lfcal.multiplex.noise import (
    GainCurves,
    amplification,
    camera_chi2,
    gain_curves,
    monte_carlo_gain,
    snr_gain,
    transmission,
)
from lfcal.multiplex.quality import FilterTrial, measure_filters, ringing
from lfcal.multiplex.search import Frontier, best_filter_set, best_mask, filter_set_frontier, mask_frontier

__all__ = [
    "CFA_PATTERNS",
    "MASKS",
    "Acquisition",
    "FilterTrial",
    "Frontier",
    "GainCurves",
    "Modulator",
    "SuperPixelLattice",
    "acquire_light_field",
    "amplification",
    "arrange",
    "best_binary_mask",
    "best_filter_set",
    "best_mask",
    "camera_chi2",
    "cfa",
    "channel_grid",
    "demultiplex",
    "demultiplex_lattice",
    "filter_set_frontier",
    "gain_curves",
    "lattice_channels",
    "mask",
    "mask_at_distance",
    "mask_frontier",
    "mask_gain_bound",
    "mask_pattern",
    "measure_filters",
    "modulator_from_matrix",
    "monte_carlo_gain",
    "multiplex",
    "ringing",
    "shadow_shift_px",
    "snr_gain",
    "transmission",
]
