"""The frames of a project: which are imported, how they are corrected, and what is shown of one. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gui.models.frame_view import FrameNumbers, frame_numbers
from gui.models.settings import PageSettings
from lfcal.camera import ScanPlan
from lfcal.frames.source import FrameSource, Position
from lfcal.progress import Work
from lfcal.psf.cutout import Cutout

__all__ = ["CORRECTIONS", "FrameSettings", "Loaded", "Opened", "iter_assembly", "load_frame", "open_imported"]

CORRECTIONS = (
    ("use_dark", "Dark frame", "Subtract the mean dark frame"),
    ("use_white", "White frame", "Divide by the relative brightness of the white frame"),
    ("use_defects", "Defect pixels", "Find defective pixels over all frames and interpolate them"),
    ("use_background", "Background", "Subtract the median of each frame's border"),
)
"""Setting, title and meaning of each correction."""


@dataclass(frozen=True)
class FrameSettings(PageSettings):
    """How frames are read, corrected and cut; the project says which.

    Attributes
    ----------
    manifest, pattern
        How positions are found where the folder has no manifest of its own.
    dark, white
        Folders of dark and white frames, or empty.
    use_dark, use_white, use_defects, use_background
        Which corrections are made; see `CORRECTIONS`.
    interpolation
        How cutouts between pixels are taken.
    """

    page: ClassVar[str] = "frames"

    manifest: str = ""
    pattern: str = ""
    dark: str = ""
    white: str = ""
    use_dark: bool = True
    use_white: bool = True
    use_defects: bool = False
    use_background: bool = False
    interpolation: str = "nearest"


@dataclass(frozen=True, eq=False)
class Opened:
    """The frames of a project: source, correction chain, and which frame shows which position ``(nz, ny, nx)``."""

    source: FrameSource
    chain: Any
    frames: NDArray[np.int64]
    plan: ScanPlan

    def place(self, position: Position) -> Position:
        """Return the position nearest to ``position`` that the plan has."""
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip(position, self.frames.shape, strict=True))
        return Position(z, y, x)

    def step(self, position: Position, dy: int, dx: int) -> Position:
        """Return the position ``(dy, dx)`` further, line after line within its plane."""
        _, ny, nx = self.frames.shape
        x = position.x + dx
        y = position.y + dy + (x // nx if dx else 0)
        return Position(position.z, y % ny, x % nx)


@dataclass(frozen=True, eq=False)
class Loaded:
    """One frame ``(rows, columns)``, before and after correction, with its numbers.

    Attributes
    ----------
    window
        First row, first column, rows and columns of the cutout.
    point
        Row and column of the paraxial image, where the plan has it.
    """

    position: Position
    label: str
    raw: NDArray[Any]
    fixed: NDArray[np.float32]
    numbers: FrameNumbers
    window: tuple[int, int, int, int]
    point: tuple[float, float]


def open_imported(folder: str, settings: FrameSettings, plan: ScanPlan) -> Opened:
    """Open frames and corrections as the settings say; raises what opening raises."""
    from lfcal.frames import open_frames
    from lfcal.frames.corrections.recipe import CorrectionRecipe, build_chain

    source = open_frames(
        folder,
        manifest=settings.manifest or None,
        pattern=settings.pattern or None,
        plan_shape=plan.shape[:3],
    )
    recipe = CorrectionRecipe(
        dark=settings.dark if settings.use_dark else "",
        white=settings.white if settings.use_white else "",
        defects=settings.use_defects,
        background="border" if settings.use_background else "none",
    )
    frames = np.full(plan.shape[:3], -1, np.int64)
    for index in range(len(source)):
        frames[source.position(index)] = index
    return Opened(source, build_chain(source, recipe), frames, plan)


def load_frame(opened: Opened, position: Position) -> Loaded:
    """Read one frame, correct it, count every pixel of it, and say where its cutout is."""
    index = int(opened.frames[position])
    raw = opened.source.read(index)
    level = opened.chain.saturation_level(raw.dtype)
    cutout = Cutout.for_plan(opened.plan)
    corner = cutout.window(position)
    row, column = opened.plan.image_px(position).tolist()
    return Loaded(
        position,
        opened.source.label(index),
        raw,
        opened.chain.apply(raw),
        frame_numbers(raw, level),
        (corner.row, corner.column, *cutout.reach),
        (row, column),
    )


def iter_assembly(opened: Opened, path: str) -> Work[Any]:
    """Return the work that assembles H from the frames; its result is the report of `lfcal.psf.assemble`."""
    from lfcal.psf import iter_assemble

    return iter_assemble(
        opened.source,
        opened.plan.shape[:3],
        Cutout.for_plan(opened.plan),
        path,
        corrections=opened.chain,
        depths=opened.plan.depths_um,
        camera=opened.plan.camera,
        provenance={"plan": opened.plan.to_dict()},
    )
