"""Reconstruct a series in units of one frame, several of them at a time; a run can be resumed after a crash."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, FileFormatError, InputError, Work
from lfcal.base.h5 import H5File
from lfcal.reconstruct.frame_files import Cleaner, FrameFile, Saved, cleaner, read_frame
from lfcal.reconstruct.optics import SharedOptics
from lfcal.reconstruct.projectors import ArrayDevice, Projector, device_count, find_device
from lfcal.reconstruct.resample import Resampling
from lfcal.reconstruct.series import FrameResult, iter_frame
from lfcal.reconstruct.solvers import SolverChoice
from lfcal.reconstruct.volumes import load_volume, save_volume
from lfcal.work import ProcessCache, Unit, file_name, parts_folder, stamp_of, worker_number

__all__ = ["device_for", "device_hints", "do_frame", "frame_units", "iter_collect", "tool_for"]


def frame_units(
    frames: Sequence[FrameFile],
    optics: SharedOptics,
    choice: SolverChoice,
    out: Path,
    hints: Mapping[str, Any],
    recipe: str,
    *,
    warm: bool,
) -> list[Unit]:
    """Return a unit for each frame; with ``warm``, each starts from the volume of the previous frame.

    ``hints`` contain the memory that projections may use, and `device_hints`. ``recipe`` is the projection method of
    the run, as in `Projector.recipe`.
    """
    hints = {**hints, "alone": len(frames) == 1}
    shared = {"optics": optics.plain(), "choice": asdict(choice), "shape": list(frames[0].read().shape)}
    units: list[Unit] = []
    before = ""
    for frame in frames:
        own = {"name": frame.name, "file": os.path.abspath(frame.file), "page": frame.page, "initial": before}
        unit = Unit(
            f"frame {frame.name}",
            f"{__name__}:{do_frame.__name__}",
            shared | own,
            (*optics.inputs, *frame.inputs),
            hints=hints,
            settled={"projection": recipe},
        )
        units.append(unit)
        if warm:
            # its name contains the fingerprint of its start, and thus of all frames before it
            before = os.path.abspath(parts_folder(out) / file_name(unit, unit.fingerprint()))
    return units


def do_frame(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Reconstruct one frame into a separate volume file, as the task of a unit.

    If one of several frames has no volume, the file states the reason, and contains the start for the next frame.
    """
    began = time.perf_counter()
    initial = _begun_from(arguments["initial"])
    try:
        rows, columns = arguments["shape"]
        image = read_frame(Path(arguments["file"]), arguments["page"], (rows, columns))
    except FileFormatError as error:
        if arguments["alone"]:
            raise
        _save_nothing(out, initial, error, began)
        return
    optics = SharedOptics.of(arguments["optics"])
    choice = SolverChoice(**arguments["choice"])
    place = device_for(arguments.get("device", "cpu"), arguments.get("device_room"))
    how = (arguments["projection"], arguments["memory"], workers, choice.margin, place)
    tool = tool_for(optics, image.shape, how)
    if not choice.solver.in_parts:
        yield from tool.projector.iter_prepare()
    weights = None if tool.view is None else tool.view.inside(image.shape)
    result = yield from iter_frame(tool.projector, lambda: tool.clean(image), choice, weights=weights, initial=initial)
    if isinstance(result, InputError):
        if arguments["alone"]:
            raise result
        _save_nothing(out, initial, result, began)
        return
    last = result.history[-1]
    details = {
        "iterations": result.state.iteration,
        "residual": last.residual,
        "stopped": result.stopped,
        "chi2": result.chi2 if math.isfinite(result.chi2) else None,
        "seconds": time.perf_counter() - began,
        "notes": result.notes,
        "method": tool.projector.method,
    }
    save_volume(out, result.volume, details=details)


def _save_nothing(out: Path, initial: NDArray[Any] | None, error: Exception, began: float) -> None:
    """Write the reason why there is no volume; the volume of the previous frame, if any, is passed on to the next."""
    details = {"failed": str(error), "seconds": time.perf_counter() - began, "empty": initial is None}
    save_volume(out, np.zeros((1, 1, 1)) if initial is None else initial, details=details)


def _begun_from(file: str) -> NDArray[Any] | None:
    """Return the volume that the unit of the previous frame has written, to start from; None if there is none."""
    return None if not file or _details(Path(file)).get("empty", False) else load_volume(file)


def _details(part: Path) -> dict[str, Any]:
    """Return the details in the file of a unit."""
    with H5File(part) as file:
        found: dict[str, Any] = json.loads(file.attributes().text("details", "{}"))
    return found


@dataclass(frozen=True)
class FrameTool:
    """Objects shared by the frames of a series, created once in each process."""

    projector: Projector
    view: Resampling | None
    clean: Cleaner
    files: ExitStack


_HELD: ProcessCache[FrameTool] = ProcessCache(lambda tool: tool.files.close())


How = tuple[str, int, int, int, ArrayDevice | None]
"""Settings that affect only how a volume is computed: method of projection, memory, threads, margin, device."""


def device_hints(device: ArrayDevice | None, asked: str, processes: int) -> dict[str, Any]:
    """Return hints for units: the requested device, and the memory for each process there; empty without a device."""
    if device is None:
        return {}
    one = ":" in asked  # otherwise each worker uses one of them, chosen by its number
    share = processes if one else -(-processes // max(1, device_count(device.library)))
    room = None if share == 1 else device.free_bytes() // share
    return {"device": asked if one else "cuda", "device_room": room}


def device_for(text: str, room: int | None) -> ArrayDevice | None:
    """Return the device of this worker, with the memory that it may use there."""
    found = find_device(text, worker=worker_number())
    return None if found is None else replace(found, room=room)


def tool_for(optics: SharedOptics, shape: tuple[int, ...], how: How) -> FrameTool:
    """Return the shared objects for frames of ``shape``."""
    key = (json.dumps(optics.plain(), sort_keys=True), stamp_of(optics.inputs), shape, how)
    return _HELD.get(key, lambda: _made(optics, shape, how))


def _made(optics: SharedOptics, shape: tuple[int, ...], how: How) -> FrameTool:
    method, memory, workers, margin, device = how
    with ExitStack() as stack:
        matrices = optics.open(stack)
        frame = shape[0], shape[1]
        view = optics.view(matrices[0], frame)
        projector = optics.projector(
            matrices,
            frame,
            view,
            margin,
            memory=memory,
            workers=workers,
            device="cpu" if device is None else device,
            method=method,
        )
        clean = cleaner(optics.light_field, view)
        return FrameTool(projector, view, clean, stack.pop_all())


def iter_collect(parts: Sequence[Path], names: Sequence[str], saved: Saved, results: list[FrameResult]) -> Work[None]:
    """Save the volume of each frame with its details, and add the result of each frame to ``results``.

    If no frame has a volume, nothing is saved.
    """
    reported = [_details(part) for part in parts]
    for name, known in zip(names, reported, strict=True):
        if "failed" in known:
            results.append(FrameResult.without_volume(name, known["failed"], known["seconds"]))
            continue
        counts = known["iterations"], known["residual"], known["seconds"]
        chi2 = known.get("chi2")
        judged = float("nan") if chi2 is None else float(chi2)
        results.append(FrameResult(name, *counts, tuple(known["notes"]), known["stopped"], chi2=judged))
    if all(result.failed for result in results):
        return
    clock = Clock("write volumes", len(parts))
    with saved() as save:
        for k, (part, result, known) in enumerate(zip(parts, results, reported, strict=True)):
            # a continued run uses the method with which it began
            said: dict[str, Any] = {
                key: known[key]
                for key in ("residual", "stopped", "method", "notes", "chi2")
                if known.get(key) is not None
            }
            save(result.name, None if result.failed else load_volume(part), said)
            yield clock.at(k + 1)
