"""Predict the frame of a known object with the H of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, panel, record, required
from lfcal.tasks._patterns import NO_PLACE, noise_field, own_words
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.fit import Compared, NewFrame

__all__ = ["FIT_OBJECT", "PredictObject", "PredictedObject"]


@dataclass(frozen=True, kw_only=True)
class PredictedObject(TaskResult):
    """Differences between the measured frame of a known object and its prediction (``compared``)."""

    compared: Compared

    def _values(self) -> dict[str, Any]:
        found = self.compared
        error = found.error.to_dict()
        return {"frame": found.label, "error": error, "chi2": found.chi_square.lit, "light": found.gain}


@record
class PredictObject(Task):
    """Predict the frame of a known object with the H of a fit.

    The error of the prediction shows how accurate H is. Nothing is written.

    Examples
    --------
    >>> from lfcal.tasks import PredictObject
    >>> task = PredictObject(fit="fit", frame="frame.tif", scene="object.npy", noise="64,1")
    >>> print(task.scene, task.noise)
    object.npy (64.0, 1.0)
    """

    name: ClassVar[str] = "fit object"

    fit: Path = required("Folder of a fit that contains its H.", argument=True, file="in")
    frame: Path = required("Frame of the known object.", argument=True, file="in")
    scene: Path = required(
        "Volume of the known object (.tif, .h5, .npy), with the depth planes of H and the pixels of the frame.",
        file="in",
    )
    noise: tuple[float, float] | None = noise_field("as stated by the frame")
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def work(self, run: RunSettings | None = None) -> Work[tuple[PredictedObject, ...]]:
        """Project the object through H, and compare the frame with the prediction."""
        from lfcal.fit import read_fits
        from lfcal.judge import ObjectPlace, object_error

        places = [ObjectPlace.of(stored) for stored in read_fits(self.fit).values()]
        shot, volume = self._read(places[0].H)
        yield from ()
        found = object_error(places, shot, volume, self.noise, run.workers if run else None)
        return (PredictedObject(compared=found),)

    def _read(self, H: Path) -> tuple[NewFrame, NDArray[np.float32]]:
        """Return the corrected frame, and the volume of the object."""
        import numpy as np

        from lfcal.frames import corrected_view, open_unplaced
        from lfcal.judge import new_frame, plan_of
        from lfcal.psf import open_psf
        from lfcal.reconstruct import load_volume

        with open_psf(H) as matrix, own_words(without=NO_PLACE), open_unplaced(self.frame) as single:
            view = corrected_view(single, self.corrections, plan_of(matrix))
            if len(view) != 1:
                raise InputError.expected(
                    f"{self.frame}, number of frames", "1", len(view), "give a file with one frame of the object"
                )
            shot, planes = new_frame(view, 0, self.frame.name), matrix.shape[0]
        volume = load_volume(self.scene)
        if volume.shape != (planes, *shot.values.shape):
            wanted = f"shape {(planes, *shot.values.shape)}, the planes of H and the pixels of the frame"
            raise InputError.expected(f"{self.scene}, volume", wanted, f"shape {volume.shape}", "resample the volume")
        if not np.isfinite(volume).all():
            raise InputError.expected(f"{self.scene}, volume", "finite values", "NaN or infinity", "correct the volume")
        if not volume.any():
            raise InputError.expected(
                f"{self.scene}, volume", "a value other than 0", "only zeros", "give another volume"
            )
        return shot, volume


FIT_OBJECT = TaskSet(
    "fit object",
    (PredictObject,),
    lambda given: PredictObject,
    "lfcal fit object fit/ frame.tif --scene object.npy --noise 64,1",
)
