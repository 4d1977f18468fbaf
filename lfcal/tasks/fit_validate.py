"""Predict recorded points that were not fitted, with the result of an earlier fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, opt, panel, record, required
from lfcal.tasks._patterns import (
    PatternReading,
    is_matrix,
    iter_patterns,
    names_of,
    noise_field,
    orientation_field,
    positions_field,
)
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.fit import StoredFit, Validation

__all__ = ["FIT_VALIDATE", "ValidateFit", "ValidateFitByFrames", "Validated"]


@dataclass(frozen=True, kw_only=True)
class Validated(TaskResult):
    """Errors of the predictions of a fit for points that were not fitted.

    ``validation`` contains the errors for the points of ``source``, and ``files`` were written. ``name`` is the name of
    the region, or of the other recording; it is empty for a fit of a single region.
    """

    name: str
    validation: Validation
    source: Path
    files: tuple[Path, ...]

    def _values(self) -> dict[str, Any]:
        named = {"name": self.name} if self.name else {}
        return named | self.validation.to_dict() | {"source": self.source, "files": list(self.files)}


@record
class ValidateFit(Task):
    """Predict recorded points of H that were not fitted."""

    name: ClassVar[str] = "fit validate"
    input_words: ClassVar[str] = "H"

    fit: Path = required("Folder of a fit.", argument=True, file="in")
    sources: tuple[Path, ...] = required(
        "Source of the fit (H, a recorded session, or frames), or another recording. For a fit of several regions: the "
        "source of each region. Positions of the source that were fitted are left out.",
        argument=True,
        file="in",
    )
    other: bool = opt(
        False,
        "Treat the source as another recording, and predict all its points.",
        label="Another recording",
    )
    positions: int | None = positions_field("Number of positions to predict, spread evenly. 0 predicts all positions.")
    noise: tuple[float, float] | None = noise_field()

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        Both include files in the folder of the fit.
        """
        from lfcal.fit import numbers_file, validation_outputs

        if way == "out":
            return tuple(path for _, folder, _ in self._parts() for path in validation_outputs(folder))
        return (*self.sources, *((one,) if (one := numbers_file(self.fit)) else ()))

    def work(self, run: RunSettings | None = None) -> Work[tuple[Validated, ...]]:
        """Predict the points of each source, and write the errors and a plot.

        They are written to the folder of the fit, or to that of the region if the sources are regions of the fit.
        """
        from lfcal.fit import iter_write_validation, validation_outputs

        made, patterns, parts = [], [], self._parts()
        # unreadable input must raise an error before anything is written
        for source, (_, _, stored) in zip(self.sources, parts, strict=True):
            patterns.append((yield from iter_patterns(source, self._reading(None if self.other else stored)))[0])
        for source, measured, (name, folder, stored) in zip(self.sources, patterns, parts, strict=True):
            found = yield from iter_write_validation(stored, measured, folder, source.name, another=self.other)
            made.append(Validated(name=name, validation=found, source=source, files=validation_outputs(folder)))
        return tuple(made)

    def _reading(self, stored: StoredFit | None) -> PatternReading:
        return PatternReading(most=self.positions, noise=self.noise, fit=stored)

    def _parts(self) -> list[tuple[str, Path, StoredFit]]:
        """Return the name, the output folder and the fit for each source."""
        from lfcal.fit import read_fits

        fits, names = read_fits(self.fit), names_of(self.sources)
        if self.other or "" in fits:
            if len(names) != 1:
                raise InputError.expected("sources", "one recording", len(names), "validate each recording separately")
            first = next(iter(fits.values()))
            if "" in fits:
                return [("", self.fit, first)]
            # elsewhere in the field, use the camera that all regions share, without the displacement found for one
            # region
            there = replace(first, setup=replace(first.setup, aside_px=(0.0, 0.0)), stage_scale=0.0)
            return [(names[0], self.fit, there)]
        wrong = next((name for name in names if name not in fits), None)
        if wrong is not None:
            remedy = "give the source of a region, or state that it is another recording (--other)"
            raise InputError.expected("sources", f"the regions of the fit: {', '.join(fits)}", wrong, remedy)
        return [(name, self.fit / name, fits[name]) for name in names]


@record
class ValidateFitByFrames(ValidateFit):
    """Predict recorded points that were not fitted.

    The error of each point is written into the folder of the fit. For a fit of several regions, give the source of
    each region; the name of the source must be that of the region.

    Examples
    --------
    >>> from lfcal.tasks import ValidateFit, ValidateFitByFrames
    >>> task = ValidateFitByFrames(fit="fit", sources="session", other=True)
    >>> print(task.sources, task.corrections.dark == "")
    (PosixPath('session'),) True
    >>> other = ValidateFit(fit="fit", sources="H.h5", positions=60)
    """

    input_words: ClassVar[str] = "frames"

    plan: Path | None = opt(
        None, "Scan plan (.json) of the frames.", short="-p", file="in", empty="stored with the frames"
    )
    orientation: str = orientation_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def _reading(self, stored: StoredFit | None) -> PatternReading:
        how = super()._reading(stored)
        return replace(how, plan=self.plan, recipe=self.corrections, orientation=self.orientation)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that predicts the points of the ``given`` source."""
    return ValidateFit if all(map(is_matrix, map(Path, given["sources"]))) else ValidateFitByFrames


FIT_VALIDATE = TaskSet(
    "fit validate", (ValidateFitByFrames, ValidateFit), kind_of, "lfcal fit validate fit/ session/ --positions 60"
)
