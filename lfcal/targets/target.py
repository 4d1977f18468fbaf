"""Targets: a point or an array of pinholes, and their notation on the command line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    check_choice,
    check_number,
    check_tuple,
    check_type,
    parse_json,
    stated_format,
)
from lfcal.camera import build
from lfcal.targets.pose import Pose, length_um

__all__ = ["Target", "parse_target", "proposed_hole", "target_words"]

FORMAT = "lfcal-target"
VERSION = 1
KINDS = ("point", "square", "hexagonal")

MOST_HOLES = 100_000
"""Largest number of holes, far more than fit on a sensor, to catch typing errors."""


@dataclass(frozen=True, slots=True)
class Target:
    """Target with point sources in one plane.

    Attributes
    ----------
    kind
        ``"point"``: a single point; ``"square"``: a rectangular grid of holes; ``"hexagonal"``: a grid of which every
        second row is shifted to the right by half a pitch.
    shape
        Number of holes (rows, columns).
    pitch_um
        Distance between neighbouring rows, and between neighbouring holes in a row (µm).
    hole_um
        Diameter of a hole (µm); 0: a point.
    absent
        Labels (row, column), from 0, of holes that are intentionally absent. A complete grid looks like its mirror
        image; absent holes in an asymmetric arrangement show whether the target is reversed.
    pose
        Approximate pose of the target.
    within
        Largest error of each value of `pose`, in the same unit. Plans also report their coverage for random poses
        within these bounds, and the fit of the pose treats each bound as two standard deviations. All 0: the pose is
        assumed to be exact.

    Examples
    --------
    >>> from lfcal.targets import Target
    >>> target = Target("hexagonal", (2, 2), (866.0, 1000.0), hole_um=20.0)
    >>> print(target.flat_um(target.holes).tolist())  # right, down of its middle, µm
    [[-750.0, -433.0], [250.0, -433.0], [-250.0, 433.0], [750.0, 433.0]]
    >>> print(f"{target.nearest_um:.0f} µm to the nearest")
    1000 µm to the nearest
    """

    kind: str = "point"
    shape: tuple[int, int] = (1, 1)
    pitch_um: tuple[float, float] = (0.0, 0.0)
    hole_um: float = 0.0
    absent: tuple[tuple[int, int], ...] = ()
    pose: Pose = field(default=Pose())
    within: Pose = field(default=Pose())

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("target", self.kind, KINDS)
        shape = check_tuple("holes of the target (rows, columns)", self.shape, 2, integer=True, at_least=1)
        object.__setattr__(self, "shape", shape)
        check_number("holes of the target", math.prod(shape), at_most=MOST_HOLES, integer=True)
        pitch = check_tuple("pitch of the target (rows, columns) (µm)", self.pitch_um, 2, at_least=0)
        object.__setattr__(self, "pitch_um", pitch)
        check_number("holes' diameter (µm)", self.hole_um, at_least=0)
        self._check_kind()
        self._check_absent()
        check_type("pose of the target", self.pose, Pose)
        check_type("bounds of the target's pose", self.within, Pose)
        for bound in fields(Pose):
            check_number("bound of the target's pose", getattr(self.within, bound.name), at_least=0)

    def _size(self) -> str:
        return f"{self.shape[0]} x {self.shape[1]} holes"

    def _check_kind(self) -> None:
        if self.kind == "point":
            if self.shape != (1, 1):
                raise InputError.expected("point target", "one hole", self._size(), "describe it as an array")
            return
        for pitch in self.pitch_um:
            check_number(
                "pitch of the target (µm)", pitch, above=self.hole_um, remedy="choose a pitch larger than the holes"
            )
        if math.prod(self.shape) < 2:
            raise InputError.expected("array target", "at least 2 holes", self._size(), "describe it as a point")

    def _check_absent(self) -> None:
        check_type("absent holes", self.absent, (tuple, list))
        holes = tuple(check_tuple("absent hole (row, column)", a, 2, integer=True, at_least=0) for a in self.absent)
        object.__setattr__(self, "absent", holes)
        outside = [hole for hole in holes if hole[0] >= self.shape[0] or hole[1] >= self.shape[1]]
        if outside or len(set(holes)) < len(holes) or len(holes) >= math.prod(self.shape):
            wanted = f"some of the {self._size()} of the array, each once"
            raise InputError.expected(
                "absent holes", wanted, outside[0] if outside else len(holes), "list each absent hole once"
            )

    @property
    def holes(self) -> NDArray[np.intp]:
        """Labels (row, column), from 0, of the holes that are present, row by row, ``(n, 2)``."""
        there = np.ones(self.shape, np.bool_)
        for hole in self.absent:
            there[hole] = False
        return np.argwhere(there)

    def flat_um(self, holes: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the positions (right, down) of holes relative to the middle of the target (µm), ``(n, 2)``.

        They are in the plane of the target, without its pose. ``holes`` contains the labels (row, column), ``(n, 2)``.
        """
        index = np.asarray(holes, float)
        down, right = np.moveaxis(index - (np.array(self.shape) - 1) / 2, -1, 0)
        if self.kind == "hexagonal":
            # a quarter in each direction, so that the middle does not move
            right = right + np.where(index[..., 0] % 2 == 1, 0.25, -0.25)
        return np.stack([right * self.pitch_um[1], down * self.pitch_um[0]], axis=-1)

    @property
    def nearest_um(self) -> float:
        """Smallest distance between neighbouring holes of the complete array (µm); infinite for a point."""
        near = [math.inf]
        rows, columns = self.shape
        lean = 0.5 * self.pitch_um[1] if self.kind == "hexagonal" else 0.0
        near += [self.pitch_um[1]] if columns > 1 else []
        near += [math.hypot(self.pitch_um[0], lean)] if rows > 1 else []
        return min(near)

    # -- JSON ------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain JSON types."""
        return {"format": FORMAT, "version": VERSION, **asdict(self)}

    def to_json(self) -> str:
        """Return the description as JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Target:
        """Return the target described by ``data``, as returned by `to_dict`.

        Raises
        ------
        FileFormatError
            If the format or version differs, or entries are unknown, missing or of another type.
        InputError
            If a value is not allowed.
        """
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            raise FileFormatError.expected(
                "target", f'"format": "{FORMAT}"', stated_format(data), "choose a file that describes a target"
            )
        if data.get("version") != VERSION:
            raise FileFormatError.expected("target", f"version {VERSION}", data.get("version"), "update lfcal")
        return build(cls, {k: v for k, v in data.items() if k not in ("format", "version")}, "target")

    @classmethod
    def from_json(cls, text: str) -> Target:
        """Return the target described by JSON ``text``; errors are those of `from_dict`."""
        return cls.from_dict(parse_json(text, "target"))


EXAMPLE = "write it in the form array:12x12@1.2mm,hole=20um or array:12x12@1.2mm,hex"


def parse_target(text: str) -> Target:
    """Return the target described by ``"point"``, ``"point,hole=50um"`` or ``"array:ROWSxCOLUMNS@PITCH"``.

    ``PITCH`` is one length, or ``ROWxCOLUMN``: the distance between rows, and that between the holes of a row. Lengths
    are in µm unless they end in mm. Options may follow after commas: ``hex``, ``hole=20um``, ``absent=0:0+0:1``
    (row:column of absent holes). A hexagonal array has a single pitch, the distance between neighbouring holes.

    Raises
    ------
    InputError
        If the text is not a valid target.

    Examples
    --------
    >>> from lfcal.targets import parse_target
    >>> target = parse_target("array:12x10@1.2mm,hex,hole=20um")
    >>> print(len(target.holes), "holes, rows", round(target.pitch_um[0]), "µm apart")
    120 holes, rows 1039 µm apart
    """
    head, *more = (part.strip() for part in text.strip().split(","))
    hexagonal, hole, absent = _settings(more)
    if head == "point":
        if hexagonal or absent:
            raise _wrong(text)
        return Target(hole_um=hole)
    match = re.fullmatch(r"array:(\d{1,6})[x×](\d{1,6})@([^x×]+)(?:[x×]([^x×]+))?", head)
    if match is None or (hexagonal and match[4]):
        raise _wrong(text)
    along = length_um(match[4] or match[3])
    across = along * math.sqrt(3) / 2 if hexagonal else length_um(match[3])
    kind = "hexagonal" if hexagonal else "square"
    return Target(kind, (int(match[1]), int(match[2])), (across, along), hole, absent)


def proposed_hole(text: str) -> float | None:
    """Return the diameter of the holes (µm) in the text of an array without a pitch; None for other texts.

    Such texts are ``"array"`` (diameter 0) and ``"array,hole=20um"``; other settings raise `InputError`.
    """
    head, *more = (part.strip() for part in text.strip().split(","))
    if head != "array":
        return None
    hexagonal, hole, absent = _settings(more)
    if hexagonal or absent:
        raise InputError.expected("target", "array or array,hole=20um where the pitch is proposed", repr(text), EXAMPLE)
    return hole


def _settings(parts: list[str]) -> tuple[bool, float, tuple[tuple[int, int], ...]]:
    hexagonal, hole = False, 0.0
    absent: tuple[tuple[int, int], ...] = ()
    names = [part.partition("=")[0] for part in parts]
    if len(set(names)) < len(names):
        raise InputError.expected("target", "each setting once", ", ".join(names), EXAMPLE)
    for part in parts:
        name, _, value = part.partition("=")
        if part == "hex":
            hexagonal = True
        elif name == "hole" and value:
            hole = length_um(value)
        elif name == "absent" and re.fullmatch(r"\d{1,6}:\d{1,6}(\+\d{1,6}:\d{1,6})*", value):
            pairs = (pair.split(":") for pair in value.split("+"))
            absent = tuple((int(row), int(column)) for row, column in pairs)
        else:
            raise InputError.expected("target", "hex, hole=LENGTH or absent=ROW:COLUMN+…", repr(part), EXAMPLE)
    return hexagonal, hole, absent


def _wrong(text: str) -> InputError:
    return InputError.expected("target", "point or array:ROWSxCOLUMNS@PITCH", repr(text), EXAMPLE)


def target_words(target: Target) -> str:
    """Return the text from which `parse_target` creates the target; the pose and its bounds are not included.

    Examples
    --------
    >>> from lfcal.targets import Target, target_words
    >>> print(target_words(Target("square", (12, 10), (1200.0, 1500.0), absent=((0, 0), (0, 1)))))
    array:12x10@1200umx1500um,absent=0:0+0:1
    """
    hole = [f"hole={target.hole_um:.10g}um"] if target.hole_um else []
    marks = ["absent=" + "+".join(f"{row}:{column}" for row, column in target.absent)] if target.absent else []
    if target.kind == "point":
        return ",".join(["point", *hole])
    (rows, columns), (across, along) = target.shape, target.pitch_um
    pitch = f"{along:.10g}um" if target.kind == "hexagonal" or across == along else f"{across:.10g}umx{along:.10g}um"
    kind = ["hex"] if target.kind == "hexagonal" else []
    return ",".join([f"array:{rows}x{columns}@{pitch}", *kind, *hole, *marks])
