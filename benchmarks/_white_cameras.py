"""White images of distorted arrays with known lenslet centres, drawn without code of the fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["COUNT", "WhiteCamera", "white_camera"]

SHAPE = (700, 900)
COUNT = 24
SNR = 20.0
DEAD = 0.05
LEVEL, DARK = 1000.0, 100.0
FILL = 0.95
SOFT_PX = 0.4
"""Width of a micro-image's edge (pixels)."""


@dataclass(frozen=True, eq=False)
class WhiteCamera:
    """A drawn white image and its true values.

    Attributes
    ----------
    frame
        White image ``(rows, columns)`` with dark level `DARK`.
    index, places
        ``(n, 2)``: indices (q, r) of the lenslets drawn, and their true centres (x, y) (pixels).
    kind, pitch_px, nominal_px, turn_rad
        Kind, pitch, nominal pitch (2 % wrong) and rotation of the array.
    called
        Form of the distortion with which the image was drawn.
    """

    frame: NDArray[np.uint16]
    index: NDArray[np.intp]
    places: NDArray[np.float64]
    kind: str
    pitch_px: float
    nominal_px: float
    turn_rad: float
    called: str


def white_camera(number: int) -> WhiteCamera:
    """Draw camera ``number``: square or hexagonal, rotated by up to 45 degrees, distorted by 1-3 px at the corners."""
    import numpy as np

    rng = np.random.default_rng(1000 + number)
    kind = ("hexagonal", "square")[number % 2]
    pitch, turn = float(rng.uniform(9, 26)), float(rng.uniform(-math.pi / 4, math.pi / 4))
    middle = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
    along = pitch * np.array([math.cos(turn), math.sin(turn)])
    normal = pitch * np.array([-math.sin(turn), math.cos(turn)])
    across = along / 2 + normal * math.sqrt(3) / 2 if kind == "hexagonal" else normal
    count = int(np.hypot(*SHAPE) / pitch) + 4
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1)))
    straight = q[:, None] * along + r[:, None] * across + rng.uniform(-0.5, 0.5, 2) * pitch
    places = middle + straight + _bend(straight / float(np.hypot(*middle)), number, rng)
    near = ((places > -pitch) & (places < np.array(SHAPE[::-1]) + pitch)).all(1)
    index, places = np.stack([q, r], axis=-1)[near], places[near]
    lit = rng.random(len(index)) >= DEAD
    image = LEVEL * _discs(places[lit], pitch) + DARK + rng.normal(0, LEVEL / SNR, SHAPE)
    frame = np.clip(np.rint(image), 0, 65535).astype(np.uint16)
    nominal = pitch * float(rng.choice([0.98, 1.02]))
    return WhiteCamera(frame, index, places, kind, pitch, nominal, turn, "radial" if number % 4 < 2 else "cubic")


def _bend(u: NDArray[np.float64], number: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return displacements of points ``u`` (n, 2), 1 at the corners: radial, or of the orders 2 and 3 of a relay."""
    import numpy as np

    by = rng.uniform(1, 3)
    if number % 4 < 2:
        arm = u - rng.uniform(-0.2, 0.2, 2)
        outwards: NDArray[np.float64] = by * rng.choice([-1, 1]) * (arm**2).sum(1, keepdims=True) * arm
        return outwards
    x, y = u.T
    columns = np.stack([x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=-1)
    found = columns @ rng.normal(size=(7, 2))
    ring = found[np.abs(np.hypot(x, y) - 1) < 0.1]
    relay: NDArray[np.float64] = by * found / math.sqrt(float((ring**2).sum(1).mean()))
    return relay


def _discs(places: NDArray[np.float64], pitch: float) -> NDArray[np.float64]:
    """Return an image of discs with soft edges, centred at ``places``."""
    import numpy as np

    image = np.zeros(SHAPE)
    radius = FILL * pitch / 2
    reach = math.ceil(radius + 8 * SOFT_PX)
    for x, y in places:
        left, top = max(0, round(x) - reach), max(0, round(y) - reach)
        right, bottom = min(SHAPE[1], round(x) + reach + 1), min(SHAPE[0], round(y) + reach + 1)
        if right <= left or bottom <= top:
            continue
        rows, columns = np.ogrid[top:bottom, left:right]
        distance = np.hypot(rows - y, columns - x)
        image[top:bottom, left:right] += 1 / (1 + np.exp(np.clip((distance - radius) / SOFT_PX, -40, 40)))
    return image
