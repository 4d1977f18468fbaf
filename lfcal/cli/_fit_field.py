"""``lfcal fit A B C``: one camera from patterns of several regions of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.cli._fit_source import PatternReading
    from lfcal.fit import FieldFit, Measured, Validation
    from lfcal.psf import PSFMatrix
    from lfcal.simulate.effects import Effect
    from lfcal.work import RunChoice

__all__ = ["Regions", "fit_regions", "names_of"]

REPORT = "report"
"""Folder of the report of all regions."""


def names_of(sources: Sequence[Path]) -> list[str]:
    """Return what the regions are called: as their files or folders are.

    Raises
    ------
    InputError
        If two have one name.
    """
    names = [path.stem if path.suffix else path.name for path in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError.expected("SOURCE", "regions of different names", f"{twice} twice", "rename a file")
    if REPORT in names:
        raise InputError.expected("SOURCE", "a region of another name", f"{REPORT}, the folder of all", "rename it")
    return names


@dataclass(frozen=True)
class Regions:
    """What is made of a fit of regions beside the fit itself.

    Attributes
    ----------
    hybrid
        H of each region is the model and what its recorded patterns show beyond it.
    validate
        Predict the recorded positions of each region that were not fitted.
    validate_on
        Predict the points of another session or H, anywhere in the field.
    known_object, scene
        Predict the frame of a known object, each of its points by H of the nearest region.
    """

    hybrid: bool = False
    validate: bool = False
    validate_on: Path | None = None
    known_object: Path | None = None
    scene: Path | None = None

    def outputs(self, out: Path, sources: Sequence[Path]) -> list[Path]:
        """Return what is written beside the fit's own files."""
        from lfcal.cli._fit_validate import VALIDATION

        folders = [out / name for name in names_of(sources)] if self.validate else []
        folders += [out] if self.validate_on else []
        return [folder / name for folder in folders for name in VALIDATION]


def fit_regions(
    sources: Sequence[Path],
    how: PatternReading,
    groups: str | tuple[str, ...],
    effects: tuple[dict[str, str], Sequence[Effect]] | None,
    out: Path,
    more: Regions,
    *,
    with_h: bool,
    workers: int | None,
    json: bool,
    run: RunChoice | None = None,
) -> None:
    """Fit one camera to the patterns of several regions, and write it; each H in units where ``run`` says by whom."""
    from lfcal.cli._console import print_json, run_work
    from lfcal.cli._fit_object import ObjectPlace, object_dict, object_error, object_words, read_object
    from lfcal.cli._fit_source import is_matrix, open_upright, read_patterns
    from lfcal.cli._fit_validate import validation_dict, withheld_points
    from lfcal.fit import MODEL, field_dict, iter_fit_field, iter_write_field, starting_effects, with_given

    by_name = dict(zip(names_of(sources), sources, strict=True))
    patterns, known = {}, {}
    for name, source in by_name.items():
        patterns[name], known[name] = read_patterns(source, how, quiet=json)
    # what cannot be read ends this before the fit
    aside = {
        name: withheld_points(source, None, how, patterns[name], quiet=json)
        for name, source in (by_name.items() if more.validate else ())
    }
    first = next(iter(patterns.values()))
    other = withheld_points(sources[0], more.validate_on, how, first, quiet=json) if more.validate_on else None
    shot = read_object(more.known_object, more.scene, how, first) if more.known_object and more.scene else None
    begins = with_given(starting_effects(first.plan), *effects) if effects else None
    fit = run_work(iter_fit_field(patterns, how.camera, groups, effects=begins, workers=workers), quiet=json)
    with ExitStack() as stack:
        hybrids: dict[str, PSFMatrix | Measured] | None = None
        if more.hybrid:
            hybrids = {
                name: stack.enter_context(open_upright(source)) if is_matrix(source) else patterns[name]
                for name, source in by_name.items()
            }
        work = iter_write_field(
            fit, patterns, out, known, hybrids=hybrids, noise=how.noise, with_h=with_h, workers=workers, run=run
        )
        written, summaries = run_work(work, quiet=json)
    if not json:
        _show(fit, out, written)
        for name, summary in summaries.items():
            typer.echo(f"{name}: {summary}")
    found = _validated(fit, aside, other, by_name, out, more.validate_on, json=json)
    beside = None
    if shot is not None:
        places = [ObjectPlace.of(out / name / MODEL, own) for name, own in fit.fits.items()]
        beside = object_error(places, *shot, how.noise, workers)
        if not json:
            typer.echo(object_words(beside))
    if json:
        told: dict[str, Any] = field_dict(fit) | {"files": written}
        told |= {"hybrid": {name: asdict(one) for name, one in summaries.items()}} if summaries else {}
        told |= {"validation": {name: validation_dict(one) for name, one in found.items()}} if found else {}
        told |= {} if beside is None else {"object": object_dict(beside)}
        print_json(told)


def _validated(
    fit: FieldFit,
    aside: Mapping[str, Measured],
    other: Measured | None,
    sources: Mapping[str, Path],
    out: Path,
    validate_on: Path | None,
    *,
    json: bool,
) -> dict[str, Validation]:
    """Return how well points were predicted that were not fitted: of each region, and of another source; written."""
    from lfcal.cli._console import run_work
    from lfcal.cli._fit_validate import iter_write_validation, show_validation

    found = {}
    for name, points in aside.items():
        work = iter_write_validation(fit.fits[name], points, out / name, sources[name], None)
        found[name] = run_work(work, quiet=json)
    if other is not None and validate_on is not None:
        first = replace(fit.first, setup=fit.setup_at(fit.first.planned))
        name = validate_on.stem if validate_on.suffix else validate_on.name
        work = iter_write_validation(first, other, out, next(iter(sources.values())), validate_on)
        found[name if name not in found else str(validate_on)] = run_work(work, quiet=json)
    for name, one in found.items() if not json else ():
        typer.echo(f"{name}:")
        show_validation(one)
    return found


def _show(fit: FieldFit, out: Path, written: Sequence[Path]) -> None:
    from lfcal.cli._console import print_table, report
    from lfcal.fit import wavefront_table

    first = fit.first
    regions = [
        [name, str(len(own.residuals)), str(own.here.error), f"{own.here.chi_square.lit:.3f}"]
        for name, own in fit.fits.items()
        if own.here is not None
    ]
    rows = [
        [one.name, f"{one.value:.6g}", f"{one.sigma:.2g}", f"{one.start:.6g}", one.unit]
        for one in first.parameters.values()
    ]
    print_table(["parameter", "found", "±", "described", "unit"], rows)
    headers, lines = wavefront_table(fit)
    if lines:
        print_table(headers, lines, title="wavefront (waves)")
    print_table(["region", "patterns", "error of the model", "χ²"], regions)
    typer.secho(first.verdict, fg=typer.colors.GREEN if first.complete else typer.colors.RED, bold=True)
    for name, own in fit.fits.items():
        for one in own.outliers:
            report(f"left out: {name}, (z, y, x) = ({one.z}, {one.y}, {one.x}): {one.reason}")
        if own.unseen:
            report(f"note: {name}, {own.unseen_words}")
    for combination in first.unidentified:
        report(f"note: these scans do not tell apart: {combination}")
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
