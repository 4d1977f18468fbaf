"""The public names of `lfcal.frames`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.frames.channels import BalancedSource, ChannelSource, balanced_source, channel_source
from lfcal.frames.corrections.background import Background
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.corrections.corrected import CorrectedSource, corrected
from lfcal.frames.corrections.defect_search import find_defects, iter_find_defects
from lfcal.frames.corrections.defects import Defects
from lfcal.frames.corrections.recipe import CorrectionRecipe, check_turned_colours, corrected_view
from lfcal.frames.corrections.steps import Dark, Exposure, White, average_frames
from lfcal.frames.damage import iter_undamaged
from lfcal.frames.formats.opening import open_image, read_image
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.manifest_file import read_manifest, write_manifest
from lfcal.frames.opening import open_frames
from lfcal.frames.orientation import AS_IS, ORIENTATIONS, Orientation, named_orientation, nearest_orientation
from lfcal.frames.oriented import OrientedSource, oriented
from lfcal.frames.positions import NamePattern, scan_positions
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, LeftOut, Noise, Position, Samples
from lfcal.frames.sources.array import ArraySource
from lfcal.frames.sources.folder import FolderSource

__all__ = [
    "AS_IS",
    "ORIENTATIONS",
    "ArraySource",
    "Background",
    "BalancedSource",
    "ChannelSource",
    "CorrectedSource",
    "CorrectionChain",
    "CorrectionRecipe",
    "Dark",
    "Defects",
    "Exposure",
    "FolderSource",
    "FrameEntry",
    "FrameInfo",
    "FrameMetadata",
    "FrameSource",
    "Frames",
    "LeftOut",
    "Manifest",
    "NamePattern",
    "Noise",
    "Orientation",
    "OrientedSource",
    "Position",
    "Samples",
    "White",
    "average_frames",
    "balanced_source",
    "channel_source",
    "check_turned_colours",
    "corrected",
    "corrected_view",
    "find_defects",
    "iter_find_defects",
    "iter_undamaged",
    "named_orientation",
    "nearest_orientation",
    "open_frames",
    "open_image",
    "oriented",
    "read_image",
    "read_manifest",
    "scan_positions",
    "write_manifest",
]
