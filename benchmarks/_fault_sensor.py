"""Faults of sensors: functions of a recording and a strength that return all patterns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_recordings import PEAK, READ, PutIn, Recording

__all__ = [
    "bent",
    "clipped",
    "compressed",
    "dead_pixels",
    "dim",
    "dust",
    "few_saturated",
    "glow",
    "halved",
    "hot",
    "hot_pixels",
    "lifted",
    "mosaic",
    "offsets",
    "sagging",
    "saturated",
]

F4 = NDArray[np.float32]


def compressed(values: F4, quality: float) -> F4:
    """Return each frame after compression as an 8-bit JPEG."""
    import cv2

    out = np.empty_like(values)
    for k, frame in enumerate(values.reshape(-1, *values.shape[3:])):
        bytes_ = np.clip(np.rint(frame / PEAK * 230 + 10), 0, 255).astype(np.uint8)
        done, packed = cv2.imencode(".jpg", bytes_, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])
        assert done
        back = np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.float32)
        out.reshape(-1, *values.shape[3:])[k] = (back - 10) / 230 * PEAK
    return out


def halved(values: F4, by: float, axis: int) -> F4:
    """Return the recording with the cutouts of all frames after the first half displaced by ``by`` pixels."""
    from scipy.ndimage import shift

    out = values.reshape(-1, *values.shape[3:]).copy()
    half = len(out) // 2
    move = np.zeros(3)
    move[1 + axis] = by
    out[half:] = shift(out[half:], move, order=3 if by % 1 else 0, mode="nearest")
    return out.reshape(values.shape)


def line(r: Recording, base: float, value: float, axis: int, *at: float) -> F4:
    image = r.sensor(base)
    for share in at or (0.45,):
        k = int(share * image.shape[axis])
        image[(k, slice(None)) if axis == 0 else (slice(None), k)] = value
    return image


def dim(axis: int, *at: float) -> PutIn:
    return lambda r, s: r.noisy(r.scaled(r.light(), line(r, 1.0, 1.0 - s, axis, *at)))


def hot(axis: int, *at: float) -> PutIn:
    return lambda r, s: r.added(r.clean(), line(r, 0.0, s * PEAK, axis, *at))


def offsets(axis: int) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        image = r.sensor(0.0)
        each = np.asarray(np.random.default_rng(1).normal(0, s, image.shape[axis]), np.float32)
        return r.added(r.clean(), image + (each[:, None] if axis == 0 else each))

    return put_in


def pixels(r: Recording, count: int, *, together: bool = False) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = r.sensor(0.0).shape
    rng = np.random.default_rng(3)
    if together:
        y, x = np.divmod(np.arange(count), 3)
        return y + int(0.45 * rows), x + int(0.55 * columns)
    low, high = 0.3, 0.7
    return rng.integers(int(low * rows), int(high * rows), count), rng.integers(
        int(low * columns), int(high * columns), count
    )


def hot_pixels(count: int, *, together: bool = False) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        image = r.sensor(0.0)
        image[pixels(r, count, together=together)] = s * PEAK
        return r.added(r.clean(), image)

    return put_in


def dead_pixels(r: Recording, s: float) -> F4:
    image = r.sensor(1.0)
    image[pixels(r, int(s))] = 0.0
    return r.noisy(r.scaled(r.light(), image))


def dust(r: Recording, s: float) -> F4:
    rows, columns = r.sensor(0.0).shape
    y, x = np.ogrid[:rows, :columns]
    near = np.hypot(y - 0.45 * rows, x - 0.55 * columns) < 2.5
    return r.noisy(r.scaled(r.light(), np.where(near, 1.0 - s, 1.0).astype(np.float32)))


def mosaic(*four: float) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        image = r.sensor(1.0)
        for k, share in enumerate(four):
            image[k // 2 :: 2, k % 2 :: 2] = 1.0 - s * (1.0 - share)
        return r.noisy(r.scaled(r.light(), image))

    return put_in


def glow(r: Recording, s: float) -> F4:
    rows, columns = r.sensor(0.0).shape
    y, x = np.ogrid[:rows, :columns]
    return r.added(r.clean(), (s * PEAK * np.exp(-(y + x) / (0.3 * columns))).astype(np.float32))


def bent(r: Recording, s: float) -> F4:
    values = r.clean()
    return (np.sign(values) * PEAK * (np.abs(values) / PEAK) ** s).astype(np.float32)


def sagging(r: Recording, s: float) -> F4:
    light = r.light()
    return r.noisy((light * (1 - s * light / PEAK)).astype(np.float32))


def saturated(r: Recording, s: float) -> F4:
    found: F4 = np.minimum(r.clean(), np.float32(s * PEAK))
    return found


def few_saturated(r: Recording, s: float) -> F4:
    """Return the recording with the ``s`` highest values clipped to the next lower value."""
    values = r.clean()
    found: F4 = np.minimum(values, np.partition(values.ravel(), -int(s) - 1)[-int(s) - 1])
    return found


def lifted(sign: int) -> PutIn:
    return lambda r, s: r.clean() + np.float32(sign * s * PEAK)


def clipped(r: Recording, s: float) -> F4:
    """Return the recording minus ``s`` times the read noise, with negative values set to 0."""
    found: F4 = np.maximum(r.clean() - np.float32(s * READ), np.float32(0))
    return found
