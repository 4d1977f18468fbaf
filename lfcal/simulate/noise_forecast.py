"""Forecast the noise that a scan leaves in H before anything is recorded, and the cost of less noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lfcal.base import Clock, Work, check_number
from lfcal.camera import MAX_WAIT_S, Forecast, ScanPlan, Sensor
from lfcal.simulate.accuracy import few_seconds
from lfcal.simulate.effects import IrisShape, LensletDiffraction, LensTypeDefocus
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import outlook_of

__all__ = ["PLANNED_PEAK", "ExpectedLight", "ScanChoice", "iter_expected_light", "scan_choices"]

PLANNED_PEAK = 0.8
"""Fraction of the full well that the brightest pixel of a session is planned to reach."""

OPTICS = (LensTypeDefocus(), LensletDiffraction(), IrisShape())

TOLERANCE = 0.1
"""Tolerance of the simulated patterns, whose noise does not need a better one."""

POSITIONS = (5, 3, 2)
"""Numbers of positions simulated along each axis of the period; the largest that is fast enough is used."""

LONGEST_S = 6.0
"""CPU-seconds above which fewer positions are simulated."""

BINS = 160
"""Number of brightness levels distinguished in a plane, evenly spaced on a logarithmic scale."""

DIMMEST = 1e-7
"""Light of a pixel relative to the brightest one, below which it counts as dark."""

PEAKS = (0.05, 0.1, 0.2, 0.4, 0.8)
AVERAGES = (1, 2, 4, 8, 16, 32, 64)
SAME = 0.01
"""Relative difference in time and noise below which two choices count as the same."""


@dataclass(frozen=True, eq=False)
class ExpectedLight:
    """Distribution of pixel brightness in the patterns of a scan, in the units of H: a histogram for each plane.

    Attributes
    ----------
    levels
        Mean light per pixel at each brightness level, ``(planes, levels)``, in the units of H: fractions of the light
        through the iris.
    pixels
        Mean number of pixels of a pattern at each level, ``(planes, levels)``.
    brightest
        Light of the brightest pixel of each plane, ``(planes,)``, in the units of H.

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import ExpectedLight, iter_expected_light
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=55)
    >>> light: ExpectedLight = drain(iter_expected_light(plan))
    >>> print(" and ".join(f"{100 * share:.1f} %" for share in light.noise(plan)))
    2.1 % and 2.8 %
    """

    levels: NDArray[np.float64]
    pixels: NDArray[np.float64]
    brightest: NDArray[np.float64]

    def noise(self, plan: ScanPlan, peak: float = PLANNED_PEAK) -> tuple[float, ...]:
        """Return the expected relative rms error of H due to sensor noise, one value for each plane.

        The error is relative to the root mean square of the plane's values of H. It includes photon noise, dark
        current, read noise and rounding. The frames are clipped at zero counts, and a mean dark frame is subtracted
        from them. Errors that do not average out, such as pixel response or a wrong position, are not included.

        Parameters
        ----------
        plan
            The scan plan; its exposures and number of averaged frames may differ from those of the simulated plan.
        peak
            Fraction of the full well that the brightest pixel of the scan reaches at the exposures of ``plan``.
        """
        check_number("brightest pixel (fraction of the full well)", peak, above=0, at_most=1)
        sensor, seconds = plan.camera.sensor, np.array(plan.exposures)
        rate = peak * sensor.full_well_e / float((self.brightest * seconds).max())
        found = []
        for levels, pixels, exposure in zip(self.levels, self.pixels, seconds.tolist(), strict=True):
            light = levels * rate * exposure
            off = _squared_error(light, sensor, exposure, plan.frames_averaged)
            found.append(math.sqrt(float((pixels * off).sum() / (pixels * light**2).sum())))
        return tuple(found)


def _squared_error(light_e: NDArray[np.float64], sensor: Sensor, exposure_s: float, frames: int) -> NDArray[np.float64]:
    """Return the mean squared error (electrons) of the mean of frames, less the mean of many dark frames."""
    gain, dark = sensor.electrons_per_count, sensor.dark_current_e_s * exposure_s
    constant = sensor.read_noise_e**2 + gain**2 / 12 + dark
    without = sensor.black_level * gain + dark
    level, _ = _cut_off(np.array([without]), np.array([constant]))
    mean, variance = _cut_off(without + light_e, constant + light_e)
    found: NDArray[np.float64] = (mean - level - light_e) ** 2 + variance / frames
    return found


def _cut_off(
    mean: NDArray[np.float64], variance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and variance of normal deviates that are zero where they are negative."""
    spread = np.sqrt(np.maximum(variance, 1e-12))
    above, density = ndtr(mean / spread), np.exp(-((mean / spread) ** 2) / 2) / math.sqrt(2 * math.pi)
    first = mean * above + spread * density
    second = (mean**2 + spread**2) * above + mean * spread * density
    return first, np.maximum(second - first**2, 0.0)


def iter_expected_light(plan: ScanPlan, workers: int | None = None) -> Work[ExpectedLight]:
    """Simulate some patterns of every plane, with lens types, iris and diffraction, and return their brightness levels.

    At most 5 x 5 patterns of each plane are simulated, or 3 x 3 or 2 x 2 if more would take too long. ``workers`` is as
    in `simulate_psf`.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import iter_expected_light
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=55)
    >>> [step.count for step in iter_expected_light(plan)]
    ['0 of 2', '1 of 2', '2 of 2']
    """
    planes = len(plan.depths_um)
    clock, found = Clock("expected light", planes), []
    optics = tuple(effect for effect in OPTICS if effect.applies_to(plan.camera))
    responses = [PlaneResponse(plan, z, optics, tolerance=TOLERANCE) for z in range(planes)]
    for side in POSITIONS:
        seconds = (few_seconds(outlook_of(plan, z), one.level, TOLERANCE, side**2) for z, one in enumerate(responses))
        if sum(seconds) <= LONGEST_S:
            break
    ys, xs = (np.unique(np.linspace(0, n - 1, side).round().astype(np.intp)) for n in plan.period)
    for z, response in enumerate(responses):
        yield clock.at(z)
        found.append(_levels(response.rows(ys, xs, workers), ys.size * xs.size))
    yield clock.at(planes)
    levels, pixels, brightest = (np.array(part) for part in zip(*found, strict=True))
    return ExpectedLight(levels, pixels, brightest)


def _levels(values: NDArray[np.float32], patterns: int) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return mean light and number of the pixels of each level, and the light of the brightest pixel."""
    light = np.maximum(values.ravel().astype(np.float64), 0.0)
    top = float(light.max()) or 1.0
    share = np.log(np.maximum(light / top, DIMMEST)) / math.log(DIMMEST)
    level = np.minimum((share * BINS).astype(np.intp), BINS - 1)
    count, total = np.bincount(level, minlength=BINS), np.bincount(level, light, BINS)
    return total / np.maximum(count, 1), count / patterns, top


# -- time against accuracy -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class ScanChoice:
    """One choice of exposure and averaging for a scan, with the resulting time and noise.

    Attributes
    ----------
    plan
        The scan plan with the chosen exposures and number of averaged frames.
    peak
        Fraction of the full well that the brightest pixel of the scan reaches.
    seconds
        Recording time (s).
    noise
        Expected relative rms error of H due to sensor noise, averaged over all planes (root mean square).

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.camera import Forecast, ScanPlan, preset
    >>> from lfcal.simulate import ScanChoice, iter_expected_light, scan_choices
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=55)
    >>> choices = scan_choices(plan, drain(iter_expected_light(plan)), 0.8, Forecast.of(plan))
    >>> one: ScanChoice = choices[-3]
    >>> print(f"{one.plan.frames_averaged} frames: {one.seconds:.0f} s, {100 * one.noise:.1f} %")
    16 frames: 502 s, 0.6 %
    """

    plan: ScanPlan
    peak: float
    seconds: float
    noise: float


def scan_choices(plan: ScanPlan, light: ExpectedLight, peak: float, forecast: Forecast) -> tuple[ScanChoice, ...]:
    """Return combinations of exposure and averaging for a plan, fastest first, including that of the plan itself.

    The brightness of the source is the same for all. Shorter exposures are faster, but the brightest pixel then reaches
    a smaller fraction of the full well. The longest exposure is that at which the brightest pixel reaches 0.8 of the
    full well (`PLANNED_PEAK`), or ``peak`` if this is higher. It is at most a day. At the longest exposure, there are
    also combinations that average up to 64 frames. Combinations with the same time and noise as the plan itself are
    omitted.

    Parameters
    ----------
    plan, light
        The scan plan, and the brightness levels of its patterns.
    peak
        Fraction of the full well that the brightest pixel reaches at the plan's exposures.
    forecast
        Forecast of the recording time of ``plan``, from the speed of the stage and the frame rate.

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.camera import Forecast, ScanPlan, preset
    >>> from lfcal.simulate import iter_expected_light, scan_choices
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=55)
    >>> light = drain(iter_expected_light(plan))
    >>> ways = scan_choices(plan, light, 0.8, Forecast.of(plan))
    >>> ways[0].seconds < ways[-1].seconds, ways[0].noise > ways[-1].noise
    (True, True)
    """
    highest = max(peak, PLANNED_PEAK)
    ways = [(one, 1) for one in PEAKS if one < highest] + [(highest, count) for count in AVERAGES]
    own = _choice(plan, light, peak, forecast, (peak, plan.frames_averaged))
    # from a peak that is almost dark, the longest exposures would not be possible
    longest = MAX_WAIT_S / max(plan.exposures)
    found = [_choice(plan, light, peak, forecast, way) for way in ways if way[0] / peak <= longest]
    others = [one for one in found if not (_same(one.seconds, own.seconds) and _same(one.noise, own.noise))]
    return tuple(sorted((*others, own), key=lambda one: (one.seconds, -one.noise)))


def _same(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=SAME)


def _choice(plan: ScanPlan, light: ExpectedLight, peak: float, cost: Forecast, way: tuple[float, int]) -> ScanChoice:
    wanted, frames = way
    times, more = wanted / peak, frames / plan.frames_averaged
    made = plan
    if way != (peak, plan.frames_averaged):
        exposures = tuple(float(f"{times * seconds:.4g}") for seconds in plan.exposures)
        made = replace(plan, exposure_s=exposures, frames_averaged=frames)
    hours = cost.settle_hours + cost.move_hours + more * (cost.exposure_hours * times + (cost.readout_hours or 0.0))
    noise = math.sqrt(float(np.mean(np.square(light.noise(made, wanted)))))
    return ScanChoice(made, wanted, 3600 * hours, noise)
