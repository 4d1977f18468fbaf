"""White images for the tests, drawn from a lattice whose numbers are known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WhiteFrame:
    """A drawn frame and what it was drawn from; places are (row, column)."""

    frame: NDArray[np.uint16]
    basis: Array
    dead: set[tuple[int, int]]
    pitch: float
    row_pitch: float
    rotation: float
    origin: tuple[float, float]

    def distance_to_lattice(self, place: tuple[float, float]) -> float:
        """Distance of (row, column) from the nearest true centre (pixels)."""
        index = (np.array(place[::-1]) - np.array(self.origin[::-1])) @ np.linalg.inv(self.basis)
        return float(np.hypot(*((index - np.rint(index)) @ self.basis)))


def draw_white(
    shape: tuple[int, int] = (360, 480),
    pitch: float = 15.4,
    kind: str = "hexagonal",
    *,
    row_pitch: float | None = None,
    rotation: float = 0.003,
    offset: tuple[float, float] = (0.3, -0.2),
    fill: float = 0.95,
    edges: tuple[float, ...] = (0.8,),
    step: int = 1,
    phase: int = 0,
    snr: float = 20.0,
    dead: float = 0.05,
    falloff: float = 0.3,
    level: float = 1000.0,
    dark: float = 100.0,
    seed: int = 1,
) -> WhiteFrame:
    """Draw discs of diameter ``fill`` pitches with soft edges of ``edges`` pixels, by type.

    ``offset`` is that of a lenslet from the frame's centre (row, column); with three edges its type is
    ``step * (q - r - phase) mod 3``. ``snr`` is the level over the noise.
    """
    rng = np.random.default_rng(seed)
    hexagonal = kind == "hexagonal"
    across = pitch * (math.sqrt(3) / 2 if hexagonal else 1.0) if row_pitch is None else row_pitch
    turn = np.array([[math.cos(rotation), math.sin(rotation)], [-math.sin(rotation), math.cos(rotation)]])
    basis = np.array([[pitch, 0.0], [pitch / 2 if hexagonal else 0.0, across]]) @ turn
    origin = np.array([(shape[1] - 1) / 2 + offset[1], (shape[0] - 1) / 2 + offset[0]])
    y, x = np.mgrid[: shape[0], : shape[1]]
    points = np.stack([x, y], axis=-1) - origin
    base = np.floor(points @ np.linalg.inv(basis)).astype(int)
    reach = int(base.max() - base.min()) + 8
    lit = rng.random((reach, reach)) >= dead
    low = base.min() - 3
    image = np.zeros(shape)
    for i in (-1, 0, 1, 2):
        for j in (-1, 0, 1, 2):
            index = base + np.array([i, j])
            distance = np.hypot(*np.moveaxis(points - index @ basis, -1, 0))
            types = np.mod(step * (index[..., 0] - index[..., 1] - phase), 3) if len(edges) == 3 else 0
            width = np.array(edges)[types]
            disc = 1 / (1 + np.exp(np.clip((distance - fill * pitch / 2) / (0.5 * width), -50, 50)))
            image += disc * lit[index[..., 0] - low, index[..., 1] - low]
    centre = (np.array(shape) - 1) / 2
    radius = ((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / (centre**2).sum()
    image = level * image * (1 - falloff * radius) + dark + rng.normal(0, level / snr, shape)
    q, r = np.nonzero(~lit)
    gone = {(int(a), int(b)) for a, b in zip(q + low, r + low, strict=True)}
    frame = np.clip(np.rint(image), 0, 65535).astype(np.uint16)
    return WhiteFrame(frame, basis, gone, pitch, across, rotation, (float(origin[1]), float(origin[0])))


def draw_pupils(
    blur: tuple[float, float, float],
    *,
    pitch: float = 21.7,
    pupil: float = 1.0,
    step: int = 1,
    phase: int = 0,
    shape: tuple[int, int] = (420, 500),
    snr: float = 20.0,
) -> tuple[NDArray[np.float32], tuple[float, float], Array]:
    """Draw what geometry gives below three types: the pupil's image spread over the lenslet's defocus disc.

    ``pupil`` is its image's diameter and ``blur`` that of the discs by type, both in pitches; the micro-images
    overlap where their sum exceeds one. Returns frame, origin (row, column) and basis.
    """
    import cv2

    basis = pitch * np.array([[1.0, 0.0], [0.5, math.sqrt(3) / 2]])
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-40, 41), np.arange(-30, 31)))
    origin = np.array([shape[1] / 2 + 0.3, shape[0] / 2 - 0.4])
    places = np.stack([q, r], axis=-1) @ basis + origin
    near = ((places > -2 * pitch) & (places < np.array(shape[::-1]) + 2 * pitch)).all(1)
    types = np.mod(step * (q - r - phase), 3)
    total = np.zeros(shape, np.float32)
    for kind in range(3):
        layer = np.zeros(shape, np.float32)
        for x, y in places[near & (types == kind)]:
            cv2.circle(layer, (round(x * 16), round(y * 16)), round(8 * pupil * pitch), 1.0, -1, cv2.LINE_AA, 4)
        side = 2 * math.ceil(pitch) + 1
        disc = np.zeros((side, side), np.float32)
        cv2.circle(disc, (side // 2 * 16, side // 2 * 16), round(8 * blur[kind] * pitch), 1.0, -1, cv2.LINE_AA, 4)
        total += cv2.filter2D(layer, -1, disc / disc.sum())
    noise = np.random.default_rng(step + 2 * phase).normal(0, 1000 / snr, shape)
    return (1000 * total + noise).astype(np.float32), (float(origin[1]), float(origin[0])), basis
