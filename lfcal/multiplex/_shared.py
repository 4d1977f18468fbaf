"""Names of `lfcal.multiplex` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.multiplex._sensor_noise import black_level_map
from lfcal.multiplex.code_display import code_files, save_code
from lfcal.multiplex.coding import CODES
from lfcal.multiplex.colour_filters import parse_pattern
from lfcal.multiplex.colour_planes import (
    CHANNELS,
    ColourReading,
    Planes,
    dark_level,
    interpolated,
    mean_plane,
    read_planes,
    read_white,
)
from lfcal.multiplex.drawing import (
    draw_modulator,
    save_coding,
    save_filter_choice,
    save_frontier,
    save_gain_curves,
    save_gain_map,
)
from lfcal.multiplex.figures import figure_files, iter_paper_figures
from lfcal.multiplex.filters import SPATIAL_FILTERS
from lfcal.multiplex.general import iter_demultiplex_generally
from lfcal.multiplex.heterodyne import is_straight, sample_places
from lfcal.multiplex.matrix_file import MATRIX_SUFFIXES, save_modulator
from lfcal.multiplex.naming import GRAMMAR, is_whole
from lfcal.multiplex.paper import FIGURES, PaperFigure, PaperPanel, paper_figure
from lfcal.multiplex.quality import WAYS, iter_measure_filters
from lfcal.multiplex.recorded import read_recorded
from lfcal.multiplex.scenes import colour_edges, filament_light_field, view_edges, zone_plate
from lfcal.multiplex.search import SearchProgress, iter_mask_frontier
from lfcal.multiplex.summary import ModulatorNumbers, describe, merits

__all__ = [
    "CHANNELS",
    "CODES",
    "FIGURES",
    "GRAMMAR",
    "MATRIX_SUFFIXES",
    "SPATIAL_FILTERS",
    "WAYS",
    "ColourReading",
    "ModulatorNumbers",
    "PaperFigure",
    "PaperPanel",
    "Planes",
    "SearchProgress",
    "black_level_map",
    "code_files",
    "colour_edges",
    "dark_level",
    "describe",
    "draw_modulator",
    "figure_files",
    "filament_light_field",
    "interpolated",
    "is_straight",
    "is_whole",
    "iter_demultiplex_generally",
    "iter_mask_frontier",
    "iter_measure_filters",
    "iter_paper_figures",
    "mean_plane",
    "merits",
    "paper_figure",
    "parse_pattern",
    "read_planes",
    "read_recorded",
    "read_white",
    "sample_places",
    "save_code",
    "save_coding",
    "save_filter_choice",
    "save_frontier",
    "save_gain_curves",
    "save_gain_map",
    "save_modulator",
    "view_edges",
    "zone_plate",
]
