"""Open frames of a scan together with their plan, as several commands receive them."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError, read_text, warn
from lfcal.records import opt

if TYPE_CHECKING:
    from lfcal.camera import Camera, ScanPlan
    from lfcal.frames import Frames

__all__ = ["ScanFrames", "find_plan", "no_plan", "note_size", "orientations", "origin_field"]


def orientations() -> tuple[str, ...]:
    """Return the orientations that turn frames upright, by their names in options."""
    from lfcal.frames import ORIENTATIONS
    from lfcal.psf import AUTO, CHECK

    return (CHECK, AUTO, *(one.option for one in ORIENTATIONS.values()))


def origin_field(empty: str) -> str:
    """Declare the field ``origin`` of a task that reads frames."""
    words = "Sensor row and column of the first pixel (ROW,COLUMN), if frames show only a part of the sensor."
    return opt("", words, unit="px", empty=empty, more=True)


@dataclass(frozen=True)
class ScanFrames:
    """Where frames and plan are, and how frames are assigned to positions, as options of ``lfcal assemble``."""

    frames: Path
    plan: Path | None = None
    manifest: Path | None = None
    pattern: str = ""
    order: str = ""
    columns: str = ""
    first: int | None = None
    skip_damaged: bool = False
    orientation: str = "as is"
    origin: tuple[int, int] | None = None
    nan: str = "auto"

    @property
    def beside(self) -> Path | None:
        """Folder of the list, if ``frames`` is a list of frames; None if it is not."""
        from lfcal.frames import TABLES

        return self.frames.parent if self.frames.suffix.lower() in TABLES else None

    def open(self, colour: str = "") -> tuple[Frames, ScanPlan]:
        """Return the frames and their plan: the plan that is named, recorded, or found near the frames, in this order.

        Raises
        ------
        InputError
            If there is no plan, or the named plan belongs to another scan.
        """
        from lfcal.frames import open_frames

        frames, plan = self.frames, self.plan
        found = find_plan(frames, plan)
        source = open_frames(
            frames,
            manifest=self.manifest,
            pattern=self.pattern or None,
            order=self.order or None,
            plan=found,
            colour=colour or None,
            columns=self.columns,
            first=self.first,
            skip_damaged=self.skip_damaged,
            orientation=self.orientation,
            origin=self.origin,
            nan=self.nan,
        )
        own = source.metadata.plan
        if own is None and found is None:
            source.close()
            raise no_plan(_folder(frames))
        # a named plan replaces the recorded one: its cutout and anchor may have been corrected since
        if own is None or plan is None:
            return source, own or found  # type: ignore[return-value]  # one of them is there
        assert found is not None
        if found.shape[:3] != own.shape[:3]:
            source.close()
            raise InputError.expected(
                f"plan {plan}",
                f"the plan of these frames, with {_grid(own)} positions (z, y, x)",
                f"one with {_grid(found)} positions",
                "leave the plan out (--plan)",
            )
        return source, found

    def files(self, source: Frames) -> list[str]:
        """Return all files that the frames of ``source`` are read from, including lists and the plan."""
        from lfcal.frames import FolderSource, files_of

        named = [*files_of(self.frames), *_plans(self.frames, self.plan), *files_of(self.manifest)]
        if isinstance(source, FolderSource):
            named += [source.root / entry.file for entry in source.manifest.entries]
        return sorted({os.path.abspath(path) for path in named})


def find_plan(frames: Path, plan: Path | None) -> ScanPlan | None:
    """Return the plan in ``plan``, or in ``plan.json`` in or above the folder of the frames; None if there is none."""
    from lfcal.camera import ScanPlan

    places = _plans(frames, plan)
    if not places:
        return None
    return ScanPlan.from_json(read_text(places[0]))


def _plans(frames: Path, plan: Path | None) -> list[Path]:
    """Return the path ``plan`` if it is given, or else each ``plan.json`` next to the frames and one folder above."""
    folder = _folder(frames)
    return [plan] if plan else [p for p in (folder / "plan.json", folder.parent / "plan.json") if p.is_file()]


def _grid(plan: ScanPlan) -> str:
    return " x ".join(map(str, plan.shape[:3]))


def _folder(frames: Path) -> Path:
    from lfcal.frames import split_dataset

    file, _ = split_dataset(frames)
    return file if file.is_dir() else file.parent


def no_plan(folder: Path) -> InputError:
    """Return the error for frames in ``folder`` without a plan, with the command that makes a plan."""
    words = shlex.join(["lfcal", "plan", "CAMERA.json", "--virtual-depths", "3,4", "-o", str(folder / "plan.json")])
    remedy = f"make a plan ({words}), or choose one (--plan)"
    return InputError.expected("scan plan", f"plan.json in {folder} or the folder above", "none", remedy)


def note_size(shape: tuple[int, int], camera: Camera, *, folder: str = "the frames", channel: str = "") -> None:
    """Warn if the size of the frames differs from that of the sensor.

    Frames may be turned. With ``channel``, they may also have half as many pixels along each side.
    """
    from lfcal.frames import binned

    sizes = {shape, shape[::-1]}
    if channel:
        sizes |= {(-(-rows // 2), -(-columns // 2)) for rows, columns in sizes}
    if camera.sensor.shape in sizes:
        return
    (rows, columns), (tall, wide) = shape, camera.sensor.shape
    what = f"{folder}: frames of {rows} x {columns} px, but the camera's sensor has {tall} x {wide}"
    times = next((n for one in sizes if (n := binned(camera.sensor.shape, one))), 0)
    if times:
        sensor = f"{tall // times}x{wide // times},{camera.sensor.pixel_um * times:g}"
        warn(
            f"{what}; this suggests binning of {times} x {times}. If the frames are binned, create a camera file with "
            f"the binned pixels and measure its array (lfcal camera import CAMERA --sensor {sensor} "
            f"--pitch {camera.lattice.pitch_um:g}um -o BINNED, then lfcal camera check BINNED WHITE)"
        )
        return
    warn(
        f"{what}; the centre of the frames is taken as the centre of the sensor; if the frames show a part of "
        "the sensor, state its first pixel (--origin ROW,COLUMN), else correct the size of the sensor "
        "(lfcal camera import CAMERA --frame FRAME)"
    )
