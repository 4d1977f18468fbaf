"""White images behind a mosaic of colour filters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["levelled"]

BLOCKS = 4
"""Blocks along each side of the frame that must show the same mosaic of colour filters."""

UNLIKE = 0.04
"""Difference of the four pixels' brightness from which they lie behind filters (relative)."""

SAME = 0.3
"""How much the difference may scatter from block to block, as a share of itself."""


def levelled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the image with the gains of a 2 x 2 mosaic taken out, where there is one: it would beat with the pitch.

    The four subgrids of evenly lit lenslets are equally bright, unless filters of other colours lie before them.
    """
    rows, columns = (n // (2 * BLOCKS) * 2 for n in image.shape)
    whole = image[: rows * BLOCKS, : columns * BLOCKS]
    cells = whole.reshape(BLOCKS, rows // 2, 2, BLOCKS, columns // 2, 2)
    means = np.nan_to_num(cells.mean((1, 4), dtype=np.float64)).transpose(0, 2, 1, 3).reshape(-1, 2, 2)
    light = means.mean((1, 2))
    if not light.sum() > 0:
        return image
    gains = means.sum(0) / light.sum()
    unlike = float(np.abs(gains - 1).max())
    scatter = np.abs(means - gains * light[:, None, None]).max((1, 2))
    # filters are the same everywhere; what beats between lattice and pixels is not
    if unlike < UNLIKE or gains.min() <= 0 or float(scatter.mean()) > SAME * unlike * float(light.mean()):
        return image
    even_light = image.copy()
    for row, column in np.ndindex(2, 2):
        even_light[row::2, column::2] /= np.float32(gains[row, column])
    return even_light
