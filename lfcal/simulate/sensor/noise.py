"""Convert light on the sensor to a frame by applying the frame effects in order, reproducibly.

A frame is processed in strips of rows. Every effect on every strip of every frame has separate random numbers. They are
derived from the seed, the kind of frame, its index, the strip and the effect. Frames may therefore be made in any order
and in any thread, and adding or removing an effect does not change the numbers of the others.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, format_pixels
from lfcal.camera import Camera
from lfcal.frames import Noise
from lfcal.simulate.effects import Effect, FrameEffect, ReadNoise, SensorStrip, ShotNoise

__all__ = ["FrameKind", "expose", "random_numbers", "sample_type", "temporal_noise"]

STRIP = 128
"""Number of rows processed together."""

COUNTS_FROM = 80
"""Effects of this rank and above act on sample values, those below on electrons."""

PATTERNS = ("gain", "offset")


class FrameKind(IntEnum):
    """Use of random numbers, as part of their key: a kind of frame, the fixed pattern, or the motion of the source."""

    LIGHT = 0
    DARK = 1
    WHITE = 2
    PATTERN = 3
    MOTION = 4


def random_numbers(seed: int, kind: FrameKind, *key: int) -> np.random.Generator:
    """Return the random number generator determined by ``seed``, ``kind`` and ``key``."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(int(kind), *key))))


def stream_of(effect: FrameEffect) -> int:
    """Return the number that identifies an effect in the keys of its random numbers."""
    return zlib.crc32(effect.name.encode()) if effect.stream is None else effect.stream


def sample_type(effects: Sequence[Effect]) -> np.dtype[np.uint16] | np.dtype[np.float32]:
    """Return the type of sample values: uint16 if one of the ``effects`` rounds them, else float32."""
    rounded = any(isinstance(effect, FrameEffect) and effect.whole_numbers for effect in effects)
    return np.dtype(np.uint16) if rounded else np.dtype(np.float32)


def temporal_noise(effects: Sequence[Effect], camera: Camera) -> Noise:
    """Return the noise model of raw samples of ``camera``, without fixed patterns.

    It includes photon noise, read noise and rounding if they are among the ``effects``.
    """
    gain = camera.sensor.electrons_per_count
    read = [effect.rms(camera) for effect in effects if isinstance(effect, ReadNoise)]
    rounded = any(isinstance(effect, FrameEffect) and effect.whole_numbers for effect in effects)
    photons = any(isinstance(effect, ShotNoise) for effect in effects)
    constant = sum((rms / gain) ** 2 for rms in read) + (1 / 12 if rounded else 0.0)
    return Noise(constant, 1 / gain if photons else 0.0, camera.sensor.black_level)


def expose(
    light_e: NDArray[np.float32],
    camera: Camera,
    effects: Sequence[FrameEffect],
    *,
    exposure_s: float,
    seed: int = 0,
    kind: FrameKind = FrameKind.LIGHT,
    index: int = 0,
) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Return the frame that the sensor of ``camera`` records for the light ``light_e``.

    Parameters
    ----------
    light_e
        Photoelectrons at every pixel of the sensor before any effect, ``(rows, columns)``.
    camera
        Camera whose sensor records the light.
    effects
        Frame effects, which are applied in the order of their ranks. Empty: counts without noise or rounding.
    exposure_s
        Exposure time (s).
    seed, kind, index
        Seed, kind of frame and index of the frame, which together determine the random numbers. The fixed pattern
        depends only on the seed.

    Returns
    -------
    NDArray
        Counts ``(rows, columns)`` including the black level: uint16 with `Quantisation`, otherwise float32.

    Raises
    ------
    InputError
        If ``light_e`` does not have the sensor's shape.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate import expose
    >>> from lfcal.simulate.effects import Quantisation
    >>> camera = preset("bench")
    >>> light = np.full(camera.sensor.shape, 5e3, np.float32)  # a quarter of the full well
    >>> frame = expose(light, camera, [Quantisation()], exposure_s=0.02)
    >>> frame.dtype.name, int(frame[0, 0])  # 64 + (4095 - 64)/4
    ('uint16', 1072)
    """
    if light_e.shape != camera.sensor.shape:
        raise InputError.expected(
            "light on the sensor",
            format_pixels(camera.sensor.shape),
            format_pixels(light_e.shape),
            "give the light of every pixel of the sensor",
        )
    ordered = sorted(effects, key=lambda effect: effect.rank)
    total = float(light_e.sum(dtype=np.float64))
    out = np.empty(light_e.shape, sample_type(effects))
    for number, row in enumerate(range(0, len(light_e), STRIP)):
        strip = light_e[row : row + STRIP].astype(np.float32)
        pattern = _patterns(seed, number, strip.shape)
        views = [
            SensorStrip(camera, exposure_s, row, total, rng, pattern, light_e)
            for rng in (random_numbers(seed, kind, index, number, stream_of(effect)) for effect in ordered)
        ]
        out[row : row + STRIP] = _strip(strip, ordered, views, camera)
    return out


def _strip(
    strip: NDArray[np.float32], ordered: Sequence[FrameEffect], views: Sequence[SensorStrip], camera: Camera
) -> NDArray[np.float32]:
    for effect, view in zip(ordered, views, strict=True):
        if effect.rank < COUNTS_FROM:
            strip = effect.on_frame(strip, view)
    # the converter is here: electrons before, counts after it
    strip /= np.float32(camera.sensor.electrons_per_count)
    strip += np.float32(camera.sensor.black_level)
    for effect, view in zip(ordered, views, strict=True):
        if effect.rank >= COUNTS_FROM:
            strip = effect.on_frame(strip, view)
    return strip


def _patterns(seed: int, strip: int, shape: tuple[int, ...]) -> Callable[[str], NDArray[np.float32]]:
    def pattern(name: str) -> NDArray[np.float32]:
        # the same numbers as in earlier sessions; patterns of other packages are identified by their names
        key = PATTERNS.index(name) if name in PATTERNS else zlib.crc32(name.encode())
        rng = random_numbers(seed, FrameKind.PATTERN, key, strip)
        return rng.standard_normal(shape, np.float32)

    return pattern
