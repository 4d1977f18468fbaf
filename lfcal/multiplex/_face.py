"""The public names of `lfcal.multiplex`, loaded on first use."""

from __future__ import annotations

from lfcal.multiplex._colour_error import ColourError, colour_difference, colour_error
from lfcal.multiplex._sensor_noise import SensorNoise, pixel_weights, sensor_noise, without_black_level
from lfcal.multiplex.acquisition import Acquisition, acquire_light_field
from lfcal.multiplex.code_display import DisplayFit, display_fit, display_frames
from lfcal.multiplex.coding import (
    CodingGain,
    CodingNumbers,
    CodingVerdict,
    code_matrix,
    coding_gain,
    coding_pays,
    measured_coding_gain,
    overlapping_patterns,
    random_code,
    s_matrix,
)
from lfcal.multiplex.colour_filters import CFA_PATTERNS, cfa
from lfcal.multiplex.demultiplexing import arrange, demultiplex, demultiplex_weighted, multiplex
from lfcal.multiplex.design import Design, best_array, best_printed_mask, with_crosstalk
from lfcal.multiplex.exposures import camera_array, coded_shutter, interleave, neutral_density
from lfcal.multiplex.general import demultiplex_generally, mask_shadows
from lfcal.multiplex.heterodyne import lattice_transmissions
from lfcal.multiplex.lattice import (
    channel_grid,
    demultiplex_lattice,
    demultiplex_lattice_weighted,
    lattice_channels,
    lattice_channels_weighted,
)
from lfcal.multiplex.masks import (
    MASKS,
    best_binary_mask,
    mask,
    mask_at_distance,
    mask_gain_bound,
    mask_pattern,
    shadow_shift_px,
)
from lfcal.multiplex.matrix_file import load_modulator
from lfcal.multiplex.modulator import Modulator, modulator_from_matrix
from lfcal.multiplex.naming import modulator_of
from lfcal.multiplex.noise import (
    GainCurves,
    GainMap,
    amplification,
    camera_chi2,
    decorrelation_gain,
    gain_curves,
    gain_map,
    monte_carlo_gain,
    noise_optimal_inverse,
    pixel_variance,
    sample_deviation,
    sensor_gain,
    snr_gain,
    transmission,
)
from lfcal.multiplex.polarisation import degree_of_polarisation, polarisers
from lfcal.multiplex.quality import FilterTrial, Transfer, measure_filters, modulation_transfer, ringing
from lfcal.multiplex.search import Frontier, best_filter_set, best_mask, filter_set_frontier, mask_frontier
from lfcal.multiplex.spectra import (
    Spectra,
    bandpass_filters,
    cosine_basis,
    read_spectra,
    shipped_spectra,
    spectral_array,
)
from lfcal.multiplex.super_pixels import SuperPixelLattice
from lfcal.multiplex.tiles import tiled_modulator
from lfcal.multiplex.weighted import WeightedSamples

__all__ = [
    "CFA_PATTERNS",
    "MASKS",
    "Acquisition",
    "CodingGain",
    "CodingNumbers",
    "CodingVerdict",
    "ColourError",
    "Design",
    "DisplayFit",
    "FilterTrial",
    "Frontier",
    "GainCurves",
    "GainMap",
    "Modulator",
    "SensorNoise",
    "Spectra",
    "SuperPixelLattice",
    "Transfer",
    "WeightedSamples",
    "acquire_light_field",
    "amplification",
    "arrange",
    "bandpass_filters",
    "best_array",
    "best_binary_mask",
    "best_filter_set",
    "best_mask",
    "best_printed_mask",
    "camera_array",
    "camera_chi2",
    "cfa",
    "channel_grid",
    "code_matrix",
    "coded_shutter",
    "coding_gain",
    "coding_pays",
    "colour_difference",
    "colour_error",
    "cosine_basis",
    "decorrelation_gain",
    "degree_of_polarisation",
    "demultiplex",
    "demultiplex_generally",
    "demultiplex_lattice",
    "demultiplex_lattice_weighted",
    "demultiplex_weighted",
    "display_fit",
    "display_frames",
    "filter_set_frontier",
    "gain_curves",
    "gain_map",
    "interleave",
    "lattice_channels",
    "lattice_channels_weighted",
    "lattice_transmissions",
    "load_modulator",
    "mask",
    "mask_at_distance",
    "mask_frontier",
    "mask_gain_bound",
    "mask_pattern",
    "mask_shadows",
    "measure_filters",
    "measured_coding_gain",
    "modulation_transfer",
    "modulator_from_matrix",
    "modulator_of",
    "monte_carlo_gain",
    "multiplex",
    "neutral_density",
    "noise_optimal_inverse",
    "overlapping_patterns",
    "pixel_variance",
    "pixel_weights",
    "polarisers",
    "random_code",
    "read_spectra",
    "ringing",
    "s_matrix",
    "sample_deviation",
    "sensor_gain",
    "sensor_noise",
    "shadow_shift_px",
    "shipped_spectra",
    "snr_gain",
    "spectral_array",
    "tiled_modulator",
    "transmission",
    "with_crosstalk",
    "without_black_level",
]
