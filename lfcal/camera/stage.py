"""Relation between the axes of a stage and the image of the source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_tuple

__all__ = ["StageAxes"]

AXES = "xyz"
IMAGE_MOVES = ("image right", "image down", "away from the camera")


@dataclass(frozen=True, slots=True)
class StageAxes:
    """Relation between the stage axes, the motion of the image on the sensor, and the depth of the source.

    Attributes
    ----------
    right, down, away
        Stage axes with their signs, such as ``"+x"`` or ``"-z"``. A motion of the stage in these directions moves the
        image towards +column (right) and +row (down) on the sensor, and the source away from the camera. A lens inverts
        the image; the lateral directions are those on the sensor.
    origin_um
        Stage coordinates (x, y, z) (µm) at which the image of the source is at the sensor's centre, and the source is
        in the working plane.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import StageAxes
    >>> stage = StageAxes(right="-x", down="+z", away="+y", origin_um=(100.0, 0.0, 0.0))
    >>> print(stage.to_stage(np.array([10.0, 20.0, 30.0])).tolist())
    [90.0, 30.0, 20.0]
    """

    right: str = "+x"
    down: str = "+y"
    away: str = "+z"
    origin_um: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every value."""
        for move, axis in zip(IMAGE_MOVES, (self.right, self.down, self.away), strict=True):
            if not (isinstance(axis, str) and len(axis) == 2 and axis[0] in "+-" and axis[1] in AXES):
                raise InputError.expected(
                    f"stage axis ({move})", "one of +x, -x, +y, -y, +z and -z", repr(axis), "choose one of these"
                )
        if {self.right[1], self.down[1], self.away[1]} != set(AXES):
            got = f"{self.right}, {self.down}, {self.away}"
            raise InputError.expected(
                "stage axes", "each of x, y and z once", got, "choose a different axis for each move"
            )
        object.__setattr__(self, "origin_um", check_tuple("stage origin (x, y, z) (µm)", self.origin_um, 3))

    @classmethod
    def parse(cls, text: str) -> StageAxes:
        """Return the axes stated by a text such as ``"+x,-y,+z"``, in the order right, down, away."""
        axes = [axis.strip() for axis in text.split(",")]
        if len(axes) != len(AXES):
            raise InputError.expected(
                "stage axes", "three axes, such as +x,-y,+z", repr(text), "give three axes separated by commas"
            )
        right, down, away = axes
        return cls(right, down, away)

    @property
    def words(self) -> str:
        """Axes as text, in the form that `parse` reads."""
        return f"{self.right},{self.down},{self.away}"

    def matrix(self) -> NDArray[np.float64]:
        """Return the signed permutation matrix, ``(3, 3)``, from object (right, down, away) to stage (x, y, z) axes."""
        result = np.zeros((3, 3))
        for column, axis in enumerate((self.right, self.down, self.away)):
            result[AXES.index(axis[1]), column] = 1.0 if axis[0] == "+" else -1.0
        return result

    def to_stage(self, object_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the stage coordinates (x, y, z), ``(..., 3)``, of object points (right, down, away), both in µm."""
        stage: NDArray[np.float64] = object_um @ self.matrix().T + np.array(self.origin_um)
        return stage

    def to_object(self, stage_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the object points (right, down, away), ``(..., 3)``, of stage coordinates (x, y, z), both in µm."""
        # a signed permutation is orthogonal, so its transpose is its inverse
        points: NDArray[np.float64] = (stage_um - np.array(self.origin_um)) @ self.matrix()
        return points
