"""A complete camera: optics, lenslets, sensor, and the source of each value."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from functools import cache
from types import UnionType
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    check_choice,
    check_number,
    check_type,
    check_wavelength,
    parse_json,
    stated_format,
)
from lfcal.camera.distortion import BrownDistortion
from lfcal.camera.lattice import LensletLattice
from lfcal.camera.main_lens import MainLens, Microscope, Optics
from lfcal.camera.pupil_lenslets import NoLatticeError, PupilLenslets
from lfcal.camera.sensor import Sensor

__all__ = ["MARKS", "Camera", "Marks", "build", "nearest_lens"]

T = TypeVar("T")
FORMAT = "lfcal-camera"
VERSION, LATTICE_VERSION = 3, 2
"""Format versions of cameras with `PupilLenslets`, and of all others, which older programs can also read."""

ADDED: dict[int, dict[str, dict[str, Any]]] = {
    2: {
        "": {"marks": {}},
        "lattice": {"shear_rad": 0.0, "distortion": None},
        "sensor": {"saturation": None, "dsnu_e": None, "linearity": None},
    }
}
"""Entries that each version of the format added, with their values for older files, by part ("": the camera itself)."""


MARKS = ("stated", "measured", "derived", "assumed")


@dataclass(frozen=True, slots=True)
class Marks:
    """Record of how each camera value is known: stated, measured, derived or assumed.

    A value is identified by its path, such as ``"sensor.pixel_um"``. Values without a mark count as stated by the
    author of the description.

    Attributes
    ----------
    entries
        Pairs (path, mark), sorted by path; each mark is one of `MARKS`.

    Examples
    --------
    >>> from lfcal.camera import Marks
    >>> marks = Marks.of({"lattice.pitch_um": "measured", "lattice.gap_um": "assumed"})
    >>> print(marks["lattice.pitch_um"], marks["sensor.pixel_um"], marks.paths("assumed"))
    measured stated ('lattice.gap_um',)
    >>> print(marks.marked(["lattice.gap_um"], "stated").paths("assumed"))
    ()
    """

    entries: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check and sort the entries."""
        for path, mark in self.entries:
            check_type("path of a mark", path, str)
            check_choice(f"mark of {path}", mark, MARKS)
        object.__setattr__(self, "entries", tuple(sorted(dict(self.entries).items())))

    @classmethod
    def of(cls, entries: Mapping[str, str]) -> Marks:
        """Return the marks given as a mapping from paths to marks."""
        return cls(tuple(entries.items()))

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Iterate over pairs (path, mark)."""
        return iter(self.entries)

    def __getitem__(self, path: str) -> str:
        """Return the mark of the value at ``path``; ``"stated"`` if it has none."""
        return dict(self.entries).get(path, "stated")

    def paths(self, mark: str) -> tuple[str, ...]:
        """Return the paths in `entries` with the given mark; values without an entry are not included."""
        return tuple(path for path, own in self.entries if own == mark)

    def marked(self, paths: Iterable[str], mark: str) -> Marks:
        """Return a copy in which the values at ``paths`` have the given mark."""
        return Marks.of(dict(self.entries) | dict.fromkeys(paths, mark))


@dataclass(frozen=True, slots=True)
class Camera:
    """A plenoptic camera, light-field microscope, or Fourier light-field microscope.

    Attributes
    ----------
    name
        Display name.
    optics
        Optics in front of the lenslets: a `MainLens` or a `Microscope`.
    lattice
        Lenslet array: a periodic `LensletLattice`, or the `PupilLenslets` of a Fourier light-field microscope. For the
        latter, properties that only a periodic array has raise `NoLatticeError`; see `has_lattice`.
    sensor
        Image sensor.
    wavelength_um
        Design wavelength in vacuum (µm).
    bandwidth_um
        Full width of the spectrum of the light (µm); 0: monochromatic.
    distortion
        Lens distortion stated by the manufacturer, which is stored but not applied; None if unknown.
    marks
        Record of which values are stated, measured, derived or assumed; ignored when cameras are compared.

    Examples
    --------
    >>> from lfcal.camera import Camera, LensletLattice, MainLens, Sensor
    >>> lattice = LensletLattice(pitch_um=110.0, gap_um=580.0)
    >>> camera = Camera("mine", MainLens(100e3, 4.0, 400e3), lattice, Sensor(pixel_um=5.5))
    >>> print(f"{camera.pitch_px:.1f} px between lenslets; a step of {camera.step_um():.2f} µm moves the image by 1 px")
    20.0 px between lenslets; a step of 16.43 µm moves the image by 1 px
    >>> print(f"{camera.depth_of(3.0) / 1000:.1f} mm from the working plane: virtual depth 3")
    -14.9 mm from the working plane: virtual depth 3
    """

    name: str
    optics: Optics
    lattice: LensletLattice | PupilLenslets
    sensor: Sensor
    wavelength_um: float = 0.55
    bandwidth_um: float = 0.0
    distortion: BrownDistortion | None = None
    marks: Marks = field(default=Marks(), compare=False)

    def __post_init__(self) -> None:
        """Check every value."""
        check_type("camera name", self.name, str)
        check_type("camera optics", self.optics, (MainLens, Microscope))
        check_type("lenslet lattice", self.lattice, (LensletLattice, PupilLenslets))
        if not self.has_lattice:
            check_type("optics in front of lenslets in a pupil plane", self.optics, Microscope)
        check_type("sensor", self.sensor, Sensor)
        if self.distortion is not None:
            check_type("distortion", self.distortion, BrownDistortion)
        check_type("marks", self.marks, Marks)
        check_wavelength(self.wavelength_um)
        check_number("bandwidth (µm)", self.bandwidth_um, at_least=0, below=self.wavelength_um)

    # -- derived lengths -------------------------------------------------------------------------------
    @property
    def has_lattice(self) -> bool:
        """Whether the lenslets form a periodic lattice; those of a Fourier light-field microscope do not."""
        return isinstance(self.lattice, LensletLattice)

    @property
    def periodic(self) -> LensletLattice:
        """Periodic lattice of the lenslets; raises `NoLatticeError` if the camera has none."""
        if not isinstance(self.lattice, LensletLattice):
            raise NoLatticeError.of("lenslet lattice")
        return self.lattice

    @property
    def pitch_px(self) -> float:
        """Pitch of the micro-images along a row of the lattice (sensor pixels)."""
        return self.lattice.pitch_um / self.sensor.pixel_um

    @property
    def period_px(self) -> tuple[float, float]:
        """Period ``(y, x)`` of micro-images and lens types (px), not rounded to integers; (1, 1) without a lattice."""
        if not self.has_lattice:
            return 1.0, 1.0
        y, x = self.lattice.period_um
        return y / self.sensor.pixel_um, x / self.sensor.pixel_um

    @property
    def lattice_scale(self) -> float:
        """Ratio of micro-image pitch to lenslet pitch: 1 + gap/image distance for a main lens, 1 for a microscope.

        It raises `NoLatticeError` for lenslets in a pupil plane.
        """
        # the chief ray leaves the exit pupil's centre and passes the lenslet at distance b, the sensor at b + B
        return 1.0 + self.periodic.gap_um / self.optics.image_distance_um

    @property
    def magnification(self) -> float:
        """Lateral magnification |M| from the working plane to the sensor, along the chief ray."""
        if isinstance(self.lattice, PupilLenslets):
            return self.optics.magnification * self.lattice.relay
        return self.optics.magnification * self.lattice_scale

    def pixels(self, xy_um: ArrayLike) -> NDArray[np.float64]:
        """Return the pixel coordinates (row, column), ``(..., 2)``, of points ``xy_um`` on the sensor.

        The points (x, y), ``(..., 2)``, are relative to the sensor's centre (µm). Integer coordinates are pixel
        centres.
        """
        # Camera.pixels counts (row, column), points count (x, y): the order is swapped, without mirroring
        flipped = np.asarray(xy_um, float)[..., ::-1]
        pixels: NDArray[np.float64] = flipped / self.sensor.pixel_um + np.array(self.sensor.centre_px)
        return pixels

    def sensor_um(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return the points (x, y), ``(..., 2)``, relative to the sensor's centre (µm) at pixels (row, column).

        This is the inverse of `pixels`; integer coordinates are pixel centres.
        """
        offset = np.asarray(pixels, float) - np.array(self.sensor.centre_px)
        flipped: NDArray[np.float64] = offset[..., ::-1]
        return flipped * self.sensor.pixel_um

    def local(self, place: ArrayLike) -> Camera:
        """Return a copy of the camera whose lattice is linearised about the sensor pixel ``place`` (row, column)."""
        x, y = self.sensor_um(place)
        return replace(self, lattice=self.lattice.local((float(x), float(y))))

    # -- depth -----------------------------------------------------------------------------------------
    def step_um(self, z_um: float = 0.0) -> float:
        """Return the lateral step in object space (µm) that moves the image by one pixel, at the depth ``z_um`` (µm).

        The depth is relative to the working plane and positive away from the camera; for a microscope, the step does
        not depend on it. For a main lens, the chief ray is traced from the object through the centre of the lens to the
        sensor. At every depth, the pattern then repeats exactly when the image has moved by one micro-image period.

        Raises
        ------
        InputError
            If the depth is not beyond the front focal plane of the main lens.
        """
        if isinstance(self.optics, Microscope):
            return self.sensor.pixel_um / self.magnification
        # similar triangles about the lens's centre: step / object distance = pixel / image distance
        distance = self._object_distance(z_um)
        return self.sensor.pixel_um * distance / (self.optics.image_distance_um + self.lattice.gap_um)

    def image_shift_um(self, z_um: float) -> float:
        """Return the distance a (µm) from the lenslet array to the image of the plane at depth ``z_um`` (µm).

        The distance is positive behind the array. The depth z is relative to the working plane and positive away from
        the camera; for positive z, a is negative. For a microscope with the magnification M and the medium index n,
        ``a = -M² z / n`` (paraxial). For a main lens, a follows from the thin-lens equation, and `InputError` is raised
        as in `step_um`. For lenslets in a pupil plane, it is not defined, and `NoLatticeError` is raised.
        """
        self._check_lattice("virtual depth")
        if isinstance(self.optics, Microscope):
            return -(self.optics.magnification**2) * z_um / self.optics.medium_index
        return self.optics.image_of(self._object_distance(z_um)) - self.optics.image_distance_um

    def virtual_depth(self, z_um: float) -> float:
        """Return the virtual depth of the object depth ``z_um`` (µm): `image_shift_um` divided by the gap.

        The errors are those of `image_shift_um`.
        """
        return self.image_shift_um(z_um) / self.lattice.gap_um

    def depth_of(self, virtual_depth: float) -> float:
        """Return the object depth z (µm) of a virtual depth; the inverse of `virtual_depth`.

        Raises `InputError` if no object in front of a main lens is imaged to that virtual depth, and `NoLatticeError`
        for lenslets in a pupil plane.
        """
        self._check_lattice("virtual depth")
        a = virtual_depth * self.lattice.gap_um
        if isinstance(self.optics, Microscope):
            return -a * self.optics.medium_index / self.optics.magnification**2
        image = self.optics.image_distance_um + a
        # the image of an object at infinity lies in the back focal plane; closer to the lens there is no real object
        if image <= self.optics.focal_length_um:
            infinity = (self.optics.focal_length_um - self.optics.image_distance_um) / self.lattice.gap_um
            limit = f"above {infinity:.4g} (an object at infinity)"
            raise InputError.expected("virtual depth", limit, virtual_depth, "choose a larger virtual depth")
        return 1.0 / (1.0 / self.optics.focal_length_um - 1.0 / image) - self.optics.working_distance_um

    def _check_lattice(self, what: str) -> None:
        if not self.has_lattice:
            raise NoLatticeError.of(what)

    def _object_distance(self, z_um: float) -> float:
        assert isinstance(self.optics, MainLens)
        distance = self.optics.working_distance_um + z_um
        if not distance > self.optics.focal_length_um:
            focus = self.optics.focal_length_um - self.optics.working_distance_um
            limit = f"z above {focus:.6g} µm (the front focal plane)"
            raise InputError.expected("depth", limit, f"{z_um:g} µm", "choose a plane farther from the lens")
        return distance

    # -- JSON ------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain JSON types, including its format and version."""
        data = asdict(self)
        data["optics"] = {"type": type(self.optics).__name__, **asdict(self.optics)}
        data["marks"] = dict(self.marks)
        if not self.has_lattice:
            data["lattice"] = {"type": type(self.lattice).__name__, **data["lattice"]}
        return {"format": FORMAT, "version": LATTICE_VERSION if self.has_lattice else VERSION, **data}

    def to_json(self) -> str:
        """Return the description as JSON text."""
        # NaN is not JSON, and other programs refuse it
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Camera:
        """Return the camera described by the result of `to_dict`, of this or an earlier version of the format.

        Raises
        ------
        FileFormatError
            If the format or version is not supported, or entries are unknown, missing, or of another type.
        InputError
            If a value is invalid.
        """
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            raise FileFormatError.expected(
                "camera description",
                f'"format": "{FORMAT}"',
                stated_format(data),
                "check that the file describes a camera for lfcal",
            )
        version = data.get("version")
        if type(version) is not int or not 1 <= version <= VERSION:
            raise FileFormatError.expected("camera description", f"a version up to {VERSION}", version, "update lfcal")
        body = _completed(data, version)
        optics = body.get("optics")
        if not isinstance(optics, Mapping) or optics.get("type") not in ("MainLens", "Microscope"):
            raise FileFormatError.expected(
                "camera optics", "type MainLens or Microscope", optics, "choose one of these types"
            )
        kind = MainLens if optics["type"] == "MainLens" else Microscope
        body["optics"] = build(kind, {k: v for k, v in optics.items() if k != "type"}, "optics")
        if "lattice" in body:
            body["lattice"] = _lattice(body["lattice"])
        if "marks" in body:
            body["marks"] = _marks(body["marks"])
        return build(cls, body, "camera")

    @classmethod
    def from_json(cls, text: str) -> Camera:
        """Return the camera described by ``text``, as returned by `to_json`; the errors are those of `from_dict`."""
        return cls.from_dict(parse_json(text, "camera description"))


def _lattice(entries: Any) -> LensletLattice | PupilLenslets:
    """Return the lenslets that ``entries`` describe; entries without a type (from older versions) are a lattice."""
    kind = entries.get("type", "LensletLattice") if isinstance(entries, Mapping) else "LensletLattice"
    if kind not in ("LensletLattice", "PupilLenslets"):
        raise FileFormatError.expected(
            "camera.lattice", "type LensletLattice or PupilLenslets", kind, "choose one of these types"
        )
    own = {k: v for k, v in entries.items() if k != "type"} if isinstance(entries, Mapping) else entries
    if kind == "PupilLenslets":
        return build(PupilLenslets, own, "camera.lattice")
    return build(LensletLattice, own, "camera.lattice")


def _completed(data: Mapping[str, Any], version: int) -> dict[str, Any]:
    """Return the entries of a description of an older ``version``, completed with the entries that were added later."""
    body = {key: value for key, value in data.items() if key not in ("format", "version")}
    for added in (ADDED[later] for later in ADDED if later > version):
        for part, entries in added.items():
            held = body.get(part) if part else body
            if isinstance(held, Mapping):
                # only missing entries: an older program cannot have written them
                body |= {part: {**entries, **held}} if part else {**entries, **held}
    return body


def _marks(entries: Any) -> Marks:
    if not isinstance(entries, Mapping):
        raise FileFormatError.expected(
            "camera.marks", "an object with named entries", type(entries).__name__, "give an object with named entries"
        )
    return Marks.of(entries)


def build(kind: type[T], data: Any, what: str, *, partial: bool = False) -> T:
    """Return an instance of the dataclass ``kind`` from JSON ``data``, including nested dataclasses and tuples.

    Names and types of the entries are checked. Every entry is required, because a missing entry would silently have its
    default value. With ``partial``, entries of ``kind`` itself may be missing.

    Raises
    ------
    FileFormatError
        If entries are unknown, missing, or of another type; ``what`` names the data in the message.
    InputError
        If ``kind`` does not accept a value.
    """
    if not isinstance(data, Mapping):
        raise FileFormatError.expected(
            what, "an object with named entries", type(data).__name__, 'write the entries in braces: {"name": …}'
        )
    hints = _hints(cast(Any, kind))
    names = {f.name for f in fields(cast(Any, kind))}
    # an unknown entry is an error, because a misspelt one leaves another without a value
    unknown = sorted(set(data) - names)
    if unknown:
        raise FileFormatError.expected(
            what, f"only the entries {', '.join(sorted(names))}", unknown[0], "remove this entry"
        )
    missing = sorted(names - set(data))
    if missing and not partial:
        named = f"the entr{'ies' if len(missing) > 1 else 'y'} {', '.join(map(repr, missing))}"
        raise FileFormatError.expected(what, named, "nothing", "add what is missing")
    return kind(**{name: _value(hints[name], value, f"{what}.{name}") for name, value in data.items()})


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the types of a dataclass's fields; they are cached, because parsing them is slow."""
    return get_type_hints(kind)


_LEAVES: dict[type, tuple[tuple[type, ...], str]] = {
    float: ((float, int), "a number"),
    int: ((int,), "a whole number"),
    str: ((str,), "text"),
    bool: ((bool,), "true or false"),
}


def _value(hint: Any, value: Any, what: str) -> Any:
    origin = get_origin(hint)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise FileFormatError.expected(what, "a list", type(value).__name__, "write the values in square brackets")
        args = get_args(hint)
        inner = args[0] if args else Any
        return tuple(_value(inner, v, what) for v in value)
    # optional entries are written X | None, where X is the type to build
    if origin is UnionType:
        if value is None:
            return None
        options = [a for a in get_args(hint) if a is not type(None)]
        return _value(options[0], value, what) if len(options) == 1 else value
    if isinstance(hint, type) and is_dataclass(hint) and not isinstance(value, hint):
        return build(hint, value, what)
    # in Python, true is an integer; in a file, it is not a number
    if hint in _LEAVES and type(value) not in _LEAVES[hint][0]:
        raise FileFormatError.expected(what, _LEAVES[hint][1], repr(value), "correct this value")
    return value


def nearest_lens(camera: Camera, pixel: tuple[float, float]) -> tuple[float, float]:
    """Return the position ``(row, column)`` of the type-0 micro-image centre nearest to ``pixel`` (sensor pixels).

    For a camera without a lattice, it is the point where the optical axis meets the sensor.
    """
    lattice = camera.lattice
    if isinstance(lattice, PupilLenslets):
        row, column = camera.pixels(lattice.offset_um)
        return float(row), float(column)
    point = camera.sensor_um(pixel)
    # one period in each direction contains at least one lenslet of each type
    reach = max(lattice.period_um)
    centres, types = lattice.lenslets_within(reach, reach, (float(point[0]), float(point[1])))
    centres = centres[types == 0]
    nearest = centres[np.argmin(np.hypot(*(centres - point).T))]
    x, y = (nearest - point) / camera.sensor.pixel_um
    return float(pixel[0] + y), float(pixel[1] + x)
