"""Reconstruct a frame with error bars, from files to files, in work units so that a stopped run can be continued."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, format_bytes, format_seconds, worker_count, write_text
from lfcal.base.h5 import H5File
from lfcal.psf import voxel_um
from lfcal.reconstruct._frame_units import device_for, device_hints, tool_for
from lfcal.reconstruct._replicates import ObjectModel, Replicates, SampleNoise
from lfcal.reconstruct._uncertain_h import UncertainH
from lfcal.reconstruct.error_bars import ErrorBars, ErrorSums, check_bars, check_labels, is_split, runs_of
from lfcal.reconstruct.frame_files import read_frame, related, targets_of
from lfcal.reconstruct.frame_run import FrameRun, memory_for
from lfcal.reconstruct.margin import cropped
from lfcal.reconstruct.memory import RunMemory
from lfcal.reconstruct.optics import SharedOptics
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import SolverChoice
from lfcal.reconstruct.volumes import VolumeFacts, load_labels, load_volume, save_volume, write_volumes
from lfcal.records import BootstrapSettings
from lfcal.work import ProcessCache, RunChoice, Unit, file_name, iter_begun, iter_made, parts_folder, stamp_of

__all__ = ["BarForecast", "bar_outputs", "iter_bars", "write_maps"]

_UNCERTAIN: ProcessCache[tuple[UncertainH, ExitStack]] = ProcessCache(lambda held: held[1].close())

_PARTS: ProcessCache[Projector] = ProcessCache(lambda _: None)

MAPS = ("sigma", "kappa", "resolution")
"""Attributes of `ErrorBars` that are written next to the volume, and endings of the names of their files."""


@dataclass(frozen=True)
class RegionBox:
    """Part of an extended frame that contains all regions and their surroundings.

    ``rows`` and ``columns`` are the first index and the one after the last, in the frame with its ``margin``.
    """

    rows: tuple[int, int]
    columns: tuple[int, int]
    margin: int

    @classmethod
    def of(cls, regions: NDArray[np.int64], cutout: tuple[int, int], margin: int) -> RegionBox:
        """Return the box around ``regions`` ``(nz, Y, X)``, with one ``cutout`` (pixels) on each side."""
        ends = []
        for axis, beside in zip((1, 2), cutout, strict=True):
            other = tuple(k for k in range(3) if k != axis)
            lit = np.flatnonzero(regions.any(axis=other)) + margin
            ends.append(
                (max(0, int(lit[0]) - beside), min(regions.shape[axis] + 2 * margin, int(lit[-1]) + 1 + beside))
            )
        return cls(ends[0], ends[1], margin)

    def cut(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the part of an image or a volume with margin, ``(..., Y, X)``."""
        return array[..., slice(*self.rows), slice(*self.columns)]

    def inner(self, shape: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Return slices (rows, columns) of the part of the box inside the frame: first in the box, then in the frame.

        ``shape`` is that of the frame without margin.
        """
        within, there = [], []
        for (start, stop), size in zip((self.rows, self.columns), shape, strict=True):
            first, last = max(start, self.margin), min(stop, size + self.margin)
            within.append(slice(first - start, last - start))
            there.append(slice(first - self.margin, last - self.margin))
        return (within[0], within[1]), (there[0], there[1])


@dataclass(frozen=True)
class _PartModel(ObjectModel):
    """Model of objects of which only the part in ``box`` is used. With None, the whole object is used.

    Objects are always drawn as a whole, because fluctuations may be longer than the box.
    """

    box: RegionBox | None = None

    def draw(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw an object, and return its part in the box."""
        found = super().draw(rng)
        return found if self.box is None else self.box.cut(found)


USUAL_ITERATIONS = 26
"""Iterations of ``rl-nesterov`` that take as long as a reconstruction with the default settings (measured)."""


@dataclass(frozen=True)
class BarForecast:
    """Predicted cost of error bars.

    Attributes
    ----------
    runs, iterations
        Number of reconstructions, and number of iterations of each.
    seconds
        Predicted time (s), without the additional time that the uncertainty of a fit takes.
    memory
        Predicted memory.
    """

    runs: int
    iterations: int
    seconds: float
    memory: RunMemory

    @classmethod
    def of(cls, run: FrameRun, settings: BootstrapSettings, *, regions: bool, uncertain: bool) -> BarForecast:
        """Return the forecast for ``run`` without a crop; the other arguments are as in `runs_of`."""
        uncertain |= run.projector.noise is not None
        count = runs_of(run.choice, settings, regions=regions, uncertain=uncertain)
        return cls(count, run.iterations, run.seconds * count, run.memory)

    def __str__(self) -> str:
        """Return the forecast as text."""
        usual = max(1, round(self.runs * self.iterations / USUAL_ITERATIONS))
        word = "reconstruction" if usual == 1 else "reconstructions"
        return (
            f"error bars need {self.runs} reconstructions with {self.iterations} iterations, about "
            f"{format_seconds(self.seconds)} (as long as {usual} default {word}), and "
            f"{format_bytes(self.memory.total)} of memory"
        )


def bar_outputs(out: Path, *, regions: bool) -> tuple[Path, ...]:
    """Return the paths of the volume ``out``, of its `MAPS` and, with ``regions``, of the table of regions."""
    maps = tuple(related(out, f"_{name}") for name in MAPS)
    return (out, *maps, *([related(out, "_regions", ".csv")] if regions else []))


def iter_bars(
    run: FrameRun,
    out: Path,
    settings: BootstrapSettings,
    labels: Path | None,
    how: RunChoice,
    details: Mapping[str, Any],
    *,
    changes: Path | None = None,
    crop: bool = False,
) -> Work[ErrorBars]:
    """Reconstruct the frame of ``run`` with error bars, write the files of `bar_outputs`, and return the `ErrorBars`.

    Parameters
    ----------
    run
        Reconstruction of one frame.
    out
        File for the volume.
    settings
        Settings of the replicates.
    labels
        File with the labels of regions, an image or a stack as in `iter_error_bars`. None: no regions.
    how
        Executor of the work units, and what to do with units left by an earlier run.
    details
        Additional metadata to store in all files.
    changes
        File of the changes of H along the axes of its uncertainty, as in `UncertainH.of`. None: H has no errors apart
        from its stated noise.
    crop
        Whether to estimate the uncertainty only in a box around the regions (`RegionBox`). The maps are not-a-number
        elsewhere.

    Raises
    ------
    InputError
        If there are several frames, the number of iterations is not fixed, or the labels do not fit the volume.
    """
    check_bars(run.choice)
    targets_of(run.frames, out, None)  # checks the type of the file before anything is computed
    if len(run.frames) > 1:
        raise InputError.expected(
            "frames for error bars", "one frame", f"{len(run.frames)} frames", "reconstruct them one by one"
        )
    shape = (len(run.matrices[0]), *run.shape)
    regions = check_labels(None if labels is None else load_labels(labels, run.projector.known_depths), shape)
    box = RegionBox.of(regions, run.projector.grid.cutout, run.choice.margin) if crop and regions is not None else None
    if changes is not None:
        with ExitStack() as stack:  # refuses wrong changes or too little memory before anything is computed
            P = run.projector if box is None else run.projector.part(slice(*box.rows), slice(*box.columns))
            UncertainH.of(P, run.matrices[0], changes, stack)
    first, others = bar_units(run, out, settings, regions is not None, how, changes=changes, box=box)
    title = f"error bars of {out.name}"
    # a run of the first unit alone would delete finished replicates
    if how.begun != "resume" or not Path(others[0].arguments["volume"]).exists():
        yield from iter_begun([first], out, how, title=title)
    made: list[ErrorBars] = []
    join = partial(
        _iter_joined, run=run, out=out, settings=settings, regions=regions, box=box, details=details, made=made
    )
    yield from iter_made([first, *others], out, replace(how, begun="resume"), join, title=title, joined=False)
    return made[0]


def bar_units(
    run: FrameRun,
    out: Path,
    settings: BootstrapSettings,
    regions: bool,
    how: RunChoice,
    *,
    changes: Path | None = None,
    box: RegionBox | None = None,
) -> tuple[Unit, list[Unit]]:
    """Return the work unit of the volume, and the units of the replicates; the latter read the file of the volume.

    The parameters are those of `iter_bars`; ``regions`` states whether there are regions.
    """
    share = 1 if how.executor == "threads" else worker_count(how.workers)
    hints = {
        "memory": memory_for(run, share),
        **device_hints(run.projector.device, run.optics.projection.device, share),
    }
    (frame,) = run.frames
    shared = {
        "optics": run.optics.plain(),
        "choice": asdict(run.choice),
        "file": os.path.abspath(frame.file),
        "page": frame.page,
    }
    common: dict[str, Any] = {
        "inputs": (*run.optics.inputs, *frame.inputs),
        "hints": hints,
        "settled": {"projection": run.projector.recipe},
    }
    first = Unit("volume", f"{__name__}:{do_volume.__name__}", shared, **common)
    volume = os.path.abspath(parts_folder(out) / file_name(first, first.fingerprint()))
    if changes is not None:
        common["inputs"] = (*common["inputs"], os.path.abspath(changes))
    uncertain = changes is not None or run.projector.noise is not None
    own: dict[str, Any] = {"volume": volume, "contrast": settings.contrast, "seed": settings.seed}
    own["box"] = None if box is None else asdict(box)
    own["changes"] = "" if changes is None else os.path.abspath(changes)
    others = [
        Unit(
            f"replicate {k + 1}",
            f"{__name__}:{do_replicate.__name__}",
            shared | own | {"replicate": k, "split": is_split(k, regions=regions, uncertain=uncertain)},
            **common,
        )
        for k in range(settings.replicates)
    ]
    return first, others


def do_volume(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Reconstruct the frame, as the task of a work unit; write the volume with its margin, and the noise, to ``out``.

    ``arguments`` are those of the unit (see `bar_units`), and ``workers`` is the number of threads.
    """
    runs = yield from _iter_runs(arguments, workers)
    clock = Clock("volume", (1 if SampleNoise.of(runs.choice) else 2) * runs.choice.iterations)
    made = yield from runs.iter_volume(clock, "")
    noise, notes = yield from runs.iter_noise(clock, runs.choice.iterations, made.volume)
    details = {"noise": asdict(noise), "notes": (*made.notes, *notes), "method": runs.P.method}
    save_volume(out, made.volume, details=details)


def do_replicate(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Reconstruct a replicate, as the task of a work unit.

    The volumes of `Replicates.iter_replicate` are written to ``out`` as one volume, concatenated along z. ``arguments``
    and ``workers`` are as in `do_volume`.
    """
    runs = yield from _iter_runs(arguments, workers)
    if arguments["changes"]:
        runs = replace(runs, imaging=_imaging(runs.P, arguments, workers))
    volume = load_volume(arguments["volume"])
    noise = SampleNoise(**_details(Path(arguments["volume"]))["noise"])
    model = _PartModel.of(volume, arguments["contrast"])
    model = replace(model, box=_box_of(arguments))
    split, key = arguments["split"], (arguments["seed"], arguments["replicate"])
    count = 1 + (1 + runs.uncertain) * split
    clock = Clock(f"replicate {key[1] + 1}", count * runs.choice.iterations)
    found = yield from runs.iter_replicate(clock, 0, model, noise, key, split=split)
    save_volume(out, np.concatenate(found))


def _imaging(P: Projector, arguments: Mapping[str, Any], workers: int) -> UncertainH:
    """Return H with its uncertainty from the file of changes of a unit; the units in a process share it."""

    def opened() -> tuple[UncertainH, ExitStack]:
        with ExitStack() as stack:
            (H,) = SharedOptics.of(arguments["optics"]).open(stack)
            return UncertainH.of(P, H, Path(arguments["changes"]), stack, workers), stack.pop_all()

    key = (P, arguments["changes"], stamp_of([arguments["changes"]]))
    return _UNCERTAIN.get(key, opened)[0]


def _details(part: Path) -> dict[str, Any]:
    with H5File(part) as file:
        found: dict[str, Any] = json.loads(file.attributes().text("details", "{}"))
    return found


def _iter_runs(arguments: Mapping[str, Any], workers: int) -> Work[Replicates]:
    """Read the frame, and prepare the projector; the runs in a process share the projector."""
    image = read_frame(Path(arguments["file"]), arguments["page"])
    choice = SolverChoice(**arguments["choice"])
    place = device_for(arguments.get("device", "cpu"), arguments.get("device_room"))
    settings = (arguments["projection"], arguments["memory"], workers, choice.margin, place)
    tool, box = tool_for(SharedOptics.of(arguments["optics"]), image.shape, settings), _box_of(arguments)
    P = tool.projector
    if box is not None:
        P = _PARTS.get((P, box), lambda: tool.projector.part(slice(*box.rows), slice(*box.columns)))
    if not choice.solver.in_parts:
        yield from P.iter_prepare()
    weights = None if tool.view is None else tool.view.inside(image.shape)
    runs = Replicates.of(P, tool.clean(image), choice, weights)
    if box is None:
        return runs
    return replace(runs, image=box.cut(runs.image), weights=None if runs.weights is None else box.cut(runs.weights))


def _box_of(arguments: Mapping[str, Any]) -> RegionBox | None:
    found = arguments.get("box")
    return None if found is None else RegionBox(tuple(found["rows"]), tuple(found["columns"]), found["margin"])


def _iter_joined(
    parts: Sequence[Path],
    *,
    run: FrameRun,
    out: Path,
    settings: BootstrapSettings,
    regions: NDArray[np.int64] | None,
    box: RegionBox | None,
    details: Mapping[str, Any],
    made: list[ErrorBars],
) -> Work[None]:
    """Compute the error bars from the files of the units, and write all outputs."""
    margin, (nz, *shape) = run.choice.margin, run.volume_shape
    whole, known = load_volume(parts[0]), _details(parts[0])
    used = box or RegionBox((0, shape[0] + 2 * margin), (0, shape[1] + 2 * margin), margin)
    within, there = used.inner((shape[0], shape[1]))
    mean = used.cut(ObjectModel.of(whole, settings.contrast).mean)
    labels = None if regions is None else regions[:, *there]
    sums = ErrorSums(used.cut(whole)[:, *within], mean[:, *within], labels)
    clock = Clock("error bars", len(parts))
    for k, part in enumerate(parts[1:]):
        stack = load_volume(part)[:, *within]
        sums.add(*np.split(stack, len(stack) // nz))
        yield clock.at(k + 1)
    bars = sums.result(known["notes"])
    if box is not None:
        bars = _placed(bars, cropped(whole, margin), there)
    if bars.regions:
        write_text(bar_outputs(out, regions=True)[-1], _table(bars))
    write_maps(bars, run, out, {**run.details, **details, "method": known["method"], "bootstrap": asdict(settings)})
    made.append(bars)


def _placed(bars: ErrorBars, volume: NDArray[np.float32], there: tuple[slice, slice]) -> ErrorBars:
    """Return the error bars of a whole ``volume``, with maps that are NaN outside the rows and columns ``there``."""
    maps: dict[str, Any] = {name: np.full(volume.shape, np.nan, np.float32) for name in MAPS}
    for name, values in maps.items():
        values[:, *there] = getattr(bars, name)
    return replace(bars, volume=volume, **maps)


def write_maps(bars: ErrorBars, run: FrameRun, out: Path, details: Mapping[str, Any], name: str = "volume") -> None:
    """Write the maps of ``bars`` and then its volume; ``name`` is the quantity that the volume's file states."""
    facts = VolumeFacts(run.projector.known_depths, voxel_um(run.matrices[0]), {})
    arrays = {name: bars.volume, **{one: getattr(bars, one) for one in MAPS}}
    for (one, values), path in reversed(list(zip(arrays.items(), bar_outputs(out, regions=False), strict=True))):
        with write_volumes(path, values.shape, replace(facts, details={**details, "quantity": one})) as add:
            add(np.ascontiguousarray(values, np.float32))


def _table(bars: ErrorBars) -> str:
    """Return a line for each region as comma-separated values."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    ends = [f"{end}_{level}" for level in (68, 95) for end in ("low", "high")]
    parts = ["sigma_noise", "sigma_h", "sigma_object"]
    writer.writerow(["label", "first_plane", "last_plane", "voxels", "sum", "sigma", *parts, *ends])
    for one in bars.regions:
        values = [one.total, one.sigma, one.noise, one.h, one.object, *one.interval(0.6827), *one.interval(0.95)]
        writer.writerow([one.label, *one.planes, one.voxels, *(f"{value:.6g}" for value in values)])
    return text.getvalue()
