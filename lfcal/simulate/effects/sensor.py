"""Effects of the sensor on the light that falls on it.

They act in the order of their ``rank``, which is that of light and readout. The order is stray light, colour filter,
pixel response, dark current, shot noise, full well, read noise; then electrons become sample values, which are rounded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.frames import check_cfa, pattern_side
from lfcal.simulate.effects._poisson import poisson_quantile
from lfcal.simulate.effects.base import Estimate, FrameEffect, SensorStrip
from lfcal.simulate.effects.outlook import Outlook

__all__ = [
    "ColourFilter",
    "DarkCurrent",
    "FixedPattern",
    "Quantisation",
    "ReadNoise",
    "Saturation",
    "ShotNoise",
    "StrayLight",
]

MEAN = math.sqrt(2.0 / math.pi)
"""Mean absolute value of a standard normal deviate."""

BANDS_UM = {
    "B": ((0.0, 0.50),),
    "G": ((0.49, 0.585),),
    "R": ((0.575, 9.0),),
    "W": ((0.0, 9.0),),
    "C": ((0.0, 0.585),),
    "M": ((0.0, 0.50), (0.575, 9.0)),
    "Y": ((0.49, 9.0),),
    "E": ((0.47, 0.56),),
}
"""Pass band of each filter letter (µm)."""


@dataclass(frozen=True, slots=True)
class StrayLight(FrameEffect):
    """Stray light: a fraction of the frame's light is scattered uniformly over the sensor.

    Attributes
    ----------
    share
        Scattered fraction of the light, 0 to 1.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, StrayLight
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95))
    >>> print(f"{StrayLight(0.01).estimate(plane).error:.2%} of the image")  # lost where it was, gained elsewhere
    1.00% of the image
    """

    share: float = 0.01

    name: ClassVar[str] = "stray_light"
    units: ClassVar[Mapping[str, str]] = {"share": "share"}
    titles: ClassVar[Mapping[str, str]] = {"share": "scattered share"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"share": (0.0, 1.0)}
    title: ClassVar[str] = "stray light"
    without_lattice: ClassVar[bool] = True
    deviation: ClassVar[bool] = True
    rank: ClassVar[int] = 20

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the scattered fraction, and the relative error due to light lost by spots and added elsewhere."""
        rows, columns = outlook.camera.sensor.shape
        # the light is lost in the cutout and returns spread over the whole sensor
        veil = min(1.0, outlook.pixels / (rows * columns))
        return Estimate(self.share, "relative", self.share * (1.0 + veil), "share (1 + cutout/sensor)")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Apply the stray light to ``strip`` (electrons) in place, and return it.

        Each pixel loses the fraction ``share`` of its light, and receives the same fraction of the frame's mean.
        """
        rows, columns = view.camera.sensor.shape
        strip *= np.float32(1.0 - self.share)
        strip += np.float32(self.share * view.total_e / (rows * columns))
        return strip


@dataclass(frozen=True, slots=True)
class ColourFilter(FrameEffect):
    """Transmission of the sensor's colour filter array at the design wavelength.

    Attributes
    ----------
    cfa
        Letters of the filter colours in one unit of the pattern in row-major order, for example ``"GRBG"``. None: the
        camera's pattern.
    leak
        Transmission of a filter outside its pass band, 0 to 1.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ColourFilter
    >>> ColourFilter("GRBG", leak=0.25).transmission(preset("r29")).tolist()  # at 0.55 µm
    [[1.0, 0.25], [0.25, 1.0]]
    """

    cfa: str | None = None
    leak: float = 0.03

    name: ClassVar[str] = "colour_filter"
    units: ClassVar[Mapping[str, str]] = {"leak": "share"}
    titles: ClassVar[Mapping[str, str]] = {"cfa": "letters by rows", "leak": "passed outside its band"}
    described: ClassVar[Mapping[str, str]] = {"cfa": "sensor.cfa"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"leak": (0.0, 1.0)}
    title: ClassVar[str] = "colour filter array (Bayer)"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 30

    def __post_init__(self) -> None:
        """Check the leak, and that every letter is that of a filter."""
        FrameEffect.__post_init__(self)  # a plain super() does not know a class with slots
        if self.cfa is not None:
            check_cfa(self.cfa)

    def transmission(self, camera: Camera) -> NDArray[np.float32]:
        """Return the transmission of one unit of the pattern, ``(side, side)``; ``(1, 1)`` for a monochrome sensor."""
        cfa: str = self.magnitude("cfa", camera)
        side, wave = pattern_side(cfa), camera.wavelength_um
        passed = [1.0 if any(a <= wave < b for a, b in BANDS_UM[letter]) else self.leak for letter in cfa or "W"]
        return np.array(passed, np.float32).reshape(side, side)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the mean transmission, and the ratio of the lost light to the transmitted light."""
        kept = float(self.transmission(outlook.camera).mean())
        return Estimate(kept, "kept", (1.0 - kept) / kept, "(1 - kept)/kept")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Multiply ``strip`` in place by the transmission of the pattern, and return it.

        The pattern begins at pixel (0, 0) of the sensor.
        """
        passed = self.transmission(view.camera)
        side = len(passed)
        for r in range(side):
            for c in range(side):
                # a strip may begin in the middle of the pattern
                strip[(r - view.row) % side :: side, c::side] *= passed[r, c]
        return strip


@dataclass(frozen=True, slots=True)
class FixedPattern(FrameEffect):
    """Fixed-pattern noise: photo-response non-uniformity (PRNU) and, if given, a fixed offset for each pixel.

    Attributes
    ----------
    prnu
        Rms variation of the pixel gains relative to their mean. None: the camera's value.
    offset_e
        Rms of the pixel offsets (electrons).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import FixedPattern
    >>> FixedPattern().gain_rms(preset("r29"))  # rms of the pixels' gains over their mean
    0.01
    """

    prnu: float | None = None
    offset_e: float = 0.0

    name: ClassVar[str] = "fixed_pattern"
    units: ClassVar[Mapping[str, str]] = {"prnu": "share", "offset_e": "e-"}
    titles: ClassVar[Mapping[str, str]] = {"prnu": "rms of gains", "offset_e": "rms of offsets"}
    described: ClassVar[Mapping[str, str]] = {"prnu": "sensor.prnu"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"prnu": (0.0, math.inf), "offset_e": (0.0, math.inf)}
    title: ClassVar[str] = "fixed pattern (PRNU)"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 40
    pixel_ns: ClassVar[float] = 9.0

    def gain_rms(self, camera: Camera) -> float:
        """Return the rms variation of the pixel gains relative to their mean."""
        rms: float = self.magnitude("prnu", camera)
        return rms

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the relative rms variation of the gains, and the relative error due to gains and offsets."""
        rms = self.gain_rms(outlook.camera)
        # the effect of gains is proportional to light; offsets count in dark pixels too
        offsets = self.offset_e * outlook.pixels / outlook.signal_e
        return Estimate(rms, "relative", MEAN * math.hypot(rms, offsets), "0.8 prnu")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Apply the gain and offset of each pixel to ``strip`` (electrons) in place, and return it."""
        rms = self.gain_rms(view.camera)
        if rms:
            strip *= np.float32(1.0) + np.float32(rms) * view.pattern("gain")
        if self.offset_e:
            strip += np.float32(self.offset_e) * view.pattern("offset")
        return strip


@dataclass(frozen=True, slots=True)
class DarkCurrent(FrameEffect):
    """Dark current with the same mean in every pixel.

    Attributes
    ----------
    e_per_s
        Dark current (electrons per pixel per second). None: the camera's value.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import DarkCurrent
    >>> DarkCurrent(e_per_s=2.0).mean_e(preset("r29"), exposure_s=0.5)  # electrons
    1.0
    """

    e_per_s: float | None = None

    name: ClassVar[str] = "dark_current"
    units: ClassVar[Mapping[str, str]] = {"e_per_s": "e-/s"}
    titles: ClassVar[Mapping[str, str]] = {"e_per_s": "rate in a pixel"}
    described: ClassVar[Mapping[str, str]] = {"e_per_s": "sensor.dark_current_e_s"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"e_per_s": (0.0, math.inf)}
    title: ClassVar[str] = "dark current"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 50

    def mean_e(self, camera: Camera, exposure_s: float) -> float:
        """Return the mean number of electrons per pixel in an exposure of ``exposure_s`` seconds."""
        rate: float = self.magnitude("e_per_s", camera)
        return rate * exposure_s

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the mean dark signal (electrons per pixel), and the ratio of its sum over the cutout to the light."""
        mean = self.mean_e(outlook.camera, outlook.exposure_s)
        return Estimate(mean, "e-", mean * outlook.pixels / outlook.signal_e, "D t * pixels/signal")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Add the mean dark signal to ``strip`` (electrons) in place, and return it; `ShotNoise` adds its noise."""
        strip += np.float32(self.mean_e(view.camera, view.exposure_s))
        return strip


@dataclass(frozen=True, slots=True)
class ShotNoise(FrameEffect):
    """Poisson noise of the collected electrons.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, ShotNoise
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95), peak_e=10e3)
    >>> round(ShotNoise().estimate(plane).size, 3)  # 1/sqrt(10 000) in the brightest pixel
    0.01
    """

    name: ClassVar[str] = "shot_noise"
    title: ClassVar[str] = "shot noise"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 60
    stream: ClassVar[int | None] = 60  # a fixed number, so that a seed always gives the same session
    pixel_ns: ClassVar[float] = 25.0

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the relative rms noise of the brightest pixel, and the relative error of Gaussian spots, at most 1."""
        sharp, root = min(outlook.widths_px), math.sqrt(outlook.peak_e)
        error = outlook.over_types(lambda w: 2.0 * MEAN * (w / sharp) / root)
        return Estimate(1.0 / root, "relative", min(1.0, error), "1/sqrt(peak); 1.6 (w/w_min)/sqrt(peak) per type")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Return Poisson deviates (electrons) whose means are the values of ``strip``, which is not modified."""
        return poisson_quantile(strip, view.rng.random(strip.shape)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Saturation(FrameEffect):
    """Saturation: the signal of a pixel is clipped at the full-well capacity.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, Saturation
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95), peak_e=40e3)
    >>> found = Saturation().estimate(plane)
    >>> print(f"{found.size:.1f} {found.unit} at the peak: {found.error:.1%} of the image is clipped")
    2.0 of full well at the peak: 5.4% of the image is clipped
    """

    name: ClassVar[str] = "saturation"
    title: ClassVar[str] = "saturation"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 65

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the ratio k of the peak to the full well, and the relative error due to the clipped light."""
        full = outlook.camera.sensor.full_well_e
        sharp = min(outlook.widths_px)

        def lost(width: float) -> float:
            k = outlook.peak_e / full * (sharp / width) ** 2
            return 0.0 if k <= 1.0 else 1.0 - (1.0 + math.log(k)) / k

        share = outlook.over_types(lost)
        return Estimate(outlook.peak_e / full, "of full well", min(2.0, share / (1 - share)), "1 - (1 + ln k)/k")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Clip ``strip`` (electrons) in place at the full-well capacity, and return it."""
        return np.minimum(strip, np.float32(view.camera.sensor.full_well_e), out=strip)


@dataclass(frozen=True, slots=True)
class ReadNoise(FrameEffect):
    """Normally distributed read noise of the sensor.

    Attributes
    ----------
    rms_e
        Rms noise of a pixel (electrons). None: the camera's value.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ReadNoise
    >>> ReadNoise().rms(preset("r29")), ReadNoise(2.5).rms(preset("r29"))  # electrons
    (12.0, 2.5)
    """

    rms_e: float | None = None

    name: ClassVar[str] = "read_noise"
    units: ClassVar[Mapping[str, str]] = {"rms_e": "e-"}
    titles: ClassVar[Mapping[str, str]] = {"rms_e": "rms"}
    described: ClassVar[Mapping[str, str]] = {"rms_e": "sensor.read_noise_e"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rms_e": (0.0, math.inf)}
    title: ClassVar[str] = "read noise"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 70
    stream: ClassVar[int | None] = 70
    pixel_ns: ClassVar[float] = 9.0

    def rms(self, camera: Camera) -> float:
        """Return the rms noise of a pixel (electrons)."""
        rms: float = self.magnitude("rms_e", camera)
        return rms

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms noise (electrons), and the ratio of the cutout's summed absolute noise to its light."""
        rms = self.rms(outlook.camera)
        error = min(2.0, MEAN * rms * outlook.pixels / outlook.signal_e)
        return Estimate(rms, "e-", error, "0.8 read * pixels/signal")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Add normally distributed noise to ``strip`` (electrons) in place, and return it."""
        strip += np.float32(self.rms(view.camera)) * view.rng.standard_normal(strip.shape, np.float32)
        return strip


@dataclass(frozen=True, slots=True)
class Quantisation(FrameEffect):
    """Rounding of pixel values to whole counts, from 0 to the full scale of the analogue-to-digital converter.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, Quantisation
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95))
    >>> print(f"{Quantisation().estimate(plane).size:.2f} e- rms")  # of 20 000/4096 e- a step: over sqrt(12)
    1.41 e- rms
    """

    name: ClassVar[str] = "quantisation"
    title: ClassVar[str] = "quantisation"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 90
    whole_numbers: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms rounding error LSB/sqrt(12) (electrons), and the relative error for LSB/4 in each lit pixel.

        LSB is one count of the converter. The error includes weak diffracted light between the spots, which is rounded
        to zero.
        """
        sensor = outlook.camera.sensor
        lsb = sensor.electrons_per_count
        lit = min(float(outlook.pixels), math.pi * outlook.pattern_px**2)
        error = min(2.0, 0.25 * lsb * lit / outlook.signal_e)
        return Estimate(lsb / math.sqrt(12), "e-", error, "LSB/sqrt(12); LSB/4 * pixels of the pattern/signal")

    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Round ``strip`` (counts) in place, clip it to the range of the converter, and return it."""
        np.rint(strip, out=strip)
        return np.clip(strip, 0, view.camera.sensor.max_value, out=strip)


EFFECTS = (StrayLight, ColourFilter, FixedPattern, DarkCurrent, ShotNoise, Saturation, ReadNoise, Quantisation)
