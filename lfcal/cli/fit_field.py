"""``lfcal fit A B C``: one camera from patterns of several regions of the field."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.errors import InputError

if TYPE_CHECKING:
    from lfcal.cli.fit_source import Reading
    from lfcal.fit.field import FieldFit
    from lfcal.simulate.effects.base import Effect

__all__ = ["fit_regions", "names_of"]


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
    return names


def fit_regions(
    sources: Sequence[Path],
    how: Reading,
    groups: str | tuple[str, ...],
    effects: tuple[dict[str, str], Sequence[Effect]] | None,
    out: Path,
    *,
    with_h: bool,
    workers: int | None,
    json: bool,
) -> None:
    """Fit one camera to the patterns of several regions, and write it."""
    from lfcal.cli.console import print_json, run_work
    from lfcal.cli.fit_source import read_patterns
    from lfcal.fit.field import iter_fit_field
    from lfcal.fit.field_files import field_dict, iter_write_field
    from lfcal.fit.setup import called_for, with_given

    patterns, known = {}, {}
    for name, source in zip(names_of(sources), sources, strict=True):
        patterns[name], known[name] = read_patterns(source, how, quiet=json)
    first = next(iter(patterns.values()))
    begins = with_given(called_for(first.plan), *effects) if effects else None
    fit = run_work(iter_fit_field(patterns, how.camera, groups, effects=begins, workers=workers), quiet=json)
    work = iter_write_field(fit, patterns, out, known, with_h=with_h, workers=workers)
    written = run_work(work, quiet=json)
    if json:
        found: dict[str, Any] = field_dict(fit) | {"files": written}
        print_json(found)
        return
    _show(fit, out, written)


def _show(fit: FieldFit, out: Path, written: Sequence[Path]) -> None:
    from lfcal.cli.console import print_table, report
    from lfcal.fit.parameters import field_of

    first = fit.first
    rows = [
        [one.name, f"{one.value:.6g}", f"{one.sigma:.2g}", f"{one.start:.6g}", one.unit]
        for one in first.parameters.values()
    ]
    print_table(["parameter", "found", "±", "described", "unit"], rows)
    at = {name: field_of(own.planned) for name, own in fit.fits.items()}
    fronts = {name: {(t.n, t.m): t for t in fit.wavefront_at(place)} for name, place in at.items()}
    terms = sorted({term for front in fronts.values() for term in front})
    if terms:
        lines = []
        for name, (x, y) in at.items():
            values = [fronts[name].get(term) for term in terms]
            cells = ["" if one is None else f"{one.waves:.3f} ± {one.sigma:.2g}" for one in values]
            lines.append([name, f"{x / 1e3:.2f}, {y / 1e3:.2f}", *cells])
        print_table(["region", "x, y (mm)", *(f"Z({n}, {m})" for n, m in terms)], lines, title="wavefront (waves)")
    typer.secho(first.verdict, fg=typer.colors.GREEN if first.complete else typer.colors.RED, bold=True)
    for name, own in fit.fits.items():
        for one in own.outliers:
            report(f"left out: {name}, (z, y, x) = ({one.z}, {one.y}, {one.x}): {one.reason}")
        if own.unseen:
            report(f"note: {name}, {own.unseen_words}")
    for combination in first.unidentified:
        report(f"note: these scans do not tell apart: {combination}")
    typer.echo(f"{out}: {', '.join(str(path.relative_to(out)) for path in written)}")
