"""White images for the tests, drawn from a lattice whose numbers are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bend = Callable[[Array], Array]
"""From points ``(..., 2)`` (x, y) of the straight lattice, counted from the frame's centre, to displacements (px)."""


def barrel(by_px: float, reach_px: float, centre: tuple[float, float] = (0.0, 0.0)) -> Bend:
    """Displacement along the radius that grows with its cube to ``by_px`` at ``reach_px``."""

    def bend(points: Array) -> Array:
        arm = (points - np.array(centre)) / reach_px
        return by_px * (arm**2).sum(-1, keepdims=True) * arm

    return bend


def relay(by_px: float, reach_px: float, seed: int = 0) -> Bend:
    """Quadratic and cubic displacements at random, ``by_px`` rms on the circle of ``reach_px``."""
    rng = np.random.default_rng(seed)
    two, three = rng.normal(size=(2, 3)), rng.normal(size=(2, 4))

    def plain(points: Array) -> Array:
        x, y = np.moveaxis(points / reach_px, -1, 0)
        square = np.stack([x * x, x * y, y * y])
        cube = np.stack([x**3, x * x * y, x * y * y, y**3])
        return np.moveaxis(np.tensordot(two, square, 1) + np.tensordot(three, cube, 1), 0, -1)

    angle = np.linspace(0, 2 * math.pi, 90)
    ring = plain(reach_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    factor = by_px / math.sqrt(float((ring**2).sum(-1).mean()))
    return lambda points: factor * plain(points)


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
    bend: Bend | None = None

    def seen(self, index: NDArray[np.intp]) -> Array:
        """Return the true centres ``(n, 2)`` (row, column) of lenslets (q, r) as drawn."""
        return _seen(index, self.basis, np.array(self.origin[::-1]), self.bend, self.frame.shape)[:, ::-1]

    def indices(self, places: Array) -> NDArray[np.intp]:
        """Return the drawn indices (q, r) of the lenslets nearest to ``places`` ``(n, 2)`` (row, column)."""
        middle = (np.array(self.frame.shape[::-1]) - 1) / 2
        straight = points = places[:, ::-1]
        for _ in range(8):  # a displacement of a few pixels changes little over a few pixels
            straight = points - (self.bend(straight - middle) if self.bend is not None else 0.0)
        return np.rint((straight - np.array(self.origin[::-1])) @ np.linalg.inv(self.basis)).astype(np.intp)

    def errors(self, places: Array) -> Array:
        """Return ``places`` ``(n, 2)`` (row, column) less the nearest true centres (pixels)."""
        return places - self.seen(self.indices(places))

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
    bend: Bend | None = None,
    scatter: float = 0.0,
    light: Callable[[Array, Array], Array] | None = None,
    full: float = math.inf,
    share: Callable[[NDArray[np.intp], NDArray[np.intp]], Array] | None = None,
) -> WhiteFrame:
    """Draw discs of diameter ``fill`` pitches with soft edges of ``edges`` pixels, by type.

    ``offset`` is that of a lenslet from the frame's centre (row, column); with three edges its type is
    ``step * (q - r - phase) mod 3``. ``snr`` is the level over the noise. ``bend`` displaces the centres, ``scatter``
    is that of the lenslets' brightness (rms), ``light`` multiplies the frame by a function of x and y from -1 to 1,
    ``full`` is the level at which the sensor saturates, in units of ``level``, and ``share`` gives the brightness of
    lenslets (q, r).
    """
    rng = np.random.default_rng(seed)
    hexagonal = kind == "hexagonal"
    across = pitch * (math.sqrt(3) / 2 if hexagonal else 1.0) if row_pitch is None else row_pitch
    turn = np.array([[math.cos(rotation), math.sin(rotation)], [-math.sin(rotation), math.cos(rotation)]])
    basis = np.array([[pitch, 0.0], [pitch / 2 if hexagonal else 0.0, across]]) @ turn
    origin = np.array([(shape[1] - 1) / 2 + offset[1], (shape[0] - 1) / 2 + offset[0]])
    y, x = np.mgrid[: shape[0], : shape[1]]
    points = np.stack([x, y], axis=-1).astype(float)
    middle = (np.array(shape[::-1]) - 1) / 2
    straight = points - (bend(points - middle) if bend is not None else 0.0)
    base = np.floor((straight - origin) @ np.linalg.inv(basis)).astype(int)
    reach = int(base.max() - base.min()) + 8
    lit = (rng.random((reach, reach)) >= dead).astype(float)
    if scatter:
        lit *= np.maximum(rng.normal(1, scatter, lit.shape), 0)
    low = base.min() - 3
    if share is not None:
        lit *= share(*(np.indices(lit.shape) + low))
    image = np.zeros(shape)
    for i in (-1, 0, 1, 2):
        for j in (-1, 0, 1, 2):
            index = base + np.array([i, j])
            distance = np.hypot(*np.moveaxis(points - _seen(index, basis, origin, bend, shape), -1, 0))
            types = np.mod(step * (index[..., 0] - index[..., 1] - phase), 3) if len(edges) == 3 else 0
            width = np.array(edges)[types]
            disc = 1 / (1 + np.exp(np.clip((distance - fill * pitch / 2) / (0.5 * width), -50, 50)))
            image += disc * lit[index[..., 0] - low, index[..., 1] - low]
    centre = (np.array(shape) - 1) / 2
    radius = ((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / (centre**2).sum()
    image *= 1 - falloff * radius
    if light is not None:
        image *= light(x / middle[0] - 1, y / middle[1] - 1)
    image = np.minimum(level * image + rng.normal(0, level / snr, shape), level * full) + dark
    q, r = np.nonzero(lit == 0)
    gone = {(int(a), int(b)) for a, b in zip(q + low, r + low, strict=True)}
    frame = np.clip(np.rint(image), 0, 65535).astype(np.uint16)
    return WhiteFrame(frame, basis, gone, pitch, across, rotation, (float(origin[1]), float(origin[0])), bend)


def _seen(index: NDArray[np.intp], basis: Array, origin: Array, bend: Bend | None, shape: tuple[int, ...]) -> Array:
    straight = index @ basis + origin
    return straight if bend is None else straight + bend(straight - (np.array(shape[::-1]) - 1) / 2)


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
