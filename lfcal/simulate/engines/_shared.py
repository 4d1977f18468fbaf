"""Names of `lfcal.simulate.engines` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate.engines._geometric import lattice_passed
from lfcal.simulate.engines.base import LEVELS, Certificate, Displaceable, EnergyError, PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.extent import MAX_ORDERS, MAX_SAMPLES, MAX_SIDE, SWITCH, SWITCH_EXACT, Extent
from lfcal.simulate.engines.field import choose_mode, field_modes
from lfcal.simulate.engines.grid import extent_of, largest_angle
from lfcal.simulate.engines.masks import MAX_CACHED, MAX_TABLE, RING, bent_fineness, fineness
from lfcal.simulate.engines.microscope import DEBYE_CACHE_BYTES, MARGIN_PER_NODE, MOST_ROWS, highest_order, reach_um
from lfcal.simulate.engines.pupil import PUPIL_LEVELS, PupilPlane, pupil_bytes, pupil_cost, pupil_error, pupil_passed
from lfcal.simulate.engines.reference import REFERENCE_CACHE_BYTES
from lfcal.simulate.engines.tables import aperture_radius, aperture_width, table_reach, window_of
from lfcal.simulate.engines.tilted import orders_of
from lfcal.simulate.engines.zernike import zernike_wavefront

__all__ = [
    "DEBYE_CACHE_BYTES",
    "LEVELS",
    "MARGIN_PER_NODE",
    "MAX_CACHED",
    "MAX_ORDERS",
    "MAX_SAMPLES",
    "MAX_SIDE",
    "MAX_TABLE",
    "MOST_ROWS",
    "PUPIL_LEVELS",
    "REFERENCE_CACHE_BYTES",
    "RING",
    "SWITCH",
    "SWITCH_EXACT",
    "Certificate",
    "Displaceable",
    "EnergyError",
    "Extent",
    "PlaneEngine",
    "PupilPlane",
    "Sampling",
    "aperture_radius",
    "aperture_width",
    "bent_fineness",
    "choose_mode",
    "engine_for",
    "extent_of",
    "field_modes",
    "fineness",
    "highest_order",
    "largest_angle",
    "lattice_passed",
    "orders_of",
    "pupil_bytes",
    "pupil_cost",
    "pupil_error",
    "pupil_passed",
    "reach_um",
    "table_reach",
    "window_of",
    "zernike_wavefront",
]
