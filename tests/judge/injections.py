"""Each fault as it is put into the clean recording of the bench camera, for its tests and for the atlas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks._fault_optics import blurred_type, equalised, shadow
from benchmarks._fault_scan import mirrored
from tests.judge.common import (
    PEAK,
    Values,
    added,
    clean,
    compared,
    compressed,
    displaced,
    light,
    mixed_focus,
    noisy,
    plan,
    recording,
    scaled,
    sensor,
)

__all__ = ["INJECTIONS", "Injection"]


@dataclass(frozen=True)
class Injection:
    """A fault as it is put in.

    Attributes
    ----------
    what
        What is done to the recording.
    how
        What identifies the fault.
    made
        The recording with it.
    """

    what: str
    how: str
    made: Callable[[], Values]


def _line(value: float, column: int) -> Values:
    image = sensor(1.0 if value <= 1 else 0.0)
    image[:, column] = value
    return image


def _offsets() -> Values:
    spread = np.random.default_rng(1).normal(0, 6, (len(sensor(0)), 1))
    return added(clean(), sensor(0.0) + spread.astype(np.float32))


def _pixel() -> Values:
    image = sensor(0.0)
    image[20, 33] = 0.3 * PEAK
    return added(clean(), image)


def _mosaic() -> Values:
    image = sensor(1.0)
    image[::2, ::2], image[1::2, 1::2] = 0.6, 0.5
    return noisy(scaled(light(), image))


def _bent() -> Values:
    values = noisy(light())
    return (np.sign(values) * PEAK * (np.abs(values) / PEAK) ** 1.1).astype(np.float32)


def _swapped() -> Values:
    values = clean()
    values[:, :, [3, 4]] = values[:, :, [4, 3]]
    return values


def _region() -> Values:
    values = clean()
    values[1] = np.roll(values[1], 1, axis=3)
    return values


def _stage() -> Values:
    y, x = recording().grid()
    turn = np.radians(1.0)
    return displaced(0.02 * y + turn * x, 0.02 * x - turn * y)


def _play() -> Values:
    back = np.arange(plan().period[0])[:, None] % 2 == 1
    aside = np.where(back, 0.15, -0.15) + np.zeros(plan().period)
    return displaced(0 * aside, aside)


def _jitter() -> Values:
    return displaced(*np.random.default_rng(5).normal(0, 0.1, (2, *plan().period)))


def _exposure() -> Values:
    values = light()
    values[tuple(compared()[17])] *= 3
    return noisy(values)


def _course() -> Values:
    ny, nx = plan().period
    come = (np.arange(ny * nx) / (ny * nx)).reshape(ny, nx).astype(np.float32)
    return noisy(light() * (1 - 0.08 * come)[None, :, :, None, None])


def _flicker() -> Values:
    lamp = 1 + 0.05 * np.random.default_rng(2).standard_normal(light().shape[:3])
    return noisy((light() * lamp[..., None, None]).astype(np.float32))


def _ghost() -> Values:
    return noisy(light() + np.float32(0.02) * np.roll(light()[..., ::-1, :], (7, -5), (3, 4)))


def _type() -> Values:
    camera, values = plan().camera, light()
    _, ny, nx, nt, ns = values.shape
    rows, columns = (plan().anchor[k] - (n - 1) / 2 + np.arange(m) for k, n, m in ((0, nt, ny + nt), (1, ns, nx + ns)))
    points = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), -1))
    return noisy(scaled(values, np.where(camera.lattice.type_at(points) == 1, 0.8, 1.0).astype(np.float32)))


INJECTIONS: dict[str, Injection] = {
    "saturated": Injection(
        "the sensor saturates at half the peak signal",
        "no sample exceeds a common highest value, although the model of the camera predicts more light",
        lambda: np.minimum(clean(), np.float32(0.5 * PEAK)),
    ),
    "cut_off": Injection(
        "negative values, about half of the dark samples, are set to zero",
        "many dark samples are exactly zero and none is negative, so their mean is above zero",
        lambda: np.maximum(clean(), np.float32(0)),
    ),
    "background": Injection(
        "2 % of the peak is added to every sample",
        "samples at which the camera predicts no light are not zero",
        lambda: added(clean(), sensor(0.02 * PEAK)),
    ),
    "order": Injection(
        "the columns of both planes are stored in reverse order",
        "all patterns fit the camera at other positions, in a reversed or shifted order",
        lambda: mirrored(1)(recording(), 2),
    ),
    "pupil": Injection(
        "on one side, a blade covers the iris beyond 0.7 of the iris radius",
        "light is missing on the same side of every pattern",
        lambda: shadow(straight=True)(recording(), 0.3),
    ),
    "type_focus": Injection(
        "the focal length of one lens type is 15 % too long",
        "residuals behind the lenslets of one type have the form of defocus",
        lambda: blurred_type(recording(), 0.15),
    ),
    "compression": Injection(
        "every frame is stored as an 8-bit JPEG of quality 75",
        "neighbours in different blocks of 8 x 8 pixels differ more than within a block, or blocks lack fine structure",
        lambda: compressed(clean(), 75),
    ),
    "dead_line": Injection(
        "column 30 of the scanned region receives no light",
        "a row or column has less light than its neighbours",
        lambda: noisy(scaled(light(), _line(0.0, 30))),
    ),
    "hot_line": Injection(
        "column 25 of the scanned region adds 60 counts",
        "a row or column has more counts than its neighbours",
        lambda: added(clean(), _line(60.0, 25)),
    ),
    "line_offsets": Injection(
        "the rows have random offsets of 6 counts rms",
        "the mean residuals of rows or columns scatter more than the noise explains",
        _offsets,
    ),
    "not_linear": Injection(
        "values are proportional to the light to the power of 1.1",
        "the fitted exponent differs from 1, or the brightest samples have too little light",
        _bent,
    ),
    "mosaic": Injection(
        "the four pixels of each 2 x 2 block receive 60, 100, 100 and 50 % of the light",
        "the four pixels of each 2 x 2 block receive different amounts of light",
        _mosaic,
    ),
    "bad_pixels": Injection(
        "one pixel adds 30 % of the peak",
        "single pixels lack light or add counts in every pattern",
        _pixel,
    ),
    "strangers": Injection(
        "two neighbouring columns of the scan are swapped",
        "a source is far from its planned position, or a pattern fits a neighbouring position better",
        _swapped,
    ),
    "frame_shift": Injection(
        "the frames of the second plane are displaced by one pixel along the rows",
        "the displacement of the cutouts changes abruptly at one frame",
        _region,
    ),
    "stage_axes": Injection(
        "the steps of the stage are 2 % too long, and its axes are rotated by 1 degree",
        "the displacement of the sources grows with row and column",
        _stage,
    ),
    "backlash": Injection(
        "rows are scanned in alternating directions with a backlash of 0.3 pixels",
        "sources in rows that are scanned backwards are displaced relative to the sources in the other rows",
        _play,
    ),
    "jitter": Injection(
        "the source is displaced at random by 0.1 pixels rms",
        "the displacements of the sources scatter more than their errors explain",
        _jitter,
    ),
    "auto_exposure": Injection(
        "the exposure of each frame depends on its peak: the light is proportional to the peak to the power of -0.6",
        "the light of the patterns is proportional to a power of their peaks",
        lambda: noisy((light() * equalised(recording(), 0.6)).astype(np.float32)),
    ),
    "exposure": Injection(
        "one frame has three times as much light as planned",
        "the light of one pattern differs from that of all others",
        _exposure,
    ),
    "lamp": Injection(
        "the lamp fades by 8 % over the scan of each plane",
        "the light of the patterns changes over the scan",
        _course,
    ),
    "flicker": Injection(
        "the light differs by 5 % rms from frame to frame",
        "the light differs from pattern to pattern by more than its standard errors explain",
        _flicker,
    ),
    "depth_label": Injection(
        "the depths of two planes are exchanged",
        "the patterns of a plane fit the camera at another depth",
        lambda: clean()[::-1].copy(),
    ),
    "focus_drift": Injection(
        "the virtual depth of the first plane changes by 3 % during its scan",
        "the fitted depth of patterns changes over the scan of a plane",
        lambda: mixed_focus(0.03),
    ),
    "ghost": Injection(
        "2 % of the light forms a second pattern, mirrored top to bottom, 7 pixels lower and 5 pixels to the left",
        "the residual resembles the pattern, displaced, rotated or mirrored",
        _ghost,
    ),
    "type_light": Injection(
        "lenslets of type 1 transmit 80 % of the light",
        "the lenslets of one type transmit less light than the others",
        _type,
    ),
}
"""How each fault is put in, by its name."""
