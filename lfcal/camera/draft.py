"""Incomplete camera: values are added as they become known, each with its origin."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from lfcal.base import InputError, choose
from lfcal.camera.description import Camera, Marks
from lfcal.camera.distortion import BrownDistortion
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope, Optics
from lfcal.camera.pupil_lenslets import PupilLenslets
from lfcal.camera.quantities import QUANTITIES, quantities_of
from lfcal.camera.sensor import Sensor

__all__ = ["Draft"]

FOCUS, RANGES = "lattice.focus", "lattice.depth_ranges"
PATHS = {quantity.path for quantity in QUANTITIES} | {FOCUS, RANGES}

# a microscope's camera rarely has the sensor of a plenoptic one; both are assumptions and marked as such
MICROSCOPE_SENSOR: dict[str, Any] = {"shape": (2048, 2048), "pixel_um": 6.5, "bit_depth": 16, "read_noise_e": 1.5}
MICROSCOPE_PITCH_UM = 125.0
FOURIER_UM, LENSLET_UM = 150e3, 60e3
KINDS: dict[str, tuple[type[Optics], type[LensletLattice | PupilLenslets], str]] = {
    "MainLens": (MainLens, LensletLattice, "a main lens"),
    "Microscope": (Microscope, LensletLattice, "a microscope"),
    "FourierMicroscope": (Microscope, PupilLenslets, "a Fourier light-field microscope"),
}
"""Kinds of cameras: their optics, their lenslets, and their name in messages."""
SEEN_IN_PIXELS = tuple(f"lattice.{n}" for n in ("pitch_um", "row_pitch_um", "offset_um", "clear_um", "distortion"))


class Draft:
    """Incomplete camera description, whose missing values are assumed when a camera is created from it.

    A value is identified by its path, such as ``"sensor.pixel_um"``. The first value set for a path is kept. Values
    that are not set are assumed and marked as such.

    Two paths are added to those of `QUANTITIES`. The value of ``lattice.focus`` is the virtual depth at which each lens
    type is in focus. That of ``lattice.depth_ranges`` is a pair of virtual depths (near, far) for each lens type. The
    value of ``lattice.types`` is the focal length of each lens type (µm).

    Parameters
    ----------
    kind
        Kind of camera: ``"MainLens"``, ``"Microscope"`` or ``"FourierMicroscope"``.
    given
        Values stated by the user, by path; values set later with `put` do not replace them.

    Raises
    ------
    InputError
        If a camera of this kind has no value at one of the given paths.

    Examples
    --------
    >>> from lfcal.camera import Draft
    >>> draft = Draft("MainLens", {"optics.focal_length_um": 50e3, "sensor.pixel_um": 5.5})
    >>> draft.put("lattice.pitch_um", 60.5, "measured")
    >>> camera = draft.camera("mine")
    >>> print(camera.optics.focal_length_um, camera.lattice.pitch_um, round(camera.lattice.gap_um, 1))
    50000.0 60.5 254.7
    >>> print(camera.marks["optics.focal_length_um"], camera.marks["lattice.pitch_um"], camera.marks["lattice.gap_um"])
    stated measured assumed
    """

    def __init__(self, kind: str, given: Mapping[str, Any] | None = None) -> None:
        self._kind, self._lenslets, self._title = KINDS[kind]
        self._values: dict[str, tuple[Any, str]] = {}
        self.distortion: BrownDistortion | None = None
        for path, value in (given or {}).items():
            self.put(path, value)

    @classmethod
    def of(cls, camera: Camera, given: Mapping[str, Any]) -> Draft:
        """Return a draft with the values of ``camera``, except those that ``given`` replaces (by path).

        Lattices are measured in pixels. Their derived or measured lengths are therefore scaled if ``given`` changes the
        pixel pitch. A gap that was assumed is assumed again. Lens types whose focal lengths were assumed, or whose gap
        is in ``given``, remain in focus at the same virtual depths.
        """
        draft = cls(type(camera.optics).__name__ if camera.has_lattice else "FourierMicroscope", given)
        draft.distortion = camera.distortion
        marks, scale = camera.marks, 1.0
        if "sensor.pixel_um" in given:
            scale = given["sensor.pixel_um"] / camera.sensor.pixel_um
        for part in ("optics", "lattice", "sensor"):
            held = getattr(camera, part)
            for field in fields(held):
                path = f"{part}.{field.name}"
                value, mark = getattr(held, field.name), marks[path]
                if path == "lattice.types" or (path == "lattice.gap_um" and mark == "assumed"):
                    continue
                if path in SEEN_IN_PIXELS and mark in ("derived", "measured"):
                    value = _scaled(value, scale)
                # also values that users do not state, such as a measured distortion
                draft._values.setdefault(path, (value, mark))
        for path in ("wavelength_um", "bandwidth_um"):
            draft.put(path, getattr(camera, path), marks[path])
        if isinstance(camera.lattice, LensletLattice):
            draft._put_types(camera.lattice, camera.marks, given)
        return draft

    def _put_types(self, lattice: LensletLattice, marks: Marks, given: Mapping[str, Any]) -> None:
        mark = marks["lattice.types"]
        if any(kind.depth_range for kind in lattice.types):
            self.put(RANGES, tuple(kind.depth_range for kind in lattice.types), marks[RANGES])
        if mark == "assumed" or "lattice.gap_um" in given:  # types keep the virtual depth that is in focus
            self.put(FOCUS, tuple(kind.focus_depth(lattice.gap_um) for kind in lattice.types), mark)
        else:
            self.put("lattice.types", tuple(kind.focal_length_um for kind in lattice.types), mark)

    def put(self, path: str, value: Any, mark: str = "stated") -> None:
        """Set the value at ``path`` and its mark unless a value is already set; a ``value`` of None is ignored.

        Raises
        ------
        InputError
            If a camera of this kind has no value at ``path``.
        """
        if path not in PATHS or not self._has(path):
            known = [own for own in sorted(PATHS) if self._has(own)]
            part = path.rpartition(".")[0] + "."
            near = [own for own in known if own.startswith(part)] or known
            wanted = f"an entry of {self._title} ({', '.join(near)})"
            raise InputError.expected("entry of a camera", wanted, path, choose(path, near))
        if value is not None:
            self._values.setdefault(path, (value, mark))

    def _has(self, path: str) -> bool:
        """Return whether such a camera has a value at ``path``."""
        part, _, name = path.rpartition(".")
        if part == "lattice":
            own = {"focus", "depth_ranges"} if self._lenslets is LensletLattice else set()
            return name in own | {f.name for f in fields(self._lenslets)}
        return part != "optics" or name in {f.name for f in fields(self._kind)}

    def state(self, path: str, value: Any) -> None:
        """Set the value at ``path`` with the mark ``"stated"``, replacing the current value.

        A value at ``lattice.focus`` also removes that at ``lattice.types``.
        """
        self.withdraw(path)
        self.put(path, value)
        if path == FOCUS:
            self.withdraw("lattice.types")

    def withdraw(self, path: str) -> None:
        """Remove the value at ``path``, so that it is assumed."""
        self._values.pop(path, None)

    def get(self, path: str) -> Any:
        """Return the value that is set at ``path``; if there is none, the default of the optics, lattice or sensor.

        For the lenslets of a Fourier light-field microscope, this default is the value that `camera` would assume.
        """
        if path in self._values:
            return self._values[path][0]
        part, _, name = path.rpartition(".")
        if part == "lattice" and self._lenslets is PupilLenslets:
            return getattr(self.copy()._in_a_pupil(self._build("optics")), name)
        return getattr(self._build(part), name)

    def mark(self, path: str) -> str:
        """Return the mark of the value at ``path``; ``"assumed"`` if no value is set."""
        return self._values.get(path, (None, "assumed"))[1]

    def camera(self, name: str) -> Camera:
        """Return the completed camera with the display name ``name`` and a mark for every value.

        If the gap of a periodic array is unknown, it is assumed to be the pitch times the working f-number, at which
        adjacent micro-images just touch. If the focus is unknown, each lens type is in focus at the virtual depth with
        equal blur at both ends of its depth range. Without depth ranges, there is one lens type, focused at infinity.

        Raises
        ------
        InputError
            If a value is invalid.
        """
        return self.copy()._complete(name)  # values assumed now may be stated later

    def copy(self) -> Draft:
        """Return an independent copy of the draft."""
        other = copy.copy(self)
        other._values = dict(self._values)
        return other

    def _complete(self, name: str) -> Camera:
        optics, sensor = self._build("optics"), self._build("sensor")
        if self._lenslets is PupilLenslets:
            lattice: LensletLattice | PupilLenslets = self._in_a_pupil(optics)
            mark = ""
        else:
            lattice, mark = self._lattice(optics)
        light = self._put_under("", {"wavelength_um", "bandwidth_um"})
        camera = Camera(name, optics, lattice, sensor, distortion=self.distortion, **light)
        return replace(camera, marks=self._marks(camera, mark))

    def _in_a_pupil(self, optics: Microscope) -> PupilLenslets:
        """Return the lenslets in a pupil plane; unknown centres are assumed to be those of seven adjacent lenslets."""
        self.put("lattice.fourier_um", FOURIER_UM, "assumed")
        focal = self._values.get("lattice.focal_lengths_um")
        self.put("lattice.gap_um", LENSLET_UM if focal is None else focal[0][0], "assumed")
        self.put("lattice.focal_lengths_um", (self.get("lattice.gap_um"),), "assumed")
        across = 2 * optics.numerical_aperture * self.get("lattice.fourier_um") / optics.magnification / 3
        angles = [k * math.pi / 3 for k in range(6)]
        ring = ((round(across * math.cos(a), 3), round(across * math.sin(a), 3)) for a in angles)
        self.put("lattice.lens_centres_um", ((0.0, 0.0), *ring), "assumed")
        known = self._put_under("lattice", {f.name for f in fields(PupilLenslets)} - {"clear_um"})
        apart = PupilLenslets(**known, clear_um=across).spacing_um
        self.put("lattice.clear_um", apart if math.isfinite(apart) else across, "assumed")
        return PupilLenslets(**known, **self._put_under("lattice", {"clear_um"}))

    def _lattice(self, optics: Optics) -> tuple[LensletLattice, str]:
        """Return the lenslet lattice, and the mark of its lens types."""
        pitch = MICROSCOPE_PITCH_UM if self._kind is Microscope else LensletLattice().pitch_um
        self.put("lattice.pitch_um", pitch, "assumed")
        self.put("lattice.gap_um", self.get("lattice.pitch_um") * optics.working_f_number, "assumed")
        types, mark = self._types()
        own = {f.name for f in fields(LensletLattice)} - {"types"}
        return LensletLattice(types=types, **self._put_under("lattice", own)), mark

    def _build(self, part: str) -> Any:
        kind = self._kind if part == "optics" else Sensor if part == "sensor" else LensletLattice
        assumed = MICROSCOPE_SENSOR if kind is Sensor and self._kind is Microscope else {}
        return kind(**{**assumed, **self._put_under(part, {f.name for f in fields(kind)})})

    def _put_under(self, part: str, names: set[str]) -> dict[str, Any]:
        start = f"{part}." if part else ""
        return {n: self._values[start + n][0] for n in names if start + n in self._values}

    def _types(self) -> tuple[tuple[LensType, ...], str]:
        """Return the lens types and their mark."""
        gap, ranges = self.get("lattice.gap_um"), self._values.get(RANGES, ((), ""))[0]
        if "lattice.types" in self._values:
            lengths, mark = self._values["lattice.types"]
            ranges = ranges if len(ranges) == len(lengths) else (None,) * len(lengths)
            return tuple(LensType(f, own) for f, own in zip(lengths, ranges, strict=True)), mark
        # choose equal blur at both ends of the range: blur is proportional to |1/v - 1/v_focus|
        middle = tuple(2.0 / (1.0 / near + 1.0 / far) for near, far in ranges) if all(ranges) else ()
        self.put(FOCUS, middle or (math.inf,), "derived" if middle else "assumed")
        focus, mark = self._values[FOCUS]
        ranges = ranges if len(ranges) == len(focus) else (None,) * len(focus)
        types = tuple(LensType.focused_at(v, gap, own) for v, own in zip(focus, ranges, strict=True))
        # focal lengths depend on the gap, and are no more reliable than it
        return types, "assumed" if self.mark("lattice.gap_um") == "assumed" else mark

    def _marks(self, camera: Camera, types: str) -> Marks:
        marks = {path: self.mark(path) for path in (RANGES, "lattice.distortion") if self._values.get(path, (None,))[0]}
        if camera.has_lattice:
            marks["lattice.types"] = types
        for quantity in quantities_of(camera):
            if quantity.path != "lattice.types":
                marks[quantity.path] = self.mark(quantity.path)
        return Marks.of(marks)


def _scaled(value: Any, scale: float) -> Any:
    """Return a length, or an object with lengths, multiplied by ``scale``."""
    if value is None:
        return None
    if isinstance(value, tuple):
        return tuple(v * scale for v in value)
    return value * scale if isinstance(value, int | float) else value.scaled(scale)
