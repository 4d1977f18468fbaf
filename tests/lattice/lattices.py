"""Lattices of known numbers for the tests of views: straight ones, and bent ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Straight:
    """A square or hexagonal lattice turned by ``degrees``; ``origin`` is the centre (row, column) of lenslet (0, 0)."""

    kind: str
    degrees: float
    origin: tuple[float, float]
    pitch_px: float = 12.37
    shape: tuple[int, int] = (0, 0)

    @property
    def row_pitch_px(self) -> float:
        return self.pitch_px * (math.sqrt(3) / 2 if self.kind == "hexagonal" else 1.0)

    @property
    def rotation_rad(self) -> float:
        return math.radians(self.degrees)

    def basis_px(self) -> Array:
        along = np.array([math.cos(self.rotation_rad), math.sin(self.rotation_rad)])
        across = np.array([-along[1], along[0]])
        if self.kind == "square":
            return self.pitch_px * np.array([along, across])
        return self.pitch_px * np.array([along, along / 2 + math.sqrt(3) / 2 * across])

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        index = np.stack(np.broadcast_arrays(np.asarray(q, float), np.asarray(r, float)), -1)
        return (index @ self.basis_px())[..., ::-1] + np.array(self.origin)

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        point = np.stack(np.broadcast_arrays(np.asarray(column, float), np.asarray(row, float)), -1)
        return (point - np.array(self.origin)[::-1]) @ np.linalg.inv(self.basis_px())


@dataclass(frozen=True)
class Bent:
    """A straight lattice moved away from the frame's middle by ``corner_px`` (rho / rho of the corner)^3."""

    straight: Straight
    corner_px: float
    shape: tuple[int, int]

    @property
    def kind(self) -> str:
        return self.straight.kind

    @property
    def pitch_px(self) -> float:
        return self.straight.pitch_px

    @property
    def row_pitch_px(self) -> float:
        return self.straight.row_pitch_px

    @property
    def rotation_rad(self) -> float:
        return self.straight.rotation_rad

    def basis_px(self) -> Array:
        return self.straight.basis_px()

    def moved(self, points: Array) -> Array:
        middle = (np.array(self.shape) - 1) / 2
        away = (points - middle) / np.hypot(*middle)
        return points + self.corner_px * away * (away**2).sum(-1, keepdims=True)

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        return self.moved(self.straight.centres_px(q, r))

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        wanted = np.stack(np.broadcast_arrays(np.asarray(row, float), np.asarray(column, float)), -1)
        point = wanted
        for _ in range(60):
            point = point + wanted - self.moved(point)
        return self.straight.lenslet_at(point[..., 0], point[..., 1])
