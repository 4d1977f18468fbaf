"""Read facts about frames, simulation and quality from the provenance of H, without trusting it.

Provenance comes from a file that anyone may have written, and older files lack most of it. Entries without the expected
form therefore count as unknown. ``docs/files.md`` lists the entries.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from lfcal.base import format_seconds, format_share

if TYPE_CHECKING:
    from lfcal.frames import Noise

__all__ = [
    "OF_FRAMES",
    "Codec",
    "FrameNoise",
    "codec_of",
    "computed_words",
    "light_shares",
    "noise_of",
    "optics_of",
    "origin_of",
    "simulated_planes",
    "with_simulated",
]


OF_FRAMES = ("frames", "noise", "optics")
"""Entries that describe the frames; they are passed on to all that is made from the patterns."""


class Codec(NamedTuple):
    """Compression of the samples in the files of the frames.

    Attributes
    ----------
    name
        Name of the codec, such as ``lzw``; ``recording`` for a session of lfcal.
    lossless
        Whether samples are read exactly as the camera delivered them. None: unknown.
    """

    name: str
    lossless: bool | None


class FrameNoise(NamedTuple):
    """The noise of a sample in a corrected frame: the variance at value v is ``floor + slope * max(v - black, 0)``.

    Attributes
    ----------
    floor
        Variance without light (counts²).
    slope
        Increase of the variance per count of signal (counts).
    black
        Sample value without light (counts).
    source
        Description of how the values were determined.
    stated
        Whether the frames state the noise of each sample; this is not stored with H.
    """

    floor: float
    slope: float
    black: float
    source: str
    stated: bool = False

    @property
    def of_samples(self) -> Noise | None:
        """Noise to apply to every sample; None if the frames state their noise themselves."""
        from lfcal.frames import Noise  # an H is opened without the readers of frames

        return None if self.stated else Noise(self.floor, self.slope, self.black)

    def record(self) -> dict[str, Any]:
        """Return the entry ``noise`` for the provenance of H; `noise_of` reads it."""
        return {"floor": self.floor, "slope": self.slope, "black": self.black, "from": self.source}


def codec_of(provenance: Mapping[str, Any]) -> Codec | None:
    """Return the compression with which the files of the frames were stored; None if unknown.

    Examples
    --------
    >>> from lfcal.psf import codec_of
    >>> codec_of({"frames": {"count": 627, "codec": {"name": "lzw", "lossless": True}}})
    Codec(name='lzw', lossless=True)
    >>> print(codec_of({"frames": 627}))  # a file that lfcal 0.1 wrote
    None
    """
    codec = _within(_within(provenance, "frames"), "codec")
    if not isinstance(codec.get("name"), str):
        return None
    lossless = codec.get("lossless")
    return Codec(codec["name"], lossless if isinstance(lossless, bool) else None)


def origin_of(provenance: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the sensor position (row, column) of the first pixel of the frames (px); None if not stated.

    Examples
    --------
    >>> from lfcal.psf import origin_of
    >>> origin_of({"frames": {"count": 627, "origin": [120, 64]}})
    (120, 64)
    """
    found = _within(provenance, "frames").get("origin")
    if not isinstance(found, list | tuple) or len(found) != 2 or not all(type(n) is int for n in found):
        return None
    return found[0], found[1]


def noise_of(provenance: Mapping[str, Any]) -> FrameNoise | None:
    """Return the noise model of the frames; None if ``provenance`` states none that is valid.

    Its ``black`` level is 0 if it is not stated, as in files written by lfcal 0.1.

    Examples
    --------
    >>> from lfcal.psf import noise_of
    >>> noise_of({"noise": {"floor": 4.0, "slope": 0.25, "from": "darks and repeats"}})
    FrameNoise(floor=4.0, slope=0.25, black=0.0, source='darks and repeats', stated=False)
    """
    noise = _within(provenance, "noise")
    floor, slope, black = (_number(noise.get(name)) for name in ("floor", "slope", "black"))
    if floor is None or slope is None or min(floor, slope) < 0 or floor + slope == 0:
        return None
    return FrameNoise(floor, slope, black or 0.0, str(noise.get("from", "not stated")))


def optics_of(provenance: Mapping[str, Any]) -> str | None:
    """Return the method by which the camera simulator computed the frames; None for real frames, or if unknown."""
    found = provenance.get("optics")
    return found if isinstance(found, str) and found else None


def light_shares(provenance: Mapping[str, Any]) -> bool:
    """Return whether H was simulated without frames, so that its values are fractions of the light and not counts.

    An H assembled from simulated frames has counts; it is recognised by the noise seed in its provenance.
    """
    simulated = provenance.get("simulated")
    return isinstance(simulated, Mapping) and "seed" not in simulated


def simulated_planes(provenance: Mapping[str, Any], planes: int) -> list[dict[str, Any] | None]:
    """Return the record of how each plane was simulated; None for planes without one.

    ``planes`` is the number of planes; if another number is stored, all records are None. ``docs/files.md`` lists the
    entries of a record.

    Examples
    --------
    >>> from lfcal.psf import simulated_planes
    >>> simulated_planes({"simulated": {"planes": [{"engine": "grid", "seconds": 1.5}, None]}}, 2)
    [{'engine': 'grid', 'seconds': 1.5}, None]
    """
    found = _within(provenance, "simulated").get("planes")
    if not isinstance(found, list) or len(found) != planes:
        return [None] * planes
    return [dict(one) if isinstance(one, Mapping) else None for one in found]


def with_simulated(provenance: Mapping[str, Any], planes: Sequence[Mapping[str, Any] | None]) -> dict[str, Any]:
    """Return ``provenance`` extended by ``planes``, the records of how each plane was simulated.

    `simulated_planes` reads them from the result. If a level was requested and the records name engines, the entry
    ``level`` becomes the names of these engines. The requested level is kept as ``requested_level``.
    """
    simulated = {**provenance.get("simulated", {}), "planes": list(planes)}
    engines = dict.fromkeys(str(one["engine"]) for one in planes if one is not None and "engine" in one)
    if engines and "level" in simulated:
        simulated |= {"requested_level": simulated["level"], "level": ", ".join(engines)}
    return {**provenance, "simulated": simulated}


def computed_words(planes: Sequence[Mapping[str, Any] | None]) -> tuple[str, ...]:
    """Return engine, sampling, total processor time and largest error of simulated planes, as lines of text.

    ``planes`` are records as from `simulated_planes`. Planes with the same engine and sampling share a line.

    Examples
    --------
    >>> from lfcal.psf import computed_words
    >>> one = {"engine": "grid", "sampling": {"samples_per_px": 4, "margin_px": 10}, "grid_side": 160}
    >>> computed_words([{**one, "processor_seconds": 0.5, "error": 0.018}, {**one, "processor_seconds": 0.7}])
    ('planes 0 to 1: grid, 4 samples per pixel, 160 x 160 samples; 1.2 s of processor time; error at most 1.8 %',)
    """
    groups: dict[str, list[int]] = {}
    for z, one in enumerate(planes):
        if one is not None and isinstance(one.get("engine"), str):
            groups.setdefault(f"{one['engine']}{_sampling_words(one)}", []).append(z)
    found = []
    for how, numbers in groups.items():
        those = [one for z in numbers if (one := planes[z]) is not None]
        sides = sorted(side for one in those if (side := _number(one.get("grid_side"))))
        grid = "" if not sides else f"{sides[0]:g} x {sides[0]:g}"
        if sides and sides[0] != sides[-1]:
            grid += f" to {sides[-1]:g} x {sides[-1]:g}"
        count = "plane" if len(numbers) == 1 else "planes"
        parts = [f"{count} {_ranges(numbers)}: {how}" + (f", {grid} samples" if grid else "")]
        spent = [n for one in those if (n := _number(one.get("processor_seconds"))) is not None]
        if len(spent) == len(those):
            parts.append(f"{format_seconds(sum(spent))} of processor time")
        errors = [n for one in those if (n := _number(one.get("error"))) is not None]
        if errors:
            parts.append(f"error at most {format_share(max(errors))}")
        found.append("; ".join(parts))
    return tuple(found)


def _sampling_words(one: Mapping[str, Any]) -> str:
    """Return the sampling of a plane's record as text, with only the values that its engine uses."""
    sampling, engine = _within(one, "sampling"), one["engine"]
    if engine == "geometric":
        return ", rays integrated over the pixels"
    on_array = engine in ("grid", "reference")
    per = _number(sampling.get("samples_per_px" if on_array else "nodes_per_px"))
    return "" if per is None else f", {per:g} {'samples' if on_array else 'nodes'} per pixel"


def _ranges(numbers: Sequence[int]) -> str:
    """Return increasing numbers as text, such as ``0 to 3, 5``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _within(value: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = value.get(name)
    return found if isinstance(found, Mapping) else {}


def _number(value: Any) -> float | None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if good else None
