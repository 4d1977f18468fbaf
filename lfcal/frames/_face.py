"""The public names of `lfcal.frames`, each loaded on first use."""

from __future__ import annotations

from lfcal.frames.channels import BalancedSource, ChannelSource, balanced_source, channel_source
from lfcal.frames.corrections import (
    Background,
    CorrectedSource,
    CorrectionChain,
    CorrectionRecipe,
    Dark,
    Defects,
    Exposure,
    PixelMask,
    White,
    average_frames,
    check_turned_colours,
    corrected,
    corrected_view,
    find_defects,
    iter_find_defects,
)
from lfcal.frames.damage import iter_undamaged, without_positions
from lfcal.frames.formats import open_image, read_image
from lfcal.frames.manifest import FrameEntry, Manifest, read_manifest, write_manifest
from lfcal.frames.opening import open_frames
from lfcal.frames.orientation import (
    AS_IS,
    ORIENTATIONS,
    Orientation,
    OrientedSource,
    named_orientation,
    nearest_orientation,
    oriented,
)
from lfcal.frames.positions import NamePattern, scan_positions
from lfcal.frames.source import (
    FrameInfo,
    FrameMetadata,
    Frames,
    FrameSource,
    LeftOut,
    Noise,
    Position,
    Samples,
    check_region,
)
from lfcal.frames.sources import ArraySource, FolderSource, open_unplaced

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
    "PixelMask",
    "Position",
    "Samples",
    "White",
    "average_frames",
    "balanced_source",
    "channel_source",
    "check_region",
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
    "open_unplaced",
    "oriented",
    "read_image",
    "read_manifest",
    "scan_positions",
    "without_positions",
    "write_manifest",
]
