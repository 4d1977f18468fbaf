"""``python -m benchmarks faults``: faults added to recordings, and the findings, ranks and costs reported."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from json import dumps, loads
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base.errors import InputError
from lfcal.base.files import read_text, storage_errors
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    from benchmarks._fault_costs import TrueCost
    from benchmarks._fault_list import Injected
    from benchmarks._fault_recordings import Recording
    from lfcal.judge import Inspection

__all__ = ["Alarm", "Tried", "alarms", "register", "tried"]

CLEAN = 40
"""Number of recordings without a fault."""

DEAR, COSTLY = 0.1, 0.03
"""True costs above which a fault must be named first or second, or must be named at any rank."""


@dataclass(frozen=True, slots=True)
class Tried:
    """Result of an inspection of a recording with one fault.

    Attributes
    ----------
    camera, fault, strength, unit
        Camera, and the fault that was added.
    true, reported
        True and reported cost (NRMSE); None: no cost was reported.
    rank
        Rank among all named faults, from 1; 0: not named.
    found
        All named faults, the costliest first.
    seconds
        Time of the inspection (s).
    """

    camera: str
    fault: str
    strength: float
    unit: str
    true: float
    reported: float | None
    rank: int
    found: tuple[str, ...]
    seconds: float

    @property
    def within(self) -> bool | None:
        """Whether the cost is correct within a factor of 2; None if none was reported or the true cost is small."""
        return None if self.reported is None or self.true < COSTLY else self.true / 2 <= self.reported <= 2 * self.true


@dataclass(frozen=True, slots=True)
class Alarm:
    """Result of an inspection of a recording without a fault."""

    camera: str
    merit: str
    verdict: str
    found: tuple[str, ...]
    compared: int


def register(bench: typer.Typer) -> None:
    """Add ``faults`` to the benchmarks."""
    bench.command("faults")(command)


def command(
    *,
    cameras: str = typer.Option("bench,r29-like,lfm_20x05,lfm_60x12", help="Cameras whose recordings get faults."),
    first: int = typer.Option(0, min=0, help="Number of the first fault of the list."),
    faults: int | None = typer.Option(None, min=1, help="Number of faults; default: all that follow."),
    strengths: str = typer.Option("1,2,3", help="Strengths, from weak (1) to strong (3)."),
    patterns: int = typer.Option(60, min=24, help="Number of patterns that are compared with the camera."),
    clean: bool = typer.Option(False, "--clean", help="Inspect 40 recordings without a fault instead."),
    keep: Path | None = typer.Option(
        None, help="File to which results are appended; results in the file are not computed again."
    ),
    json: JsonOption = False,
) -> None:
    """Add faults to simulated recordings, and compare the reported costs with the true ones.

    Example: `python -m benchmarks faults --cameras bench --strengths 3 --keep faults.jsonl`
    """
    if clean:
        _print_alarms(alarms(patterns, quiet=json), json)
        return
    from benchmarks._fault_list import FAULTS
    from benchmarks._fault_recordings import CAMERAS, Recording

    wanted = [name.strip() for name in cameras.split(",")]
    levels = [int(k) if k.strip().isdigit() else 0 for k in strengths.split(",")]
    for name in wanted:
        if name not in CAMERAS:
            raise InputError.expected("--cameras", f"some of {', '.join(CAMERAS)}", name, "correct it")
    if not set(levels) <= {1, 2, 3}:
        raise InputError.expected("--strengths", "some of 1, 2, 3", strengths, "correct it")
    chosen = FAULTS[first : None if faults is None else first + faults]
    found: list[Tried] = []
    done = {} if keep is None else _kept(keep, patterns)
    for name in wanted:
        plan = CAMERAS[name]()
        trial: tuple[Recording, TrueCost] | None = None
        for one in chosen:
            if one.types > len(plan.camera.lattice.types):
                continue
            for strength in (one.strengths[level - 1] for level in sorted(set(levels))):
                before = done.get((name, one.name, strength))
                if before is None:
                    if trial is None:
                        recording = Recording(plan)
                        trial = recording, _truth(recording)
                    before = tried(name, *trial, one, strength, patterns)
                    if keep is not None:
                        _add(keep, before, patterns)
                found.append(before)
                if not json:
                    _print(before)
    _report(found, json)


def _kept(file: Path, patterns: int) -> dict[tuple[str, str, float], Tried]:
    """Return the results in a file for a number of patterns, by camera, fault and strength."""
    found = {}
    lines = read_text(file).splitlines() if file.exists() else []
    for number, line in enumerate(lines, 1):
        try:
            values = loads(line)
            if values.pop("patterns") != patterns:
                continue
            one = Tried(**{**values, "found": tuple(values["found"])})
        except (ValueError, TypeError, KeyError, AttributeError):
            here = f"line {number} of {file.name}"
            raise InputError.expected("--keep", "results of this command", here, "give another file") from None
        found[one.camera, one.fault, one.strength] = one
    return found


def _add(file: Path, one: Tried, patterns: int) -> None:
    with storage_errors(file), file.open("a", encoding="utf-8") as out:
        out.write(dumps({**asdict(one), "patterns": patterns}) + "\n")


def _truth(recording: Recording) -> TrueCost:
    from benchmarks._fault_costs import TrueCost

    return TrueCost(recording.light(), recording.clean())


def tried(camera: str, recording: Recording, truth: TrueCost, fault: Injected, strength: float, patterns: int) -> Tried:
    """Return the result of an inspection of a recording with a fault."""
    values = fault.put_in(recording, strength)
    start = time.perf_counter()
    inspection = _inspected(recording, values, patterns)
    took = time.perf_counter() - start
    ranked = _ranked(inspection)
    rank = next((k for k, (name, _) in enumerate(ranked, 1) if name in fault.named), 0)
    reported = ranked[rank - 1][1] if rank else None
    names = tuple(f"{name} {'?' if cost is None else f'{cost:.3f}'}" for name, cost in ranked)
    if inspection.why_not:
        names = (*names, f"({inspection.why_not})")
    return Tried(camera, fault.name, strength, fault.unit, truth.cost(values), reported, rank, names, took)


def _inspected(recording: Recording, values: object, patterns: int) -> Inspection:
    from lfcal.base.progress import drain
    from lfcal.judge import iter_inspection
    from lfcal.judge.quality import inspect

    H = recording.matrix(values)  # type: ignore[arg-type]
    return drain(iter_inspection(H, inspect(H, workers=1), patterns=patterns))


def _ranked(inspection: Inspection) -> list[tuple[str, float | None]]:
    """Return the named faults, the costliest first: findings, and bad metrics that no finding explains."""
    from lfcal.judge.inspection import worst_first

    found: list[tuple[float, str, float | None]] = [(-worst_first(f)[0], f.name, f.cost) for f in inspection.faults]
    found += [(m.cost, m.key, m.cost) for m in inspection.doubts if m.merit == "bad"]
    return [(name, cost) for _, name, cost in sorted(found, key=lambda one: -one[0])]


def _print(one: Tried) -> None:
    reported = "-" if one.reported is None else f"{one.reported:.3f}"
    place = f"named {one.rank}" if one.rank else "NOT NAMED" if one.true > COSTLY else "not named"
    typer.echo(
        f"{one.camera}, {one.fault} {one.strength:g} {one.unit}: true cost {one.true:.3f}, reported {reported}, {place}"
        f" [{'; '.join(one.found)}]"
    )


def _report(found: Sequence[Tried], json: bool) -> None:
    dear, costly = ([one for one in found if one.true > limit] for limit in (DEAR, COSTLY))
    first = sum(one.rank in (1, 2) for one in dear)
    named = sum(one.rank > 0 for one in costly)
    judged = [one.within for one in found if one.within is not None]
    if json:
        figures = {"dear": len(dear), "first_or_second": first, "costly": len(costly), "named": named}
        print_json({"faults": found, **figures, "reported": len(judged), "within_2": sum(judged)})
        return
    rows = []
    for camera in dict.fromkeys(one.camera for one in found):
        own = [[one for one in part if one.camera == camera] for part in (found, dear, costly)]
        right = [one.within for one in own[0] if one.within is not None]
        rows.append(
            [
                camera,
                str(len(own[0])),
                f"{sum(one.rank in (1, 2) for one in own[1])} of {len(own[1])}",
                f"{sum(one.rank > 0 for one in own[2])} of {len(own[2])}",
                f"{sum(right)} of {len(right)}",
            ]
        )
    headers = [
        "camera",
        "faults",
        f"cost > {DEAR:g}: first or second",
        f"cost > {COSTLY:g}: named",
        "cost within a factor of 2",
    ]
    print_table(headers, rows)
    typer.echo(f"true cost above {DEAR:g} named first or second: {first} of {len(dear)}")
    typer.echo(f"true cost above {COSTLY:g} named: {named} of {len(costly)} ({_percent(named, len(costly))})")
    typer.echo(f"cost within a factor of 2: {sum(judged)} of {len(judged)} ({_percent(sum(judged), len(judged))})")


def _percent(some: int, of: int) -> str:
    return f"{100 * some / of:.0f} %" if of else "none"


def alarms(patterns: int, *, quiet: bool = True) -> list[Alarm]:
    """Return the results of inspections of recordings without a fault."""
    from benchmarks._fault_clean import clean_cameras

    found = []
    for name, recording, values in clean_cameras(CLEAN):
        one = _inspected(recording, values, patterns)
        names = tuple(name for name, _ in _ranked(one))
        found.append(Alarm(name, one.merit, one.verdict, names, one.compared))
        if not quiet:
            typer.echo(f"{name}: {found[-1].merit}, {one.compared} compared: {one.verdict} {'; '.join(names)}")
    return found


def _print_alarms(found: Sequence[Alarm], json: bool) -> None:
    bad, fair = (sum(one.merit == merit for one in found) for merit in ("bad", "fair"))
    if json:
        print_json({"cameras": found, "bad": bad, "fair": fair})
        return
    typer.echo(f"of {len(found)} recordings without a fault: {bad} bad, {fair} fair")
