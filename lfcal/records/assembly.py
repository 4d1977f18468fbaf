"""Settings for assembling H from frames and storing it."""

from __future__ import annotations

from lfcal.base import InputError
from lfcal.records.option import check_record, opt, record
from lfcal.records.reading import read_cutout_or_auto, read_share, show_pair

__all__ = ["AssemblySettings"]

COMPRESSIONS: tuple[str, ...] = ("gzip", "zstd", "none")
STORED_TYPES: tuple[str, ...] = ("rounded", "float32")
CODE_NAMES: tuple[str, ...] = ("olaf", "prevedel", "pyolaf", "flfm")
INTERPOLATIONS: tuple[str, ...] = ("nearest", "linear", "cubic", "fourier")


@record
class AssemblySettings:
    """Settings for assembling H from frames and storing it.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import ArraySource, open_frames
    >>> from lfcal.psf import AssemblySettings, assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     places = [frames.info(k).position for k in range(24)]
    ...     few = ArraySource(np.stack([frames.read(k) for k in range(24)]), places)
    >>> report = assemble_plan(few, plan, settings=AssemblySettings(cutout="auto", lost=0.02))
    >>> print(plan.cutout, "could be", report.matrix.cutout)
    (55, 55) could be (29, 29)
    """

    cutout: tuple[int, int] | str | None = opt(
        None,
        "Size of the cutout: an odd number of pixels, or ROWS,COLUMNS (both odd). auto: the smallest cutout that loses "
        "no more than the allowed fraction of energy.",
        unit="px",
        empty="as planned",
        read=read_cutout_or_auto,
        show=show_pair,
        examples=("auto",),
    )
    lost: float = opt(
        0.005,
        "Largest fraction of a pattern's energy that may be outside an automatic cutout.",
        label="Lost energy",
        above=0,
        below=1,
        read=read_share,
        needs=("cutout", "auto"),
        more=True,
    )
    interpolation: str = opt(
        "",
        "Interpolation for cutouts at fractional pixel positions.",
        choices=INTERPOLATIONS,
        empty="nearest; cubic if the plan resamples",
        more=True,
    )
    pad: bool = opt(
        False,
        "Fill parts of cutouts beyond the sensor with zeros, and mark these pixels as invalid.",
        label="Pad at the edge",
    )
    strict: bool = opt(False, "Stop if positions are missing or repeated.", label="Require one frame per position")
    keep_pedestal: bool = opt(
        False,
        "Assemble frames even if no black level has been subtracted from them.",
        label="Keep the black level",
        more=True,
    )
    dtype: str = opt(
        "rounded",
        "Type of the stored values. rounded: float32 in steps of at most 1/65535 of the range of the plane; compresses "
        "better.",
        label="Stored type",
        choices=STORED_TYPES,
        more=True,
    )
    compression: str = opt("gzip", "Compression of the file.", choices=COMPRESSIONS, more=True)
    store_tolerance: float | None = opt(
        None,
        "Largest relative L1 error that rounding and cropping may cause in a stored pattern, as in lfcal reduce.",
        label="Storage tolerance",
        above=0,
        below=1,
        empty="set by the stored type",
        read=read_share,
        needs=("dtype", "rounded"),
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
        if isinstance(self.cutout, tuple):
            from lfcal.base import check_cutout  # imports numpy

            check_cutout(*self.cutout)
        elif self.cutout not in (None, "auto"):
            wanted = "auto, or odd numbers of pixels such as '41', '41x41' or (41, 41)"
            raise InputError.expected("cutout", wanted, repr(self.cutout), "give one of these forms")
