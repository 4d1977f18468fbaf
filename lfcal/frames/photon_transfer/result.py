"""The figures of a sensor, and a camera with them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from lfcal.base import InputError
from lfcal.camera import Camera, Sensor
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve
from lfcal.frames.photon_transfer.values import MeasuredValue

__all__ = ["SensorMeasurement"]


@dataclass(frozen=True)
class SensorMeasurement:
    """What flats and darks tell of a sensor; None: they do not tell it, and ``notes`` say why.

    Attributes
    ----------
    gain
        Sample values per electron.
    black_level
        Sample value of no light; None where darks are cut off at zero.
    dark_level
        Mean of the darks of the shortest exposure (sample values), from which signals are counted.
    read_noise_counts, read_noise_e
        Rms, without that of rounding.
    saturation
        Sample value from which samples carry no measurement.
    full_well_e
        Electrons there.
    linearity
        Largest relative departure of the signal from a line over exposure, between 5 and 95 % of saturation.
    prnu
        Relative rms of the pixels' responses.
    dsnu_counts, dsnu_e
        Rms of the pixels' offsets.
    dark_current_e_s
        Electrons per pixel and second.
    bits
        Bits that the sample values need.
    shift
        Bits by which left-aligned samples were moved down; all counts are after that.
    hot, dead
        Pixels too bright in the dark, and blind ones; they are left out of everything else.
    channels
        Gain of each channel of the colour filter pattern.
    frames
        Flats and darks read.
    shape
        Pixels of a frame ``(rows, columns)``.
    doubts
        Why the figures are not those of the sensor; empty where nothing speaks against them.
    notes
        What else is worth knowing.
    curve
        The photon-transfer curve.
    """

    gain: MeasuredValue | None
    black_level: MeasuredValue | None
    dark_level: MeasuredValue
    read_noise_counts: MeasuredValue | None
    read_noise_e: MeasuredValue | None
    saturation: MeasuredValue | None
    full_well_e: MeasuredValue | None
    linearity: MeasuredValue | None
    prnu: MeasuredValue | None
    dsnu_counts: MeasuredValue | None
    dsnu_e: MeasuredValue | None
    dark_current_e_s: MeasuredValue | None
    bits: int
    shift: int
    hot: int
    dead: int
    channels: dict[str, MeasuredValue]
    frames: tuple[int, int]
    shape: tuple[int, int]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    curve: PhotonTransferCurve = field(repr=False, compare=False)

    @property
    def electrons_per_count(self) -> MeasuredValue | None:
        """One over the gain."""
        return None if self.gain is None else self.gain.inverse()

    @property
    def brightest(self) -> float:
        """Highest mean of pixels of like brightness (sample value)."""
        return self.dark_level.value + float(self.curve.points.x.max())

    def sensor(self, known: Sensor) -> tuple[Sensor, tuple[str, ...]]:
        """Return ``known`` with what was measured, and the names of those entries.

        Its full well is that of the highest sample value, which pixels that are full before do not reach.

        Raises
        ------
        InputError
            If the figures are doubtful, or the samples need more bits than ``known`` has and do not show how many.
        """
        if self.doubts or self.gain is None:
            why = self.doubts[0] if self.doubts else "the gain was not measured"
            raise InputError.expected("measured sensor", "figures to rely on", why, "record raw flats and darks again")
        clip = self.saturation.value if self.saturation is not None else None
        # a converter ends at a power of two; a level below that is the pixels' own
        full = clip is not None and int(clip + 1) & int(clip) == 0
        bits = self.bits if full or self.bits > known.bit_depth else known.bit_depth
        values: dict[str, float | int] = {"bit_depth": bits}
        if self.black_level is not None:
            values["black_level"] = max(0.0, self.black_level.value)
        top, black = (1 << bits) - 1, values.get("black_level", known.black_level)
        values["full_well_e"] = (top - black) / self.gain.value
        if clip is not None:
            values["saturation"] = clip
        for name in ("read_noise_e", "dark_current_e_s", "prnu", "dsnu_e", "linearity"):
            found: MeasuredValue | None = getattr(self, name)
            if found is not None:
                values[name] = max(0.0, found.value)
        changed = tuple(name for name in values if name != "bit_depth" or full)
        # a level that was stated stays unless it is of another bit depth, or the frames go beyond it
        stays = known.saturation if bits == known.bit_depth and (known.saturation or 0) > self.brightest else None
        return replace(known, **{"saturation": stays, **values}), changed  # type: ignore[arg-type]

    def camera(self, known: Camera) -> Camera:
        """Return ``known`` with its sensor as measured, marked so."""
        sensor, changed = self.sensor(known.sensor)
        return replace(known, sensor=sensor, marks=known.marks.marked([f"sensor.{n}" for n in changed], "measured"))
