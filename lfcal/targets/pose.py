"""Pose of a target in front of the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, check_number

__all__ = ["Pose", "length_um"]

MOST_TILT_RAD = math.radians(60.0)
"""Largest tilt (rad); beyond it, holes are hardly visible and their images do not form a lattice."""

DEGREES = {"rotation": "rotation_rad", "tilt_right": "tilt_right_rad", "tilt_down": "tilt_down_rad"}
LENGTHS = {"right": "right_um", "down": "down_um", "away": "away_um"}
UNITS = {"um": 1.0, "µm": 1.0, "mm": 1e3}


@dataclass(frozen=True, slots=True)
class Pose:
    """Position and rotation of a target, or bounds of their errors.

    Positions are object points (right, down, away) as in `lfcal.camera.ScanPlan.object_um`. Right and down are relative
    to the optical axis, in the directions in which the image moves. Away is relative to the depth plane, positive away
    from the camera.

    Attributes
    ----------
    rotation_rad
        Rotation of the target in its plane (rad), positive from right towards down.
    tilt_right_rad, tilt_down_rad
        Tilts of the target (rad); positive if its right side or its lower side is farther away. They are applied after
        the rotation, the tilt to the right first.
    right_um, down_um, away_um
        Position of the target's middle (µm).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.targets import Pose
    >>> pose = Pose.parse("rotation=90,away=0.5mm")
    >>> print(np.abs(pose.points(np.array([[100.0, 0.0]]))).round(3).tolist())  # from right of the middle to below, µm
    [[0.0, 100.0, 500.0]]
    """

    rotation_rad: float = 0.0
    tilt_right_rad: float = 0.0
    tilt_down_rad: float = 0.0
    right_um: float = 0.0
    down_um: float = 0.0
    away_um: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("rotation of the target (rad)", self.rotation_rad, at_least=-math.pi, at_most=math.pi)
        for name in ("tilt_right_rad", "tilt_down_rad"):
            check_number("tilt of the target (rad)", getattr(self, name), above=-MOST_TILT_RAD, below=MOST_TILT_RAD)
        for name in LENGTHS.values():
            check_number("position of the target (µm)", getattr(self, name))

    @classmethod
    def parse(cls, text: str) -> Pose:
        """Return the pose in a text such as ``"rotation=1,tilt_right=2,right=0.3mm"``.

        Angles are in degrees, and lengths in µm unless they end in mm.

        Raises
        ------
        InputError
            If a name or a number is invalid, or a name is repeated.
        """
        found: dict[str, float] = {}
        for part in filter(None, (piece.strip() for piece in text.split(","))):
            name, _, value = (piece.strip() for piece in part.partition("="))
            if name not in DEGREES and name not in LENGTHS:
                raise InputError.expected(
                    "pose",
                    any_of([*DEGREES, *LENGTHS]),
                    repr(part),
                    "write one of these names, = and its value: rotation=1",
                )
            key = DEGREES.get(name) or LENGTHS[name]
            if key in found:
                raise InputError.expected("pose", "each value once", repr(name), "remove the repetition")
            found[key] = _angle_rad(name, value) if name in DEGREES else length_um(value)
        return cls(**found)

    @property
    def words(self) -> str:
        """Text from which `parse` creates the same pose to 10 digits; values of 0 are omitted."""
        turns = [f"{name}={math.degrees(getattr(self, key)):.10g}" for name, key in DEGREES.items()]
        places = [f"{name}={getattr(self, key):.10g}" for name, key in LENGTHS.items()]
        return ",".join(one for one in (*turns, *places) if not one.endswith("=0"))

    def points(self, flat_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the object points (right, down, away) ``(..., 3)`` (µm) of points ``flat_um`` on the target.

        ``flat_um`` contains coordinates (right, down) relative to the middle of the target (µm), ``(..., 2)``.
        """
        middle = np.array([self.right_um, self.down_um, self.away_um])
        placed: NDArray[np.float64] = flat_um @ self.turn()[:, :2].T + middle
        return placed

    def turn(self) -> NDArray[np.float64]:
        """Return the rotation matrix ``(3, 3)`` from the axes of the target to (right, down, away) in object space."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        flat = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        c, s = math.cos(self.tilt_right_rad), math.sin(self.tilt_right_rad)
        right = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        c, s = math.cos(self.tilt_down_rad), math.sin(self.tilt_down_rad)
        down = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        turn: NDArray[np.float64] = down @ right @ flat
        return turn

    def off_by(self, within: Pose, shares: NDArray[np.float64]) -> Pose:
        """Return this pose plus the fractions ``shares`` ``(6,)``, in attribute order, of the bounds ``within``."""
        names = [field.name for field in fields(self)]
        moved = [getattr(self, n) + s * getattr(within, n) for n, s in zip(names, shares.tolist(), strict=True)]
        return Pose(*moved)

    @property
    def known(self) -> bool:
        """Whether all values are 0.

        For a `Pose` that contains bounds, this means that the bounded pose is known exactly.
        """
        return not any(getattr(self, field.name) for field in fields(self))


def length_um(text: str) -> float:
    """Return a length in µm from a text such as ``"1.2mm"``, ``"20um"`` or a plain number of µm."""
    for unit, factor in UNITS.items():
        if text.endswith(unit):
            return factor * _number(text.removesuffix(unit))
    return _number(text)


def _angle_rad(name: str, text: str) -> float:
    """Return an angle (rad) from a text in degrees; messages state its limits in degrees."""
    angle, what = _number(text), f"{name} (degrees)"
    if name == "rotation":
        check_number(what, angle, at_least=-180, at_most=180)
    else:
        most = math.degrees(MOST_TILT_RAD)
        check_number(what, angle, above=-most, below=most)
    return math.radians(angle)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError.expected(
            "number in the target",
            "a number, or a length in um or mm",
            repr(text),
            "write it in the form 12, 20um or 1.2mm",
        )
    return value
