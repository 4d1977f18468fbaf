"""The public names of `lfcal.lattice`, loaded when the first of them is used."""

from __future__ import annotations

from lfcal.lattice._depth_map import DepthMap
from lfcal.lattice._refocus import refocus, sensor_slope
from lfcal.lattice._view_grid import ViewGrid, view_grid
from lfcal.lattice.depth import depth_map, depth_seconds, iter_depth_map, metric_depth
from lfcal.lattice.depth_files import save_depth, save_points
from lfcal.lattice.discs import LensletDiscs, fit_discs
from lfcal.lattice.elemental_depth import elemental_depth
from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lattice_file import load_lattice, save_lattice
from lfcal.lattice.lens_types import LensTypes, classify_lens_types, expected_blur
from lfcal.lattice.micro_images import FrameLattice, MicroImageLattice, TypeLattice, cropped, lattice_of, type_lattice
from lfcal.lattice.rendering import RenderedPlanes, render, sharpness_shares, total_focus
from lfcal.lattice.views import Views, extract_views, sample_views
from lfcal.lattice.vignetting import Vignetting, vignetting_map

__all__ = [
    "DepthMap",
    "FrameLattice",
    "LatticeFit",
    "LensTypes",
    "LensletDiscs",
    "MicroImageLattice",
    "RenderedPlanes",
    "TypeLattice",
    "ViewGrid",
    "Views",
    "Vignetting",
    "classify_lens_types",
    "cropped",
    "depth_map",
    "depth_seconds",
    "elemental_depth",
    "expected_blur",
    "extract_views",
    "fit_discs",
    "fit_lattice",
    "iter_depth_map",
    "lattice_of",
    "load_lattice",
    "metric_depth",
    "refocus",
    "render",
    "sample_views",
    "save_depth",
    "save_lattice",
    "save_points",
    "sensor_slope",
    "sharpness_shares",
    "total_focus",
    "type_lattice",
    "view_grid",
    "vignetting_map",
]
