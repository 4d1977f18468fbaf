"""Light fields that the Reconstruct page opens, and those it makes of a phantom. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.psf import PSFMatrix

__all__ = ["Synthetic", "light_field", "make_light_field", "synthetic_shape"]

LARGEST = 640
COUNTS = 2000.0


def light_field(path: str) -> NDArray[Any]:
    """Return the light field in an image file, ``(rows, columns)``."""
    from lfcal.frames import read_image

    return read_image(Path(path))


@dataclass(frozen=True, eq=False)
class Synthetic:
    """A light field that was made: its file, and the volume it shows."""

    path: str
    truth: NDArray[np.float32]


def synthetic_shape(H: PSFMatrix) -> tuple[int, int]:
    """Return a size for a made light field: several periods and two cutouts, no more than is quick to solve."""
    rows, columns = (int(min(LARGEST, max(4 * n, 2 * c))) for n, c in zip(H.shape[1:3], H.shape[3:], strict=True))
    return rows, columns


def make_light_field(
    H: PSFMatrix, name: str, path: str, *, shape: tuple[int, int] | None = None, counts: float = COUNTS, seed: int = 0
) -> Synthetic:
    """Project the phantom ``name`` through ``H``, add photon noise, and write it as a 16-bit TIFF.

    Parameters
    ----------
    H
        The matrix to project with.
    name
        One of `lfcal.reconstruct.phantoms.PHANTOMS`.
    path
        Image file to write (.tif).
    shape
        Rows and columns; by default `synthetic_shape`.
    counts
        Brightest pixel; each count is taken as one photon.
    seed
        Of phantom and noise.
    """
    from lfcal.base import write_tiff
    from lfcal.reconstruct import Projector, phantom

    if not path.lower().endswith((".tif", ".tiff")):
        raise InputError.expected("light field", "a .tif file", Path(path).name, "use that suffix")
    P = Projector(H, shape or synthetic_shape(H))
    volume = phantom(name, P.volume_shape, seed)
    image = P.forward(volume)
    top = float(image.max())
    if not top > 0:
        raise InputError.expected("light field", "light", "none", "H is empty: assemble it again")
    scale = counts / top
    noisy = np.random.default_rng(seed).poisson(np.maximum(image * scale, 0))
    write_tiff(path, np.minimum(noisy, 65535).astype(np.uint16))
    return Synthetic(path, (volume * scale).astype(np.float32))
