"""Plan scans: of one region, of several regions of the field, or of a scan that was already recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import FileFormatError, InputError, StorageError, Work, note, warn, write_text
from lfcal.records import (
    check_planes,
    opt,
    read_cutout,
    read_depths,
    read_orientation,
    read_pair,
    read_share,
    read_virtual_depths,
    record,
    required,
    show_pair,
    show_planes,
)
from lfcal.tasks._scan_frames import note_size, origin_field
from lfcal.tasks.cameras import is_camera_file, load_camera, preset_names
from lfcal.tasks.planned import Planned, PlanTask, write_plan
from lfcal.tasks.task import RunSettings, Task, TaskSet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera, ScanPlan
    from lfcal.frames.lists import Listing

__all__ = ["PLAN", "PLAN_FORMATS", "PlanRecorded", "PlanRegions", "PlanScan", "plan_text"]


PLAN_FORMATS = {
    "plan": ("Plan", ".json"),
    "csv": ("Table of stage positions", ".csv"),
    "useq": ("Sequence of useq-schema", ".useq.json"),
}
"""Title and usual suffix of each format of a plan file."""


def plan_text(plan: ScanPlan, written_as: str, positions: NDArray[np.intp] | None = None) -> str:
    """Return the content of a plan file in the format ``written_as``, a key of `PLAN_FORMATS`.

    ``positions`` ``(n, 3)`` are the indices (z, y, x) of the positions to write to a file for another program (None:
    all). An lfcal plan file (``"plan"``) always describes the complete scan.

    Raises
    ------
    InputError
        If the format cannot describe the plan.
    """
    from lfcal.camera import stage_table, useq_sequence

    if written_as == "plan":
        return plan.to_json()
    return (useq_sequence if written_as == "useq" else stage_table)(plan, positions)


def _exposures(text: str) -> float | tuple[float, ...]:
    try:
        values = tuple(float(one) for one in text.split(","))
        return values if len(values) > 1 else values[0]
    except ValueError:
        raise InputError.expected(
            "exposure (s)", "numbers", repr(text), "write one number, or one for each plane: 0.02,0.05"
        ) from None


def _show(values: float | tuple[float, ...]) -> str:
    return show_planes(values if isinstance(values, tuple) else (values,))


@record
class _Plan(PlanTask):
    """Fields of all kinds of plans."""

    name: ClassVar[str] = "plan"

    camera: str = required(
        "Camera: a preset, or a file (camera.json, Raytrix XML, oLaF YAML, napari-LF metadata and others).",
        argument=True,
        file="in",
        is_path=is_camera_file,
        examples=preset_names,
    )
    depths: str | tuple[float, ...] = opt(
        (),
        "Depths of the planes, positive away from the camera: a,b,c or start:stop:step. In µm, unless a unit follows "
        "(1.2mm).",
        label="Depth planes",
        unit="µm",
        read=read_depths,
        show=show_planes,
    )
    virtual_depths: str | tuple[float, ...] = opt(
        (),
        "Virtual depths of the planes, each the distance of its image from the lenslets divided by the gap: a,b,c or "
        "start:stop:step.",
        label="Virtual depths",
        read=read_virtual_depths,
        show=show_planes,
    )
    cutout: str | tuple[int, int] | None = opt(
        None,
        "Size of the cutout: an odd number of pixels, or ROWS,COLUMNS (both odd).",
        unit="px",
        empty="the geometric size of the pattern",
        read=read_cutout,
        show=show_pair,
    )
    anchor: str | tuple[float, float] | None = opt(
        None,
        "Sensor pixel ROW,COLUMN onto which the position y = x = 0 is imaged.",
        unit="px",
        empty="such that the scanned cell is centred on the sensor",
        read=read_pair,
        show=_show,
    )
    resample: bool = opt(
        False, "Rescale frames so that the period is a whole number of pixels.", label="Resample frames"
    )
    order: str = opt("serpentine", "Order of the positions.", choices=("serpentine", "raster"), more=True)
    stage: str = opt(
        "+x,+y,+z",
        "Stage axes that move the image right and down, and the source away from the camera, such as +x,-y,+z.",
        label="Stage axes",
        more=True,
    )
    exposure: float | tuple[float, ...] | str = opt(
        0.02, "Exposure time, or one exposure time for each plane.", unit="s", above=0, read=_exposures, show=_show
    )
    settle: float = opt(0.05, "Waiting time after each stage movement.", label="Settling time", unit="s", at_least=0)
    out: Path | None = opt(
        None, "Plan to write (.json).", label="Plan file", short="-o", file="out", empty="not written"
    )

    def __post_init__(self) -> None:
        """Check every value, and that planes are given in one way only."""
        super().__post_init__()
        if self.depths or self.virtual_depths or not isinstance(self, PlanRecorded):
            check_planes(self.depths, self.virtual_depths)

    def settings(self) -> dict[str, Any]:
        """Return the arguments of a `ScanPlan`. None: the camera determines the value."""
        from lfcal.camera import StageAxes

        return {
            "cutout": self.cutout,
            "anchor": self.anchor,
            "stage": StageAxes.parse(self.stage),
            "order": self.order,
            "exposure_s": self.exposure,
            "settle_s": self.settle,
            "resample": self.resample,
        }

    def _write(self, plan: ScanPlan, positions: NDArray[np.intp] | None) -> None:
        write_plan(plan, self.out)

    def _planned(self, plan: ScanPlan, positions: NDArray[np.intp] | None = None) -> Planned:
        """Write the plan if requested, and return it with its cost; ``positions`` are those of a half cell."""
        # a plan that cannot be forecast must leave no file behind
        forecast = self.forecast(plan, positions)
        self._write(plan, positions)
        facts = {
            "period_px": plan.camera.period_px,
            "period": plan.period,
            "period_residual_px": plan.period_residual_px,
            "tilt_residual_px": plan.tilt_residual_px,
            "resample_factors": plan.resample_factors,
            "cutout": plan.cutout,
            "anchor_px": plan.anchor,
            "lattice_anchor_px": plan.lattice_anchor,
            "depths_um": plan.depths_um,
            "virtual_depths": plan.virtual_depths,
            "steps_um": [plan.step_um(z) for z in range(len(plan.depths_um))],
            "assumed": plan.camera.marks.paths("assumed"),
            "forecast": forecast.to_dict(),
            "plan": plan.to_dict(),
            "half_cell": positions,
        }
        return Planned(task=self, plan=plan, forecast=forecast, facts=facts)


@record
class _PlanOfCamera(_Plan):
    """Fields of plans made for a camera."""

    average: int = opt(1, "Number of frames to average at each position.", label="Frames averaged", at_least=1)

    def settings(self) -> dict[str, Any]:
        """Return the arguments of a `ScanPlan`. None: the camera determines the value."""
        planes = {"depths_um": self.depths or None, "virtual_depths": self.virtual_depths or None}
        return {**super().settings(), **planes, "frames_averaged": self.average}

    def scan(self, camera: Camera) -> ScanPlan:
        """Return the plan for scanning one region with a camera."""
        from lfcal.camera import ScanPlan

        return ScanPlan.for_camera(camera, **self.settings())


@record
class PlanRegions(_PlanOfCamera):
    """Plan the scan of several regions of the field in one session.

    Examples
    --------
    >>> from lfcal.tasks import PlanRegions
    >>> (planned,) = PlanRegions(camera="bench", virtual_depths=(4,), regions="3x3").run()
    >>> print(planned.plan.names[0], "and", len(planned.plan) - 1, "more")
    centre and 8 more
    """

    input_words: ClassVar[str] = "a scan of several regions (--regions)"

    regions: str = required(
        "Regions of the field, as ROWSxCOLUMNS over the sensor. 3x3 covers the centre, the edges and the corners.",
    )

    def work(self, run: RunSettings | None = None) -> Work[tuple[Planned, ...]]:
        """Plan the scan of one region, repeat it for all regions of the field, and write the plan if requested."""
        from lfcal.camera import RegionPlan, parse_regions

        yield from ()
        scan = self.scan(load_camera(self.camera, light=False))
        one, plan = self.forecast(scan), RegionPlan.spread(scan, parse_regions(self.regions))
        write_plan(plan, self.out)
        facts = {
            "regions": [
                {"name": name, "anchor": plan.anchors[k], "residual_px": plan.residual_px(k)}
                for k, name in enumerate(plan.names)
            ],
            "frames": len(plan) * one.frames,
            "hours": len(plan) * one.hours,
            "readout_hours": None if one.readout_hours is None else len(plan) * one.readout_hours,
            "single_region": {"frames": one.frames, "hours": one.hours},
            "plan": plan.to_dict(),
        }
        return (Planned(task=self, plan=plan, forecast=one, facts=facts),)


@record
class PlanRecorded(_Plan):
    """Make the plan of a recorded scan from the list of its stage coordinates.

    Examples
    --------
    >>> from lfcal.tasks import PlanRecorded
    >>> task = PlanRecorded(camera="session/camera.json", positions="stage.csv", frames="session/frames")
    >>> print(task.orientation, task.files("in")[1])
    as-is stage.csv
    """

    input_words: ClassVar[str] = "a recorded scan (--positions)"

    positions: Path = required("File that lists the stage coordinates of the recorded scan.", file="in")
    frames: Path | None = opt(None, "Folder of the frames in the list.", file="in", empty="the folder of the list")
    columns: str = opt(
        "",
        "Contents of the columns of the list, such as file=Name,y_um=PosY,x_um=PosX,exposure_ms=Exp.",
        empty="inferred from the names of the columns",
        more=True,
    )
    origin: str = origin_field("the whole sensor")
    orientation: str = opt(
        "as-is",
        "How to turn the frames upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to "
        "right), mirror-y, transpose, anti-transpose.",
        read=read_orientation,
        more=True,
    )

    def work(self, run: RunSettings | None = None) -> Work[tuple[Planned, ...]]:
        """Read the list, plan the scan, and write the plan if requested.

        If the frames exist, the directions in which the stage moves the image, and the anchor, are found from them.
        """
        from lfcal.frames import named_orientation, parse_origin
        from lfcal.frames.lists import Part, any_listing, located, plan_of_list, reader, sample_of

        yield from ()
        camera, settings = load_camera(self.camera, light=False), self.settings()
        place, turn = parse_origin(self.origin), named_orientation(self.orientation)
        listing = any_listing(self.positions, self.columns)
        # the list of an NDTiff folder is in the folder
        root = self.frames or (self.positions if self.positions.is_dir() else self.positions.parent)
        read = None
        try:
            listing = located(listing, root)
            shape, colour, roi = sample_of(listing, root)
            read = reader(listing, root, colour, turn)
        except StorageError as error:
            if self.frames is not None:
                raise
            note(f"frames were not found ({error}); choose their folder (--frames)")
        else:
            _check_size(turn.shape(shape), camera, roi, place, str(root))
            if colour is not None:
                note(
                    f"only the colour {colour} of the colour images is used; choose another "
                    "when you assemble H (lfcal assemble --channel)"
                )
        depths: Any = self.depths or tuple(camera.depth_of(float(v)) for v in self.virtual_depths) or None
        part = None if place is None else Part(place, turn.name)
        plan, notes = plan_of_list(listing, camera, read=read, part=part, depths_um=depths, **settings)
        for one in notes:
            note(one)
        if read is not None and part is None:
            _tell_turned(listing, plan, read)
        return (self._planned(plan),)


def _tell_turned(listing: Listing, plan: ScanPlan, read: Callable[[int], NDArray[Any]]) -> None:
    """Warn of frames that are flipped or turned relative to the camera.

    The light moves over such frames as the stage axes of the plan describe, so that only the patterns show the error.
    """
    from lfcal.campaign import find_turned_frames, seen_patterns
    from lfcal.frames.lists import place

    try:
        seen = seen_patterns(read, place(listing, plan).positions, plan)
    except (FileFormatError, StorageError):
        return  # damaged frames are refused or left out later, when all frames are read
    found = find_turned_frames(seen, plan)
    if found is not None:
        warn(
            f"the frames are {found.words}; make the plan again with {found.options}, and assemble with the same option"
        )


def _check_size(
    shape: tuple[int, int],
    camera: Camera,
    roi: tuple[int, int, int, int] | None,
    origin: tuple[int, int] | None,
    folder: str,
) -> None:
    """Check that frames fit on the sensor, and warn if they have another size.

    Frames that are smaller than a sensor of known size raise `InputError` if their position on it is unknown.
    """
    from lfcal.frames import check_inside, is_part_of_sensor, part_refusal, stated_origin

    if origin is not None:
        check_inside(origin, shape, camera.sensor.shape)
    elif is_part_of_sensor(shape, camera):
        stated = stated_origin(roi, shape)
        raise part_refusal(shape, camera.sensor.shape, stated, "as their metadata say")
    else:
        note_size(shape, camera, folder=folder)


@record
class PlanScan(_PlanOfCamera):
    """Plan a scan, and show its positions, time, disk space and memory.

    Examples
    --------
    >>> from lfcal.tasks import PlanScan
    >>> (planned,) = PlanScan(camera="bench", virtual_depths="3,4", exposure=0.1).run()
    >>> print(planned.forecast.positions, "positions:", planned.plan.shape)
    1254 positions: (2, 19, 33, 49, 49)
    """

    input_words: ClassVar[str] = "a scan of one region"

    half_cell: bool = opt(
        False, "Record only half of a hexagonal period. The other half has the same patterns.", more=True
    )
    peak: float | str | None = opt(
        None,
        "Brightest pixel, as a fraction of the full well. If this fraction is given, the noise of H is predicted.",
        label="Brightest pixel",
        above=0,
        at_most=1,
        empty="no prediction of the noise",
        read=read_share,
        more=True,
    )
    list_file: Path | None = opt(
        None,
        "File for the list of positions of a half-cell scan (.json), to be used with lfcal acquire.",
        label="List of positions",
        flag="--list",
        file="out",
        needs=("half_cell", ""),
        empty="not written",
        more=True,
    )

    written_as: str = opt(
        "plan",
        "Format of the written file. csv and useq are for other programs that record the frames: a table of stage "
        "positions, or a sequence of useq-schema.",
        label="File format",
        flag="--as",
        choices=tuple(PLAN_FORMATS),
        needs=("out", ""),
        more=True,
    )

    def _write(self, plan: ScanPlan, positions: NDArray[np.intp] | None) -> None:
        if self.out is None or self.written_as == "plan":
            super()._write(plan, positions)
            return
        write_text(self.out, plan_text(plan, self.written_as, positions))
        note(f"{self.out.name} is for another program; to assemble H, write the plan too (lfcal plan … -o plan.json)")

    def work(self, run: RunSettings | None = None) -> Work[tuple[Planned, ...]]:
        """Plan the scan, write the plan and the list of positions if requested, and predict the noise if requested."""
        from lfcal.camera import half_cell

        yield from ()
        plan = self.scan(load_camera(self.camera, light=False))
        half = half_cell(plan).half(plan) if self.half_cell else None
        planned = self._planned(plan, half)
        if half is not None and self.list_file is not None:
            from lfcal.acquire import RedoList

            RedoList.of(half.tolist()).write(self.list_file)
        if self.peak is not None:
            planned.facts["noise"] = yield from self._noise(plan, float(self.peak))
        return (planned,)

    def _noise(self, plan: ScanPlan, peak: float) -> Work[tuple[float, ...] | None]:
        """Return the expected relative rms noise of each plane; None, with a note, if sensor values are assumed."""
        from lfcal.camera import not_stated_for_noise
        from lfcal.simulate import iter_expected_light

        if unknown := not_stated_for_noise(plan.camera):
            note(f"the noise of H is not predicted, because of assumed values: {', '.join(unknown)}")
            return None
        light = yield from iter_expected_light(plan)
        return light.noise(plan, peak)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task for the ``given`` values."""
    if given.get("positions"):
        return PlanRecorded
    return PlanRegions if given.get("regions") else PlanScan


PLAN = TaskSet(
    "plan",
    (PlanScan, PlanRegions, PlanRecorded),
    kind_of,
    "lfcal plan r29 --virtual-depths 2:5.5:0.35 -o plan.json",
)
