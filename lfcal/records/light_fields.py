"""Settings for resampling frames to H, projecting them, placing voxels, and computing error bars.

Examples
--------
>>> from lfcal.reconstruct import BootstrapSettings, LightFieldSettings, ProjectionSettings, VoxelGrid
>>> print(LightFieldSettings(white="white.tif").resample, VoxelGrid(voxel="auto").margin, ProjectionSettings().method)
auto auto auto
>>> print(BootstrapSettings(replicates=5).contrast)
0.9
"""

from __future__ import annotations

import os
from functools import partial

from lfcal.base import InputError
from lfcal.records.option import check_record, opt, record
from lfcal.records.reading import check_count, check_voxel, read_count, read_pixel, read_share, read_voxel, show_pair

__all__ = ["BootstrapSettings", "LightFieldSettings", "ProjectionSettings", "VoxelGrid"]

PROJECTIONS = ("auto", "polyphase", "direct", "sparse", "reduced", "fft")
RESAMPLING = ("auto", "always", "never")

MOST_MEMORY = 1e6
"""Largest memory limit (GB) that is accepted, more than any computer has."""


@record
class LightFieldSettings:
    """Corrections applied to each frame before reconstruction."""

    dark: str | os.PathLike[str] = opt(
        "", "Dark frame, or a folder of dark frames to average.", label="Dark frame", file="in", empty="none"
    )
    white: str | os.PathLike[str] = opt(
        "", "White image, or a folder of white images to average.", label="White image", file="in", empty="none"
    )
    mask: str | os.PathLike[str] = opt(
        "",
        "Pixels without information, which are left out: an image that is not 0 at these pixels, or a list with one "
        "ROW,COLUMN per line.",
        label="Mask of pixels",
        file="in",
        empty="none",
        more=True,
    )
    resample: str = opt(
        "auto",
        "Whether frames are resampled to the period of H. auto: if the lattice of micro-images drifts by more than "
        "0.5 px over the frame.",
        choices=RESAMPLING,
    )
    lattice: str | os.PathLike[str] = opt(
        "",
        "Measured lattice to resample by (lattice.json of lfcal white).",
        file="in",
        empty="the lattice in the white image, else that of the camera of H",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
        if self.lattice and self.resample == "never":
            raise InputError.expected(
                "resample",
                "auto or always, because a lattice is given",
                "never",
                "leave the lattice out, or resample the frames",
            )

    @property
    def asked(self) -> bool | None:
        """Whether to resample frames. None: only if the lattice of micro-images drifts."""
        return {"always": True, "never": False}.get(self.resample, True if self.lattice else None)


@record
class VoxelGrid:
    """Size and position of the voxels of a volume."""

    voxel: float | str | None = opt(
        None,
        "Side length of the voxels in all planes. auto: the smallest size of a sensor pixel in object space; with a "
        "main lens, this size depends on the depth.",
        label="Voxel size",
        unit="µm",
        empty="in each plane, the size of a sensor pixel in object space",
        read=read_voxel,
        examples=("auto",),
    )
    margin: int | str = opt(
        "auto",
        "Width by which the volume extends beyond the frame, for light from outside. auto: two periods of H, or less "
        "for a small cutout or frame.",
        unit="px",
        read=partial(read_count, at_least=0, words=("auto",)),
        examples=("auto", "0"),
        more=True,
    )
    anchor: tuple[float, float] | None = opt(
        None,
        "Pixel ROW,COLUMN of the frame on which position (0, 0) of H is imaged.",
        unit="px",
        empty="as H states",
        read=read_pixel,
        show=show_pair,
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
        check_voxel("voxel", self.voxel)
        check_count("margin", self.margin, 0, "auto")


@record
class ProjectionSettings:
    """Settings for projecting volumes through H."""

    method: str = opt(
        "auto",
        "Projection method: polyphase, direct, sparse, reduced or fft. auto: the fastest that fits into memory.",
        label="Projection",
        examples=PROJECTIONS,
    )
    device: str = opt(
        "auto",
        "Where projections are computed: cpu; cuda or cuda:1, with PyTorch or CuPy. auto: an accelerator, if there is "
        "one with enough memory, else cpu.",
        examples=("auto", "cpu", "cuda"),
    )
    threshold: float = opt(
        0.0,
        "Fraction of a plane's peak below which entries of H are set to 0.",
        label="Ignore H below",
        at_least=0,
        below=1,
        read=read_share,
        more=True,
    )
    within: float = opt(
        0.0,
        "Largest relative L1 error of projections. 0.005 is several times faster; 0 is exact.",
        label="Projection error",
        at_least=0,
        below=1,
        read=read_share,
    )
    double: bool = opt(False, "Compute in double precision.", label="Double precision", more=True)
    memory: float | None = opt(
        None,
        "Largest amount of memory that the reconstruction may use.",
        unit="GB",
        above=0,
        at_most=MOST_MEMORY,
        empty="80 % of the free memory",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)


@record
class BootstrapSettings:
    """Settings of the replicates from which error bars are estimated."""

    replicates: int = opt(
        10,
        "Number of random objects that are imaged and reconstructed like the frame. 5 are quicker, but the intervals "
        "are 10 to 20 % longer.",
        at_least=3,
        at_most=1000,
    )
    contrast: float = opt(
        0.9,
        "Relative brightness variation (standard deviation of its logarithm) of the random objects around the "
        "volume. It expresses how much detail an object may have that the volume does not show.",
        above=0,
        at_most=3,
        more=True,
    )
    seed: int = opt(0, "Seed of the random objects and their noise.", at_least=0, more=True)

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
