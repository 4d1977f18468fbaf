"""The frames that ``lfcal reconstruct`` is given, and what is done to each before it is reconstructed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.reconstruct.resample import Resampling

__all__ = ["Cleaner", "FrameFile", "cleaner", "frames_of"]

Cleaner = Callable[["NDArray[Any]"], "NDArray[Any]"]
"""What is done to a frame before it is reconstructed."""


@dataclass(frozen=True)
class FrameFile:
    """Where a frame of a series is.

    Attributes
    ----------
    name
        The frame's.
    file, page
        Image file, and page in it.
    """

    name: str
    file: Path
    page: int

    def read(self) -> NDArray[Any]:
        """Return its samples ``(rows, columns)``."""
        from lfcal.frames.formats.opening import read_image

        return read_image(self.file, self.page)


def frames_of(path: Path) -> list[FrameFile]:
    """Return every page of an image file or of the images of a folder, in natural order.

    Raises
    ------
    InputError
        If there is none, or two have the same name.
    """
    from lfcal.frames.formats.opening import image_suffixes, open_image
    from lfcal.frames.positions import natural_key

    files = [path]
    if path.is_dir():
        names = sorted((p.name for p in path.iterdir() if p.suffix.lower() in image_suffixes()), key=natural_key)
        files = [path / name for name in names]
    if not files:
        raise InputError.expected(f"frames in {path}", "at least one image", "none", "check the folder")
    found = []
    for file in files:
        # Opened for the number of pages alone; each page is read when its turn comes.
        image = open_image(file)
        image.close()
        for page in range(image.pages):
            found.append(FrameFile(file.stem if image.pages == 1 else f"{file.stem}_{page:04d}", file, page))
    _check_names([frame.name for frame in found])
    return found


def _check_names(names: list[str]) -> None:
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError.expected("names of the frames", "each once", f"{twice} twice", "rename one of them")


def cleaner(dark: Path | None, white: Path | None, view: Resampling | None) -> Cleaner:
    """Return what is done to each frame: dark, white, resampling."""
    import numpy as np

    from lfcal.frames import CorrectionChain, Dark, White
    from lfcal.frames.corrections.recipe import read_average

    level = read_average(dark) if dark else None
    steps: list[Any] = [] if level is None else [Dark(level)]
    if white:
        steps.append(White(read_average(white), 0.0 if level is None else level))
    chain = CorrectionChain(tuple(steps))

    def clean(frame: NDArray[Any]) -> NDArray[Any]:
        done = chain.apply(frame) if steps else np.asarray(frame, np.float32)
        return done if view is None else view.apply(done)

    return clean
