"""Where frames come from and how they are cleaned.

- ``source``: the protocol all frames share
- ``opening``: recorded frames with their positions, from wherever they lie
- ``folder``, ``stack``: frames in files, and in one array
- ``images``: files told by their first bytes; ``png``, ``tiff``, ``pgm``, ``npy``, ``hdf5``, ``raw`` read them
- ``manifest``, ``manifest_file``, ``positions``: which frame was taken where
- ``regions``: parts of a frame, read without the rest where the source can
- ``cfa``, ``channels``: colour filter patterns, and mosaics by channel
- ``steps``, ``defects``, ``background``: single corrections; ``corrections``: the ordered chain of them
- ``defect_search``: defect pixels found over the frames
- ``corrected_source``: a source seen through a chain
- ``lattice_fit``: the lenslet lattice from a white image (``lattice_spectrum``, ``lattice_rounds``, ``lattice_model``,
  ``micro_image`` are its steps); ``lens_types`` finds the three types, ``vignetting`` the fall of light
- ``views``: sub-aperture views and refocused images of a frame
"""

from lfcal.frames.channels import BalancedSource, ChannelSource, balanced_source, channel_source
from lfcal.frames.corrections.background import Background
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.corrections.defect_search import find_defects, iter_find_defects
from lfcal.frames.corrections.defects import Defects
from lfcal.frames.corrections.steps import Dark, Exposure, White, average_frames
from lfcal.frames.corrections.view import CorrectedSource, corrected
from lfcal.frames.folder import FolderSource
from lfcal.frames.formats.opening import open_image, read_image
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.manifest_file import read_manifest, write_manifest
from lfcal.frames.opening import open_frames
from lfcal.frames.positions import NamePattern, scan_positions
from lfcal.frames.regions import read_region
from lfcal.frames.source import FrameSource, Position
from lfcal.frames.stack import ArraySource, frame_drift, frame_exposure
from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lens_types import LensTypes, classify_lens_types, expected_blur
from lfcal.lattice.views import Views, extract_views, refocus, sensor_slope
from lfcal.lattice.vignetting import Vignetting, vignetting_map

__all__ = [
    "ArraySource",
    "Background",
    "BalancedSource",
    "ChannelSource",
    "CorrectedSource",
    "CorrectionChain",
    "Dark",
    "Defects",
    "Exposure",
    "FolderSource",
    "FrameEntry",
    "FrameSource",
    "LatticeFit",
    "LensTypes",
    "Manifest",
    "NamePattern",
    "Position",
    "Views",
    "Vignetting",
    "White",
    "average_frames",
    "balanced_source",
    "channel_source",
    "classify_lens_types",
    "corrected",
    "expected_blur",
    "extract_views",
    "find_defects",
    "fit_lattice",
    "frame_drift",
    "frame_exposure",
    "iter_find_defects",
    "open_frames",
    "open_image",
    "read_image",
    "read_manifest",
    "read_region",
    "refocus",
    "scan_positions",
    "sensor_slope",
    "vignetting_map",
    "write_manifest",
]
