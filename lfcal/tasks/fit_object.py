"""The frame of a known object, predicted by H of a fit, or by H of each region of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, panel, record, required
from lfcal.tasks._patterns import noise_field
from lfcal.tasks.fit_check import new_frame, single_frames
from lfcal.tasks.fit_validate import error_dict, fits_of
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.fit import Compared, NewFrame, StoredFit

__all__ = ["FIT_OBJECT", "ObjectPlace", "PredictObject", "PredictedObject", "nearest", "object_error"]


@dataclass(frozen=True, kw_only=True)
class PredictedObject(TaskResult):
    """The frame of a known object, compared with its prediction."""

    compared: Compared

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        found = self.compared
        error = error_dict(found.error)
        return {"frame": found.label, "error": error, "chi2": found.chi_square.lit, "light": found.gain}


@record
class PredictObject(Task):
    """Predict the frame of a known object by H of a fit.

    The error of the prediction shows how well H holds. Nothing is written.

    Examples
    --------
    >>> from lfcal.tasks import PredictObject
    >>> task = PredictObject(fit="fit", frame="frame.tif", scene="object.npy", noise="64,1")
    >>> print(task.scene, task.noise)
    object.npy (64.0, 1.0)
    """

    name: ClassVar[str] = "fit object"

    fit: Path = required("Folder of a fit, with its H.", argument=True, file="in")
    frame: Path = required("Frame of the known object.", argument=True, file="in")
    scene: Path = required("The known object: a volume (.tif, .h5, .npy) of the planes of H.", file="in")
    noise: tuple[float, float] | None = noise_field("as the frame states")
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def work(self, run: RunSettings | None = None) -> Work[tuple[PredictedObject, ...]]:
        """Project the object by H, and compare the frame with it."""
        places = [ObjectPlace.of(stored) for stored in fits_of(self.fit).values()]
        shot, volume = self._read(places[0].H)
        yield from ()
        found = object_error(places, shot, volume, self.noise, run.workers if run else None)
        return (PredictedObject(compared=found),)

    def _read(self, H: Path) -> tuple[NewFrame, NDArray[np.float32]]:
        """Return the frame of the object, corrected, and the object."""
        import numpy as np

        from lfcal.frames import corrected_view
        from lfcal.judge import plan_of
        from lfcal.psf import open_psf
        from lfcal.reconstruct import load_volume

        with open_psf(H) as matrix, ExitStack() as stack:
            view = corrected_view(single_frames(self.frame, stack), self.corrections, plan_of(matrix))
            if len(view) != 1:
                raise InputError.expected(f"{self.frame}, frames", "one", len(view), "name the frame of the object")
            shot, planes = new_frame(view, 0, None, None, self.frame.name), matrix.shape[0]
        volume = load_volume(self.scene)
        if volume.shape != (planes, *shot.values.shape):
            wanted = f"{(planes, *shot.values.shape)}: the planes of H, the pixels of the frame"
            raise InputError.expected(f"{self.scene}, volume", wanted, volume.shape, "resample it")
        if not np.isfinite(volume).all() or not volume.any():
            raise InputError.expected(f"{self.scene}, volume", "finite values, some above 0", "others", "correct it")
        return shot, volume


@dataclass(frozen=True, eq=False)
class ObjectPlace:
    """Where H holds.

    Attributes
    ----------
    H
        Its file.
    middle_px
        The middle (row, column) of its scan on the sensor.
    gains
        Light of each of its planes: regions may have been recorded in other light.
    """

    H: Path
    middle_px: tuple[float, float]
    gains: tuple[float, ...]

    @classmethod
    def of(cls, fit: StoredFit) -> ObjectPlace:
        """Return the place of the H in a fit's folder.

        Raises
        ------
        InputError
            If it was fitted without H.
        """
        from lfcal.fit import MODEL

        H = fit.folder / MODEL
        if not H.is_file():
            raise InputError.expected(str(H), "H of the fit", "none", "fit again, and let H be written")
        row, column = (a + (n - 1) / 2 for a, n in zip(fit.anchor, fit.period, strict=True))
        return cls(H, (row, column), tuple(map(float, fit.gains)))


def nearest(places: Sequence[ObjectPlace], shape: tuple[int, int], origin: tuple[float, float]) -> NDArray[np.intp]:
    """Return for each pixel ``(rows, columns)`` of a frame the number of the place whose middle is nearest.

    ``origin`` is the frame's first pixel (row, column) on the sensor.
    """
    import numpy as np

    rows, columns = (np.arange(n) + o for n, o in zip(shape, origin, strict=True))
    away = [np.add.outer((rows - r) ** 2, (columns - c) ** 2) for r, c in (one.middle_px for one in places)]
    found: NDArray[np.intp] = np.argmin(away, axis=0)
    return found


def object_error(
    places: Sequence[ObjectPlace],
    shot: NewFrame,
    volume: NDArray[np.float32],
    given: tuple[float, float] | None,
    workers: int | None,
) -> Compared:
    """Compare a known object's frame with its prediction, of each point of the object by the H that is nearest.

    One period is taken to be like the next only from a point to the nearest region.
    """
    import numpy as np

    from lfcal.fit import predicted_frame
    from lfcal.psf import open_psf
    from lfcal.reconstruct import Projector

    noise = given or shot.noise
    if noise is None:
        raise InputError.expected(f"{shot.label}, noise", "a variance of its samples", "none", "state it (--noise)")
    rows, columns = shot.values.shape
    near = nearest(places, (rows, columns), shot.origin)
    common = np.mean([one.gains for one in places], axis=0)
    light, cutout = np.zeros((rows, columns)), (1, 1)
    for k, one in enumerate(places):
        # in one light: what a region was recorded in is no property of the camera
        scale = (common / np.array(one.gains)).astype(np.float32)
        own = np.where(near == k, volume, np.float32(0)) * scale[:, None, None]
        with open_psf(one.H) as matrix:
            cutout = matrix.cutout
            if own.any():
                row, column = (a - o for a, o in zip(matrix.anchor, shot.origin, strict=True))
                light += Projector(matrix, (rows, columns), (row, column), workers=workers).forward(own)
    return predicted_frame(light, shot, noise, cutout)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the only kind."""
    return PredictObject


FIT_OBJECT = TaskSet(
    "fit object", (PredictObject,), kind_of, "lfcal fit object fit/ frame.tif --scene object.npy --noise 64,1"
)
