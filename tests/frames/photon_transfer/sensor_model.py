"""A pixel sensor in a few lines of numpy, which shares nothing with lfcal: the oracle of the photon-transfer tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Truth:
    """Electrons in, sample values out."""

    gain: float = 0.2
    read_e: float = 8.0
    black: float = 64.0
    bits: int = 12
    prnu: float = 0.01
    dsnu_e: float = 3.0
    dark_e_s: float = 0.0
    well_e: float = 1e9
    white_balance: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    shape: tuple[int, int] = (240, 320)
    seed: int = 0
    hot: int = 0
    dead: int = 0

    @property
    def top(self) -> int:
        return (1 << self.bits) - 1

    @property
    def full_e(self) -> float:
        """Electrons at the highest sample value."""
        return min(self.well_e, (self.top - self.black) / self.gain)

    def patterns(self) -> tuple[Array, Array, Array]:
        """Return response, offset (electrons) and extra dark electrons per second of every pixel."""
        rng = np.random.default_rng([self.seed, 1])
        response = 1 + self.prnu * rng.standard_normal(self.shape)
        offset = self.dsnu_e * rng.standard_normal(self.shape)
        extra = np.zeros(self.shape)
        where = rng.choice(extra.size, self.hot + self.dead, replace=False)
        offset.flat[where[: self.hot]] += 60 * max(self.dsnu_e, self.read_e, 1 / self.gain)
        response.flat[where[self.hot :]] = 0.02
        return response, offset, extra

    def frame(self, light_e: Array | float, exposure_s: float = 0.0, key: int = 0) -> Array:
        """Return one exposure of ``light_e`` (electrons) as unsigned samples."""
        rng = np.random.default_rng([self.seed, 2, key])
        response, offset, _ = self.patterns()
        electrons = rng.poisson(np.clip(light_e * response + self.dark_e_s * exposure_s, 0, None)).astype(float)
        electrons = np.minimum(electrons, self.well_e)
        electrons += offset + self.read_e * rng.standard_normal(self.shape)
        gain = self.gain * np.tile(np.array(self.white_balance).reshape(2, 2), (self.shape[0] // 2, self.shape[1] // 2))
        samples = np.clip(np.rint(self.black + gain * electrons), 0, self.top)
        return samples.astype(np.uint8 if self.bits <= 8 else np.uint16)

    def darks(self, count: int = 4, exposure_s: float = 0.0, key: int = 10_000) -> list[Array]:
        return [self.frame(0.0, exposure_s, key + k) for k in range(count)]

    def flats(self, levels: Any, count: int = 2, scene: Array | float = 1.0, key: int = 0, **more: Any) -> list[Array]:
        """Return ``count`` frames for each share of the full well in ``levels``."""
        return [
            self.frame(share * self.full_e * scene, key=key + 100 * k + n, **more)
            for k, share in enumerate(levels)
            for n in range(count)
        ]

    def but(self, **changes: Any) -> Truth:
        return replace(self, **changes)


def micro_images(shape: tuple[int, int], pitch: float = 9.7, seed: int = 5) -> Array:
    """Return a white image of round micro-images with vignetting, brightest 1."""
    rows, columns = np.indices(shape).astype(float)
    away = np.hypot((rows + 1.3) % pitch - pitch / 2, (columns + 2.1) % pitch - pitch / 2) / (pitch / 2)
    fall = 1 - 0.4 * ((rows / shape[0] - 0.5) ** 2 + (columns / shape[1] - 0.5) ** 2)
    return (0.04 + 0.96 / (1 + np.exp((away - 0.85) * 9))) * fall


def vignetting(shape: tuple[int, int], depth: float = 0.3) -> Array:
    rows, columns = np.indices(shape).astype(float)
    return 1 - 2 * depth * ((rows / shape[0] - 0.5) ** 2 + (columns / shape[1] - 0.5) ** 2)
