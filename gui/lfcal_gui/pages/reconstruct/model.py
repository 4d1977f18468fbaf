"""Settings of a reconstruction, and their conversion to a task. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from lfcal.base import InputError, any_of
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import (
    METHODS,
    SOLVERS,
    BootstrapSettings,
    LightFieldSettings,
    ProjectionSettings,
    Resampling,
    RlNesterovSolver,
    SharedOptics,
    SolverChoice,
    VoxelGrid,
    lattice_anchor_of,
    resampling_for,
    usual_margin,
)
from lfcal.reconstruct.solvers import GOALS, OPTIONS, STOPS
from lfcal.records import SOLVER_ENDS, SolverFields, rows
from lfcal.tasks import Reconstruct, ReconstructBars, solver_settings
from lfcal_gui.models import Field, PageSettings, fields_of, value_in

if TYPE_CHECKING:
    from lfcal.reconstruct import MetricGrid

DEVICE = Field(
    "device",
    "Device",
    kind="choice",
    choices=(("auto", "auto"), ("cpu", "cpu: processor"), ("cuda", "cuda: accelerator")),
    tip="Device that applies H. auto: an accelerator, if there is one that supports the method and has enough memory; "
    "else the processor",
)

NO_DEVICE = (
    "Greyed out because this machine has no accelerator that PyTorch or CuPy can use. The "
    "processor computes everything. If there is a graphics card, install torch, or cupy and "
    "array-api-compat."
)

ENDS = {end: words for words, end in SOLVER_ENDS.items()}
"""Value of the task's number of iterations for each stopping rule."""

ROWS = {one.key: one for one in (*fields_of(ReconstructBars), *fields_of(Reconstruct))}
"""Fields that are used as the tasks declare them."""


BARS = ("labels", "crop", "fit", "replicates")
"""Keys of fields that only error bars use."""


def _short(key: str, empty: str) -> Field:
    """Return a field of the task with the meaning of an empty value in its tooltip, because the field is short."""
    return replace(ROWS[key], empty=empty, tip=f"{ROWS[key].tip.rstrip('.')}. Empty: {ROWS[key].empty}")


CHECKED = tuple(
    row
    for row in rows(Reconstruct)
    if row.name in ("background", "read_noise", "saturation", "strength", "subsets", "gain", "goal")
    or row.name in ("threshold", "within", "tolerance", "memory")
)
"""Fields of the task that are always checked, even if the solver does not use them."""

FIELDS: tuple[Field, ...] = (
    Field(
        "solver",
        "Solver",
        kind="choice",
        choices=tuple((name, name) for name in SOLVERS.names()),
        tip="; ".join(f"{solver.name}: {solver.title}" for solver in SOLVERS),
    ),
    Field("iterations", "Iterations", "", "Number of iterations. The button Run more adds the same number", kind="int"),
    Field(
        "stop",
        "End at",
        kind="choice",
        choices=(("", "count"), ("left-out", "held-out"), ("discrepancy", "noise")),
        tip="Count: after the number of iterations. Held-out: when the prediction of held-out pixels "
        "(1 in 25) no longer improves; the best volume is kept. Noise: when the residual is as "
        "small as photon and read noise",
    ),
    ROWS["goal"],
    replace(ROWS["gain"], optional=False),
    ROWS["background"],
    ROWS["read_noise"],
    ROWS["saturation"],
    _short("strength", "usual"),
    _short("subsets", "usual"),
    ROWS["tolerance"],
    Field(
        "method",
        "Projector",
        kind="choice",
        choices=tuple((m, m) for m in ("auto", *METHODS)),
        tip="Method that applies H. auto: the method that is predicted to be fastest in the available memory",
    ),
    DEVICE,
    Field(
        "threshold",
        "Threshold",
        "% of peak",
        "Entries of H below this percentage of the peak of their plane are set to zero, which is faster but less exact",
        scale=0.01,
    ),
    Field(
        "within",
        "Within",
        "% of light",
        "Percentage of the light that projections may miss. With 0.5 %, a simulated or fitted H "
        "is several times faster",
        scale=0.01,
    ),
    Field(
        "margin",
        "Margin",
        "px",
        "Number of pixels by which the volume extends beyond the light field, for light from outside. Empty: automatic",
        kind="int",
        optional=True,
        empty="auto",
    ),
    Field(
        "voxel",
        "Voxel size",
        "µm",
        "Side of the voxels in a saved volume, the same in all planes. auto: the smallest size "
        "of all planes. Empty: no resampling; with a main lens, the size then differs between "
        "planes",
        kind="text",
        empty="by pixel",
    ),
    replace(ROWS["double"], label="Compute in double"),  # two lines: the column is narrow
    ROWS["memory"],
    Field(
        "as_is",
        "As is",
        kind="bool",
        tip="Use the light field without resampling. By default, it is resampled to the period of H "
        "if the lattice of the camera drifts by more than 0.5 px over the frame",
    ),
    Field(
        "region",
        "Region",
        "px",
        "First row, first column, rows and columns of the light field. Empty: all of it",
        kind="floats",
        empty="all",
    ),
    Field(
        "anchor",
        "Anchor",
        "px",
        "Row and column at which position (0, 0) of H is imaged. Empty: the anchor of H",
        kind="floats",
        empty="of H",
    ),
    ROWS["dark"],
    ROWS["white"],
    ROWS["mask"],
    _short("lattice", "found"),
    ROWS["regions"],
    replace(_short("labels", "none"), label="Labels"),
    ROWS["crop"],
    _short("fit", "exact H"),
    ROWS["replicates"],
)

FIELDS = tuple(replace(one, group=ROWS[one.key].group if one.key in ROWS else one.group) for one in FIELDS)

BASIC = ("solver", "iterations")
"""Keys of fields that are always visible."""


def device_reason() -> str:
    """Return why no accelerator can be chosen; empty if one can. Loads libraries, which may take seconds.

    An accelerator that computes wrong results is ignored.
    """
    from lfcal.reconstruct.projectors import find_device

    # a machine without a driver loads no library for it
    return "" if find_device("auto") is not None else NO_DEVICE


def used_by(solver: str, key: str) -> bool:
    """Return whether the field ``key`` applies to ``solver``; solvers without weights have no margin."""
    key = "weights" if key == "margin" else key
    return key not in OPTIONS or key in SOLVERS.get(solver).honours


@dataclass(frozen=True)
class ReconstructSettings(PageSettings):
    """Settings of the page.

    Attributes
    ----------
    solver, iterations, background, read_noise, saturation, strength, subsets, gain, tolerance
        As in `lfcal.reconstruct.solvers.choice.SolverChoice`.
    stop
        Stopping rule, as in `SolverChoice`; empty: stop after ``iterations``.
    memory
        Largest memory (GB). None: 80 % of the free memory.
    method, device, threshold, within, double
        As in `lfcal.reconstruct.Projector`, ``within`` its ``tolerance``.
    margin
        Pixels of the volume beyond each edge of the region. None: `lfcal.reconstruct.margin.usual_margin`.
    voxel
        Side of the voxels of a saved volume (µm); ``"auto"``: the smallest of all planes; empty: one voxel per pixel.
    region
        First row and column, rows and columns of the light field; empty: all.
    anchor
        Pixel (row, column) of the whole light field at which H's position (0, 0) is imaged; empty: that of H.
    goal
        As in `SolverChoice`; only for stopping by held-out pixels.
    as_is
        Whether the light field is used without resampling, even if the lattice drifts relative to the period of H.
    dark, white, mask, lattice, regions
        As in `lfcal.tasks.Reconstruct`; several regions have a semicolon between them.
    labels, crop, fit, replicates
        As in `lfcal.tasks.ReconstructBars`.
    """

    page: ClassVar[str] = "reconstruct"

    solver: str = SolverChoice().name
    iterations: int = SolverChoice().iterations
    stop: str = ""
    gain: float = 1.0
    background: float = 0.0
    read_noise: float = 0.0
    saturation: float | None = None
    strength: float | None = None
    subsets: int | None = None
    method: str = "auto"
    device: str = DEVICE.choices[0][0]
    threshold: float = 0.0
    within: float = 0.0
    margin: int | None = None
    voxel: str = ""
    double: bool = False
    region: tuple[float, ...] = ()
    anchor: tuple[float, ...] = ()
    as_is: bool = False
    goal: str = GOALS[0]
    tolerance: float = 0.0
    memory: float | None = None
    dark: str = ""
    white: str = ""
    mask: str = ""
    lattice: str = ""
    regions: str = ""
    labels: str = ""
    crop: bool = False
    fit: str = ""
    replicates: int = BootstrapSettings().replicates

    def __post_init__(self) -> None:
        """Check values that the library would refuse only after the work has started."""
        if self.stop not in ("", *STOPS):
            raise InputError.expected("end", any_of(("no value", *STOPS)), repr(self.stop), "choose one of these")
        for row in CHECKED:
            row.check(getattr(self, row.name), row.label)
        BootstrapSettings(replicates=self.replicates)
        if not 1 <= self.iterations <= 100_000:
            raise InputError.expected("iterations", "1 to 100000", self.iterations, "enter a number such as 20")
        if self.margin is not None and self.margin < 0:
            raise InputError.expected("margin", "0 px or more", self.margin, "enter 0 for no margin")
        if self.voxel not in ("", "auto"):
            _side(self.voxel)
        if len(self.region) not in (0, 4) or any(v < 0 or v != int(v) for v in self.region) or 0 in self.region[2:]:
            raise InputError.expected(
                "region",
                "first row, first column, rows and columns in whole pixels",
                self.region,
                "enter four numbers, for example 0, 0, 400, 400",
            )
        if self.device not in dict(DEVICE.choices):
            raise InputError.expected("device", "auto, cpu or cuda", repr(self.device), "choose one of these")
        if len(self.anchor) not in (0, 2):
            raise InputError.expected(
                "anchor", "row, column in pixels", self.anchor, "enter two numbers, for example 12, 7"
            )
        if self.lattice and self.as_is:
            raise InputError.expected(
                "lattice", "no file, because “As is” is ticked", self.lattice, "clear Lattice, or untick As is"
            )
        if self.lattice and self.other_regions:
            raise InputError.expected(
                "lattice", "no file for an H of several regions", self.lattice, "clear Lattice, or use one region"
            )

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the settings in ``data``. Earlier projects had a single stopping rule, ``auto``."""
        if isinstance(data, Mapping) and data.get("auto") is True:
            data = {"stop": STOPS[0], **data}
        return super().from_dict(data)

    @property
    def ends_by_itself(self) -> bool:
        """Whether the solver stops automatically; a solver without weights cannot hold out pixels."""
        return bool(self.stop) and (self.stop != STOPS[0] or used_by(self.solver, "weights"))

    def usable(self) -> None:
        """Raise `InputError` if solver and settings do not match."""
        self.choice()

    def solver_fields(self) -> SolverFields:
        """Return the solver with the settings it uses; greyed-out settings are kept for other solvers."""
        options = ("background", "read_noise", "saturation", "strength", "subsets", "tolerance")
        used = {key: getattr(self, key) for key in options if used_by(self.solver, key)}
        if self.ends_by_itself:
            used["iterations"] = ENDS[self.stop]
            used["goal"] = self.goal if self.stop == STOPS[0] else GOALS[0]
        if self.ends_by_itself and self.stop == "discrepancy":
            used["gain"] = self.gain
        return solver_settings(self.solver, **{"iterations": self.iterations, **used})

    def choice(self) -> SolverChoice:
        """Return the solver choice of the library, without an automatic margin."""
        return SolverChoice.of(self.solver_fields(), margin=self.margin or 0 if used_by(self.solver, "margin") else 0)

    @property
    def light_field(self) -> LightFieldSettings:
        """Corrections of the light field before the reconstruction."""
        resample = "never" if self.as_is else "auto"
        files = {"dark": self.dark, "white": self.white, "mask": self.mask, "lattice": self.lattice}
        return LightFieldSettings(**files, resample=resample)

    @property
    def other_regions(self) -> tuple[str, ...]:
        """H files of other regions, as in the task."""
        named: tuple[str, ...] = value_in(Reconstruct, "regions", self.regions)
        return named

    @property
    def projection(self) -> ProjectionSettings:
        """Settings of the projector, which applies H."""
        return ProjectionSettings(
            method=self.method,
            device=self.device,
            threshold=self.threshold,
            within=self.within,
            double=self.double,
            memory=self.memory,
        )

    def optics(self, psf: str, mat_order: str = "") -> SharedOptics:
        """Return the settings with which the H in the file ``psf`` is opened and applied."""
        return SharedOptics(Path(psf), self.other_regions, mat_order, self.light_field, self.projection)

    def choice_for(self, H: PSFMatrix, shape: tuple[int, int]) -> SolverChoice:
        """Return the solver choice for the used region of images of ``shape``; the margin is automatic if not set."""
        choice = self.choice()
        if self.margin is not None or not used_by(self.solver, "margin"):
            return choice
        rows, columns = self.window(shape)
        used = rows.stop - rows.start, columns.stop - columns.start
        return replace(choice, margin=usual_margin(H.period, (H.shape[3], H.shape[4]), used))

    def grid(self, H: PSFMatrix, shape: tuple[int, int], view: Resampling | None = None) -> MetricGrid | None:
        """Return the grid of equal voxels for the used region of images of ``shape``. None: one voxel per pixel.

        ``view``: how the light field was resampled to these images.

        Raises
        ------
        InputError
            If H has no camera, or the size makes too many voxels.
        """
        from lfcal.reconstruct import MetricGrid

        if not self.voxel:
            return None
        side = None if self.voxel == "auto" else _side(self.voxel)
        rows, columns = self.window(shape)
        anchor = None
        if self.anchor or self.region:
            row, column = self.place(H, None)
            anchor = row - rows.start, column - columns.start
        used = rows.stop - rows.start, columns.stop - columns.start
        if view is not None:
            view = replace(view, centre=(view.centre[0] - rows.start, view.centre[1] - columns.start))
        return MetricGrid.for_matrix(H, used, anchor, side, view)

    def place(self, H: PSFMatrix, view: Resampling | None) -> tuple[float, float]:
        """Return the pixel (row, column) of the full image at which position (0, 0) of H is imaged."""
        if self.anchor:
            return self.anchor[0], self.anchor[1]
        return H.anchor if view is None else view.anchor(lattice_anchor_of(H))

    def view(self, H: PSFMatrix, shape: tuple[int, int]) -> Resampling | None:
        """Return how a light field of ``shape`` is resampled to the period of H. None: not resampled."""
        placed = next((name for name in ("regions", "anchor", "region") if getattr(self, name)), "")
        return resampling_for(H, shape, self.light_field, placed)

    def window(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Return rows and columns of a light field of ``shape`` to be used; raises `InputError` if outside."""
        if not self.region:
            return slice(0, shape[0]), slice(0, shape[1])
        row, column, rows, columns = (int(v) for v in self.region)
        if row + rows > shape[0] or column + columns > shape[1]:
            raise InputError.expected(
                "region",
                f"a region inside the light field of {shape[0]} × {shape[1]} px",
                (row, column, rows, columns),
                "choose a region inside the light field",
            )
        return slice(row, row + rows), slice(column, column + columns)


def task_of(settings: ReconstructSettings, psf: str, frame: str, out: str, mat_order: str = "") -> Reconstruct:
    """Return the task that reconstructs a volume from a light field in a file; ``settings.region`` is ignored."""
    margin = settings.margin if used_by(settings.solver, "margin") else 0
    side = settings.voxel if settings.voxel in ("", "auto") else _side(settings.voxel)
    return Reconstruct(
        out=Path(out),
        solver=settings.solver_fields(),
        grid=_grid(settings, margin, side or None),
        **_inputs(settings, psf, frame, mat_order),
    )


def bars_task_of(settings: ReconstructSettings, psf: str, frame: str, out: str, mat_order: str = "") -> ReconstructBars:
    """Return the task that reconstructs a volume with error bars; ``settings.region`` is ignored.

    The solver is the default of the task, because the intervals were tested with it.
    """
    known = {key: getattr(settings, key) for key in ("background", "read_noise", "saturation")}
    gain = settings.gain if settings.stop == "discrepancy" else None
    return ReconstructBars(
        out=Path(out),
        solver=RlNesterovSolver(iterations=60, gain=gain, **known),
        grid=_grid(settings, settings.margin, None),
        labels=Path(settings.labels) if settings.labels else None,
        crop=settings.crop,
        fit=Path(settings.fit) if settings.fit else None,
        bootstrap=BootstrapSettings(replicates=settings.replicates),
        **_inputs(settings, psf, frame, mat_order),
    )


def _inputs(settings: ReconstructSettings, psf: str, frame: str, mat_order: str) -> dict[str, Any]:
    """Return the fields of a task for H, the light field, and the projection."""
    return {
        "psf": Path(psf),
        "frames": Path(frame),
        "regions": settings.other_regions,
        "mat_order": mat_order,
        "light_field": settings.light_field,
        "projection": settings.projection,
    }


def _grid(settings: ReconstructSettings, margin: int | None, side: Any) -> VoxelGrid:
    row, column = settings.anchor or (0.0, 0.0)
    anchor = (row, column) if settings.anchor else None
    return VoxelGrid(voxel=side, margin="auto" if margin is None else margin, anchor=anchor)


def _side(text: str) -> float:
    """Return the side of a voxel (µm) given as text; raise `InputError` if it is invalid."""
    try:
        side = float(text)
    except ValueError:
        side = math.nan
    if not 0 < side < math.inf:
        raise InputError.expected(
            "voxel size", "a positive number of µm, auto, or nothing", repr(text), "enter a size such as 5"
        )
    return side
