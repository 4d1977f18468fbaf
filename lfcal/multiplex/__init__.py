"""Plenoptic multiplexing after I. Ihrke, G. Wetzstein, W. Heidrich, "A Theory of Plenoptic Multiplexing" (CVPR 2010).

- ``modulator``: separable bases Sigma and Pi, rank, pseudo-inverse; ``colour_filters`` and ``masks`` make them
- ``demultiplexing``: frames to samples and back; ``spatial`` (theorem 1), ``fourier`` (theorem 2), ``filters``
- ``lattice``: super-pixels of any pitch and angle; ``colours``: mosaics as full frames of one colour
- ``noise``: transmission, amplification, gain over chi^2 (equations 12 to 14)
- ``scenes``, ``acquisition``: a light field recorded with each modulator (figure 7)
- ``quality``: ringing, error and time of each route and filter
- ``search``: filter sets and masks of the best gain
- ``drawing``: the paper's figures as PNG
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.multiplex.acquisition import Acquisition, acquire_light_field
    from lfcal.multiplex.colour_filters import CFA_PATTERNS, cfa
    from lfcal.multiplex.colours import ColourSource, colour_source
    from lfcal.multiplex.demultiplexing import arrange, demultiplex, multiplex
    from lfcal.multiplex.lattice import SuperPixelLattice, demultiplex_lattice, lattice_channels
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

_HOME = {
    "Acquisition": "acquisition",
    "CFA_PATTERNS": "colour_filters",
    "ColourSource": "colours",
    "FilterTrial": "quality",
    "Frontier": "search",
    "GainCurves": "noise",
    "MASKS": "masks",
    "Modulator": "modulator",
    "SuperPixelLattice": "lattice",
    "acquire_light_field": "acquisition",
    "amplification": "noise",
    "arrange": "demultiplexing",
    "best_filter_set": "search",
    "best_mask": "search",
    "camera_chi2": "noise",
    "cfa": "colour_filters",
    "colour_source": "colours",
    "demultiplex": "demultiplexing",
    "demultiplex_lattice": "lattice",
    "filter_set_frontier": "search",
    "gain_curves": "noise",
    "lattice_channels": "lattice",
    "mask": "masks",
    "mask_at_distance": "masks",
    "mask_frontier": "search",
    "mask_pattern": "masks",
    "measure_filters": "quality",
    "modulator_from_matrix": "modulator",
    "monte_carlo_gain": "noise",
    "multiplex": "demultiplexing",
    "ringing": "quality",
    "shadow_shift_px": "masks",
    "snr_gain": "noise",
    "transmission": "noise",
}

__all__ = [
    "CFA_PATTERNS",
    "MASKS",
    "Acquisition",
    "ColourSource",
    "FilterTrial",
    "Frontier",
    "GainCurves",
    "Modulator",
    "SuperPixelLattice",
    "acquire_light_field",
    "amplification",
    "arrange",
    "best_filter_set",
    "best_mask",
    "camera_chi2",
    "cfa",
    "colour_source",
    "demultiplex",
    "demultiplex_lattice",
    "filter_set_frontier",
    "gain_curves",
    "lattice_channels",
    "mask",
    "mask_at_distance",
    "mask_frontier",
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


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"lfcal.multiplex.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
