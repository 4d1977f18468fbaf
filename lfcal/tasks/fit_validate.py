"""Recorded points that were not fitted, predicted by a fit in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import FileFormatError, InputError, Work
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
    from lfcal.fit import Measured, ModelError, PointError, StoredFit, Validation

__all__ = ["FIT_VALIDATE", "ValidateFit", "ValidateFitByFrames", "Validated", "error_dict", "fits_of"]

VALIDATION = ("validation.json", "report/validation.png")
"""What is written into the folder of a fit."""

TITLE = "Points that were not fitted"
CAPTION = "Error of each point that was not fitted: over the sensor, and from the middle of the field to its edge."


@dataclass(frozen=True, kw_only=True)
class Validated(TaskResult):
    """How well a fit predicts points that were not fitted.

    Attributes
    ----------
    name
        Of the region, or of the other recording; empty: the fit is of one region.
    validation
        The points, and what they show.
    source
        Where they were recorded.
    files
        What was written.
    """

    name: str
    validation: Validation
    source: Path
    files: tuple[Path, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        named = {"name": self.name} if self.name else {}
        return named | validation_dict(self.validation) | {"source": self.source, "files": list(self.files)}


@record
class ValidateFit(Task):
    """Predict recorded points of H that were not fitted.

    Examples
    --------
    >>> from lfcal.tasks import ValidateFit
    >>> task = ValidateFit(fit="fit", sources="H.h5", positions=60)
    >>> print(task.sources, task.other)
    (PosixPath('H.h5'),) False
    """

    name: ClassVar[str] = "fit validate"
    input_words: ClassVar[str] = "H"

    fit: Path = required("Folder of a fit.", argument=True, file="in")
    sources: tuple[Path, ...] = required(
        "What was fitted: H, recorded session, or frames. Positions that were fitted are left out.",
        argument=True,
        file="in",
    )
    other: bool = opt(
        False,
        "The source is another recording, of the same places or others: all its points are predicted.",
        label="Another recording",
    )
    positions: int | None = positions_field("Number of positions to predict, spread evenly; 0 predicts all.")
    noise: tuple[float, float] | None = noise_field()

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files: those of the fit are in its folder, and so are those that are written."""
        if way == "out":
            return tuple(folder / name for _, folder, _ in self._parts() for name in VALIDATION)
        return (*self.sources, *((one,) if (one := _numbers(self.fit)) else ()))

    def work(self, run: RunSettings | None = None) -> Work[tuple[Validated, ...]]:
        """Predict the points, of each region in turn."""
        made, patterns = [], []
        # what cannot be read ends this before anything is written
        for source, (_, _, stored) in zip(self.sources, self._parts(), strict=True):
            patterns.append((yield from iter_patterns(source, self._reading(None if self.other else stored)))[0])
        for source, measured, (name, folder, stored) in zip(self.sources, patterns, self._parts(), strict=True):
            made.append((yield from self._iter_one(source, measured, name, folder, stored)))
        return tuple(made)

    def _reading(self, stored: StoredFit | None) -> PatternReading:
        return PatternReading(most=self.positions, noise=self.noise, fit=stored)

    def _parts(self) -> list[tuple[str, Path, StoredFit]]:
        """Return for each source its name, the folder to write into, and the fit of its place."""
        fits, names = fits_of(self.fit), names_of(self.sources)
        if self.other or "" in fits:
            if len(names) != 1:
                raise InputError.expected("sources", "one recording", len(names), "name one")
            first = next(iter(fits.values()))
            if "" in fits:
                return [("", self.fit, first)]
            # anywhere else in the field the camera is that of all regions, without the displacement of one of them
            there = replace(first, setup=replace(first.setup, aside_px=(0.0, 0.0)), stage_scale=0.0)
            return [(names[0], self.fit, there)]
        wrong = next((name for name in names if name not in fits), None)
        if wrong is not None:
            remedy = "name its source, or say that it is another recording (--other)"
            raise InputError.expected("sources", f"regions of the fit: {', '.join(fits)}", wrong, remedy)
        return [(name, self.fit / name, fits[name]) for name in names]

    def _iter_one(
        self, source: Path, measured: Measured, name: str, folder: Path, stored: StoredFit
    ) -> Work[Validated]:
        """Predict points, and write numbers and picture into a folder."""
        from lfcal.fit import add_picture, draw_validation, iter_validate, json_text, write_text

        found = yield from iter_validate(stored, measured, another=self.other)
        numbers, picture = files = tuple(folder / one for one in VALIDATION)
        picture.parent.mkdir(parents=True, exist_ok=True)
        draw_validation(found, picture)
        add_picture(picture.parent, TITLE, found.verdict, picture, CAPTION)
        write_text(numbers, json_text(validation_dict(found) | {"source": source.name}))
        return Validated(name=name, validation=found, source=source, files=files)


@record
class ValidateFitByFrames(ValidateFit):
    """Predict recorded points that were not fitted.

    The error of each is written into the folder of the fit. Of a fit of several regions give their sources, which have
    the names of the regions.

    Examples
    --------
    >>> from lfcal.tasks import ValidateFitByFrames
    >>> task = ValidateFitByFrames(fit="fit", sources="session", other=True)
    >>> print(task.sources, task.corrections.dark == "")
    (PosixPath('session'),) True
    """

    input_words: ClassVar[str] = "frames"

    plan: Path | None = opt(None, "Scan plan (.json) of the frames.", short="-p", file="in", empty="with the frames")
    orientation: str = orientation_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def _reading(self, stored: StoredFit | None) -> PatternReading:
        how = super()._reading(stored)
        return replace(how, plan=self.plan, recipe=self.corrections, orientation=self.orientation)


def _numbers(folder: Path) -> Path | None:
    """Return the file with the numbers of a fit, which is written last."""
    from lfcal.fit import FIELD, NUMBERS

    return next((folder / name for name in (FIELD, NUMBERS) if (folder / name).is_file()), None)


def fits_of(folder: Path) -> dict[str, StoredFit]:
    """Return the fit in a folder, by the name of its region where there are several, else by an empty name.

    Raises
    ------
    StorageError, FileFormatError, InputError
        If a file is not there, or is no such file.
    """
    from lfcal.base import parse_json, read_text
    from lfcal.fit import FIELD, read_fit

    path = _numbers(folder)
    if path is None or path.name != FIELD:
        return {"": read_fit(folder)}
    found = parse_json(read_text(path), str(path), remedy="run lfcal fit again")
    regions = found.get("regions") if isinstance(found, dict) else None
    listed = regions if isinstance(regions, list) else []
    names = [str(one["name"]) for one in listed if isinstance(one, dict) and "name" in one]
    # a file from elsewhere must not lead out of its folder
    if not names or not all(Path(name).name == name for name in names):
        raise FileFormatError.expected(str(path), "a fit of regions", "another file", "run lfcal fit again")
    return {name: read_fit(folder / name) for name in names}


def validation_dict(found: Validation) -> dict[str, Any]:
    """Return what was found as plain types: errors of the fitted camera, and of H taken as periodic."""
    parts = {"all": found.points, "middle": found.middle, "edges": found.edges}
    errors = {
        how: {name: error_dict(found.error(part, periodic=how == "periodic")) for name, part in parts.items()}
        for how in ("camera", "periodic")
    }
    return {
        "format": "lfcal-validation",
        "version": 1,
        "verdict": found.verdict,
        "edges_seen": found.wide,
        "camera_worse_at_edges": found.worse(periodic=False),
        "period_lost": found.worse(periodic=True),
        "errors": errors,
        "points": [_point(one) for one in found.points],
    }


def error_dict(error: ModelError) -> dict[str, Any]:
    """Return an error of the model as plain types."""
    return {"known": error.known, "value": error.value, "sigma": error.sigma, "limit": error.limit}


def _point(one: PointError) -> dict[str, Any]:
    return {
        "position": [one.z, one.y, one.x],
        "pixel": one.place_px,
        "field": one.field,
        "error": error_dict(one.model.error),
        "chi2": one.model.chi_square.lit,
        "displacement_px": one.model.displacement_px,
        "light": one.model.gain,
        "periodic": None if one.periodic is None else error_dict(one.periodic.error),
    }


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return which kind of source is predicted."""
    return ValidateFit if all(map(is_matrix, map(Path, given["sources"]))) else ValidateFitByFrames


FIT_VALIDATE = TaskSet(
    "fit validate", (ValidateFitByFrames, ValidateFit), kind_of, "lfcal fit validate fit/ session/ --positions 60"
)
