"""The protocol shared by real, recorded, imported and simulated frames."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, Position, Region, check_region, format_pixels

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames.corrections import Dark

__all__ = [
    "DarkNoise",
    "FrameInfo",
    "FrameMetadata",
    "FrameSource",
    "Frames",
    "LeftOut",
    "Noise",
    "Position",
    "Samples",
    "check_index",
    "check_mask",
    "check_region",
    "masked",
    "observed",
]


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """Metadata of one frame that are known without reading it. None means unknown.

    Attributes
    ----------
    points
        Scan positions (z, y, x) of the point sources that the frame shows.
    origin
        Position (row, column) of the frame's first pixel on the sensor (px); (0, 0) for frames of the whole sensor.
    exposure_s
        Exposure time (s).
    drift
        Displacement (rows, columns) of the paraxial image from its planned position on the sensor (px).
    saturated
        Number of saturated pixels in the frame, if counted during recording.
    label
        Short name for messages, such as the file name.
    mask
        Mask ``(rows, columns)``, True at pixels with a measurement. None: no invalid pixels are known.

    Examples
    --------
    >>> from lfcal.frames import FrameInfo, open_frames
    >>> with open_frames("session/frames") as source:
    ...     info: FrameInfo = source.info(34)
    >>> print(info.label, info.position, info.origin)
    z0_y01_x31.png Position(z=0, y=1, x=31) (0, 0)
    """

    points: tuple[Position, ...]
    origin: tuple[int, int] = (0, 0)
    exposure_s: float | None = None
    drift: tuple[float, float] | None = None
    saturated: int | None = None
    label: str = ""
    mask: NDArray[np.bool_] | None = None

    @property
    def position(self) -> Position:
        """Scan position (z, y, x) of a frame of a single point. For other frames, `InputError` is raised."""
        if len(self.points) != 1:
            raise InputError.expected(
                self.label or "frame",
                "one point source",
                len(self.points),
                "use a function for frames of several points",
            )
        return self.points[0]


class LeftOut(NamedTuple):
    """A damaged frame that was left out.

    ``label`` is its name, ``position`` its scan position (z, y, x), and ``reason`` describes the damage. The position
    is None for a dark frame or a frame of several points.
    """

    label: str
    position: Position | None
    reason: str


Number: TypeAlias = float | NDArray[np.float64]


class Noise(NamedTuple):
    """Model of the noise of a sample: at the value v, the variance is ``constant + slope * max(v - black, 0)`` counts².

    A sensor with g electrons per count and r electrons of read noise has ``constant = (r / g)^2 + 1/12`` (quantisation)
    and ``slope = 1 / g`` (photon noise). ``constant`` and ``slope`` are numbers, or arrays ``(rows, columns)`` with a
    value for every sample. ``black`` is the sample value without light (counts). None: unknown, and treated as 0.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import Noise
    >>> noise = Noise(constant=4.0, slope=0.2, black=64.0)
    >>> noise.variance(np.array([64, 1064])).tolist()
    [4.0, 204.0]
    """

    constant: Number
    slope: Number
    black: float | None = 0.0

    def scaled(self, factor: float) -> Noise:
        """Return the noise of samples multiplied by ``factor``."""
        black = None if self.black is None else self.black * factor
        return Noise(self.constant * factor * factor, self.slope * abs(factor), black)

    def of_mean(self, count: int) -> Noise:
        """Return the noise of the mean of ``count`` independent samples with this noise."""
        return Noise(self.constant / count, self.slope / count, self.black)

    def moved(self, move: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Noise:
        """Return the noise of samples that ``move`` rearranges; a scalar constant or slope stays unchanged."""
        constant, slope = (move(n) if isinstance(n, np.ndarray) and n.ndim else n for n in (self.constant, self.slope))
        return Noise(constant, slope, self.black)

    def variance(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return the variance of each sample of ``values`` (counts²), in the shape of ``values``."""
        light = np.maximum(np.asarray(values, np.float64) - (self.black or 0.0), 0.0)
        found: NDArray[np.float64] = self.constant + self.slope * light
        return found

    def typical(self, values: NDArray[Any]) -> Noise:
        """Return the noise with a scalar constant and slope, and a black level of 0, that best fits that of ``values``.

        If constant or slope differs between samples, as after division by a white image, both are fitted by least
        squares. The fit preserves the mean variance, and approximates its growth with the signal.
        """
        if not isinstance(self.constant, np.ndarray) and not isinstance(self.slope, np.ndarray):
            if not self.black:
                return Noise(self.constant, self.slope)
            return Noise(self.constant - self.slope * self.black, self.slope)
        light = np.maximum(np.asarray(values, np.float64), 0.0)
        variance = self.variance(values)
        away = light - light.mean()
        norm = float((away * away).sum())
        slope = float((away * variance).sum()) / norm if norm > 0 else float(np.mean(self.slope))
        # a slope outside the range of all comes from samples with almost no light
        slope = min(max(slope, float(np.min(self.slope))), float(np.max(self.slope)))
        return Noise(max(0.0, float(variance.mean()) - slope * float(light.mean())), slope)


@dataclass(frozen=True)
class DarkNoise:
    """Noise of a subtracted dark frame that is the mean of ``count`` frames, each with ``variance`` per sample.

    ``variance`` is in squared sample values after all corrections; None: unknown.
    """

    count: int
    variance: float | None


@dataclass(frozen=True)
class FrameMetadata:
    """Metadata common to all frames of a source. None, an empty value, or the default means unknown.

    A view of a source returns a modified copy of the metadata of the source. "Stored with H" marks what is saved with
    the transfer matrix H that is measured from the frames.

    Attributes
    ----------
    bit_depth
        Number of bits that a sample may use.
    saturation
        Sample value at which a pixel is saturated (counts); None also if it differs between pixels.
    black_level
        Sample value without light (counts), or a tuple with one value for each position of the colour filter pattern,
        in row-major order.
    cfa
        Colour filter pattern in row-major order, from the first pixel of the frames, such as ``"RGGB"``; empty also for
        monochrome frames.
    gains
        White-balance factors of the camera for the positions of the colour filter pattern, in row-major order; for a
        single channel, one number.
    noise
        Noise of the samples before any correction.
    darks
        Dark frames recorded with the frames, by exposure time (s).
    lost_darks
        Exposure times (s) for which all recorded dark frames are damaged.
    left_out
        Damaged frames that were left out.
    codec
        Compression of the samples in the files, such as ``{"name": "lzw", "lossless": True}``. Stored with H.
    colour
        Component of colour images from which the frames were read, one of `lfcal.frames.opening.COMPONENTS`.
    pixel_um
        Size of a pixel in object space, as stated by the files (µm).
    path
        File or folder from which the frames are read.
    notes
        Guesses made when the frames were opened, one line each.
    plan
        Scan plan with which the frames were recorded or simulated.
    plan_shape
        Number of positions ``(nz, ny, nx)`` of the scan.
    origin
        Position (row, column) of the frames' first pixel on the sensor as delivered (px), if all frames show the same
        part. Stored with H.
    stated_origin
        Position (row, column) of the first pixel that the files state (px), but that has not been confirmed.
    channel
        Channel of the colour filter pattern, such as ``"G1"``, if the frames contain only one; empty: all channels, or
        monochrome.
    channel_phase
        Position (row, column) of the channel's first pixel in the mosaic.
    pixel_step
        Distance between neighbouring pixels of the channel (pixels of the mosaic).
    balanced_by
        Factors by which the positions of the colour filter pattern were multiplied, in row-major order.
    shift
        Number of bits by which left-aligned samples were shifted to the right.
    corrections
        The applied corrections (`CorrectionChain.describe`). Stored with H.
    keeps_level
        Whether the corrected frames still contain the black level. None: no corrections were applied.
    dark_noise
        Noise added by the subtracted dark frame, if it is the same for all frames.
    half_cell
        Details of the frames copied from half a period away (`lfcal.frames.half_cell`), in the form stored with H. The
        keys are ``frames`` (number copied), ``filled`` (number of positions), ``shift`` (in positions), ``residual_px``
        and ``positions`` (ranges).
    orientation
        Name of the orientation that was applied to make the frames upright (`lfcal.frames.ORIENTATIONS`). None: as
        delivered.
    session
        Identifier of the recorded session. Stored with H.
    devices
        Names of the camera and the stage of a recorded session, and the camera's settings. Stored with H.
    optics
        Method of simulation, if the camera is simulated: ``"pattern"``, or a level of `lfcal.simulate`. Stored with H.
    simulated
        ``effects``, ``level`` and ``seed`` of simulated frames. Stored with H.
    suspect
        Positions whose frames appeared suspect during recording, as ``[z, y, x, reason]``. Stored with H.
    kept_aside
        Positions ``[z, y, x]`` held out from a fit. Stored with H.
    earlier_tasks
        Tasks that recorded the frames, as returned by `lfcal.tasks.Task.to_dict`. Stored with H.
    target
        Plan of the target that the frames show (`lfcal.targets.TargetPlan`).
    target_frames
        Pair (plane index, offset number) of each frame of a target.
    decoded
        Whether the frames were decoded from frames that each show several offsets of a target together.
    points_left_out
        Number of points in a target's frames that correspond to no position of the scan.
    other
        Further metadata, for example from a plug-in; lfcal does not use them.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, FrameMetadata
    >>> source = ArraySource(np.zeros((1, 1, 1, 4, 6), np.uint16), metadata=FrameMetadata(bit_depth=12))
    >>> print(source.metadata.bit_depth, source.metadata.black_level)
    12 None
    """

    bit_depth: int | None = None
    saturation: float | None = None
    black_level: float | tuple[float, ...] | None = None
    cfa: str = ""
    gains: float | tuple[float, ...] | None = None
    noise: Noise | None = None
    darks: Mapping[float, Dark] = field(default_factory=dict)
    lost_darks: tuple[float, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    codec: Mapping[str, Any] | None = None
    colour: str | None = None
    pixel_um: float | None = None
    path: str | None = None
    notes: tuple[str, ...] = ()
    plan: ScanPlan | None = None
    plan_shape: tuple[int, int, int] | None = None
    origin: tuple[int, int] | None = None
    stated_origin: tuple[int, int] | None = None
    channel: str = ""
    channel_phase: tuple[int, int] | None = None
    pixel_step: int = 1
    balanced_by: tuple[float, ...] | None = None
    shift: int = 0
    corrections: Mapping[str, Any] | None = None
    keeps_level: bool | None = None
    dark_noise: DarkNoise | None = None
    half_cell: Mapping[str, Any] | None = None
    orientation: str | None = None
    session: str | None = None
    devices: Mapping[str, Any] | None = None
    optics: str = ""
    simulated: Mapping[str, Any] | None = None
    suspect: Sequence[Sequence[Any]] = ()
    kept_aside: Sequence[Sequence[int]] = ()
    earlier_tasks: Sequence[Mapping[str, Any]] = ()
    target: object = None
    target_frames: tuple[tuple[int, int], ...] | None = None
    decoded: bool = False
    points_left_out: int = 0
    other: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of(cls, known: FrameMetadata | Mapping[str, Any]) -> FrameMetadata:
        """Return the metadata of a source as a `FrameMetadata`; unknown entries of a mapping are put into ``other``.

        Older plug-ins return their metadata as a mapping, in which None means unknown, like a missing entry.

        Raises
        ------
        InputError
            If ``known`` is neither a `FrameMetadata` nor a mapping.
        """
        if isinstance(known, cls):
            return known
        if not isinstance(known, Mapping):
            what, wanted = "metadata of a frame source", "FrameMetadata"
            raise InputError.expected(what, wanted, type(known).__name__, "return lfcal.frames.FrameMetadata")
        names = {one.name for one in fields(cls)} - {"other"}
        stated = {key: value for key, value in known.items() if key in names and value is not None}
        stated = {key: tuple(value) if isinstance(value, list) else value for key, value in stated.items()}
        return cls(**stated, other={key: value for key, value in known.items() if key not in names})

    def stated(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the values of the fields ``names``, by name, in the given order.

        Values that are None, zero or empty are omitted. The others have the form stored with H.
        """
        return {name: value for name in names if (value := getattr(self, name))}


class Samples(NamedTuple):
    """Samples of a frame, or of a part of it, with their validity and noise.

    Attributes
    ----------
    values
        Values of the samples (counts), ``(rows, columns)``.
    valid
        Mask ``(rows, columns)``, False at samples without a measurement (saturated or masked). None: all are valid.
    noise
        Noise of the samples. None: unknown.
    saturated
        Number of saturated pixels in this part. None: unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, Samples
    >>> source = ArraySource(np.array([[[17, 4095]]]), [(0, 0, 0)], metadata={"saturation": 4095})
    >>> part: Samples = source.samples(0)
    >>> print(part.saturated, part.valid.tolist())
    1 [[True, False]]
    """

    values: NDArray[Any]
    valid: NDArray[np.bool_] | None = None
    noise: Noise | None = None
    saturated: int | None = None


@runtime_checkable
class FrameSource(Protocol):
    """Protocol for a source of 2-D frames of equal shape; subclass `Frames` to implement it.

    Frames may be in any order; a position may be missing or occur several times. Reading is thread-safe. ``metadata``
    does not change while the source is open.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        ...

    @property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames."""
        ...

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` without reading its samples."""
        ...

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the part of it in ``region`` (rows, columns), as a new array of `dtype`."""
        ...

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the result of `read` with validity, noise and the number of saturated pixels."""
        ...


_UNKNOWN = FrameMetadata()


class Frames(ABC):
    """Base class for frame sources that implement the protocol `FrameSource`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, Frames
    >>> def brightest(source: Frames) -> int:
    ...     return max(range(len(source)), key=lambda k: source.read(k).max())
    >>> brightest(ArraySource(np.array([[[1, 2]], [[3, 9]], [[4, 0]]]), [(0, 0, 0), (0, 0, 1), (0, 0, 2)]))
    1
    """

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""

    @property
    @abstractmethod
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""

    @property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames."""
        return _UNKNOWN

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of frames."""

    @abstractmethod
    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` without reading its samples."""

    @abstractmethod
    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the part of it in ``region`` (rows, columns), as a new array of `dtype`."""

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the result of `read` with validity, noise and the number of saturated pixels.

        Saturated and masked samples are invalid.
        """
        known = FrameMetadata.of(self.metadata)  # sources of earlier plug-ins return a mapping
        found = observed(self.read(index, region), known.saturation, known.noise)
        mask = self.info(index).mask
        return found if mask is None else masked(found, mask if region is None else mask[region])

    def repeats(self) -> FrameSource | None:
        """Return a source of repeated frames of one position with the same settings; None if there are none."""
        return None

    def close(self) -> None:  # noqa: B027  most sources keep nothing open
        """Close the files that the source keeps open."""

    def __enter__(self) -> Self:
        """Return the source."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the files that the source keeps open."""
        self.close()


def observed(values: NDArray[Any], saturation: float | None, noise: Noise | None = None) -> Samples:
    """Return raw ``values`` as samples with ``noise``; those at or above the value ``saturation`` are invalid.

    Without ``saturation``, only integer samples with the highest value of their type are invalid. If there are none,
    the number of saturated samples is 0 for 8-bit samples. For all others, including floating-point samples, it is
    then unknown, because the sensor may saturate at a lower value.
    """
    # floats have no natural upper end: without a level none can be called saturated
    if saturation is None and values.dtype.kind == "f":
        return Samples(values, noise=noise)
    level = saturation
    if values.dtype.kind in "iu":
        top = int(np.iinfo(values.dtype).max)
        # integer samples reach a fractional level only at the next integer
        level = top if level is None else math.ceil(level)
        # a level beyond the type cannot be reached
        if level > top:
            return Samples(values, noise=noise, saturated=0)
    full = values >= level
    count = int(np.count_nonzero(full))
    if count == 0:
        # 8-bit cameras use their whole range; 16-bit files often contain 10, 12 or 14 bits
        known = saturation is not None or values.dtype == np.uint8
        return Samples(values, noise=noise, saturated=0 if known else None)
    return Samples(values, ~full, noise, count)


def masked(found: Samples, mask: NDArray[np.bool_]) -> Samples:
    """Return ``found`` with the samples outside ``mask`` marked as invalid and not counted as saturated."""
    if found.valid is None:
        return found if mask.all() else found._replace(valid=np.array(mask))
    count = None if found.saturated is None else int(np.count_nonzero(mask & ~found.valid))
    return found._replace(valid=found.valid & mask, saturated=count)


def check_index(index: int, count: int) -> int:
    """Return ``index``; raise `InputError` unless it is at least 0 and less than ``count``."""
    if not 0 <= index < count:
        raise InputError.expected("frame index", f"0 … {count - 1}", index, "choose an existing frame")
    return int(index)


def check_mask(mask: ArrayLike, shape: tuple[int, int], what: str) -> NDArray[np.bool_]:
    """Return ``mask`` as a read-only array of bool.

    Raises
    ------
    InputError
        If ``mask`` has no valid pixel, or another shape than ``shape``; ``what`` names the frames in the message.
    """
    checked = np.array(mask, np.bool_)
    if checked.shape != shape:
        raise InputError.expected(
            f"{what}, pixel mask", format_pixels(shape), format_pixels(checked.shape), "use a mask for these frames"
        )
    if not checked.any():
        raise InputError.expected(f"{what}, pixel mask", "at least one valid pixel", "none", "mark valid pixels with 1")
    checked.flags.writeable = False
    return checked
