"""Settings of Record > Rig. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from lfcal.acquire import Options
from lfcal.base import InputError, check_choice
from lfcal.camera import ScanPlan
from lfcal.records import rows
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil
from lfcal_gui.models import UNKNOWN, Field, PageSettings, fields_of, shown_of, value_in

if TYPE_CHECKING:
    from lfcal.campaign import Goal

EXTENTS = (("whole", "Record every position"), ("error", "Record until H is accurate"))
"""Choices of the extent of a recording."""

HELD = frozenset(
    {
        *("plan", "out", "redo", "backend", "stage", "option", "order"),
        *("assemble", "pack", "dry_run", "frame_rate"),
    }
)
"""Fields of `lfcal.tasks.Acquire` and `lfcal.tasks.AcquireUntil` that are not in the form.

The page has other widgets for the fields of the first line. Other buttons assemble and pack a session. Set up shows
the cost at a frame rate.
"""

ORDER = Field(
    "order",
    "Order",
    kind="choice",
    choices=(("serpentine", "serpentine"), ("raster", "raster"), ("coarse", "coarse grid first")),
    default="serpentine",
    tip="Serpentine: no long return moves. Raster: every row in the same direction. Coarse: all "
    "planes on a coarse grid first, the rest afterwards",
)
AVERAGED = Field("frames_averaged", "Frames averaged", "", "Exposures averaged at each position", kind="int", default=1)

_MORE = fields_of(Acquire, without=HELD, more=True)

RARE = ("positions", "unknowns")
"""Fields that are folded, although their task lists them first."""

_ENDS = fields_of(AcquireUntil, without={*HELD, *(row.name for row in rows(Acquire))})

FIELDS = (ORDER, AVERAGED, *fields_of(Acquire, without={*HELD, *RARE}, more=False))
UNTIL = tuple(one for one in _ENDS if one.key not in RARE)
"""Fields that determine when a recording of chosen positions ends."""
MORE = (
    *(one for one in (*fields_of(Acquire, without=HELD), *_ENDS) if one.key in RARE),
    # the plan has an origin
    *(replace(one, default=UNKNOWN if one.key == "origin" else one.default) for one in _MORE),
)

BEGUN = ("order", "bracket", "margin", "darks", "dark_every", "reference_every", "controls", "positions")
"""Fields that keep their initial values in a resumed session."""

EARLIER = {
    "error": "until_error",
    "margin_px": "margin",
    "steady_s": "steady",
    "tolerance_um": "tolerance",
    "overshoot_um": "overshoot",
}
"""Names of settings in project files of earlier versions."""


@dataclass(frozen=True)
class AcquireSettings(PageSettings):
    """Settings of the page; all other choices are in the plan.

    Attributes
    ----------
    backend, stage
        Names of the device backend and of the backend of the stage (empty: the same).
    device_options
        Options of the backend as pairs of name and text.
    target
        File of the target plan that is recorded instead of the scan; empty: the scan.
    extent
        ``"whole"``: every position; ``"error"``: until H reaches a relative error.
    until_error, most, order, darks, ...
        As in `lfcal.tasks.AcquireUntil` and `lfcal.tasks.Acquire`.
    """

    page: ClassVar[str] = "acquire"

    backend: str = "sim"
    stage: str = ""
    device_options: tuple[tuple[str, str], ...] = ()
    target: str = ""
    extent: str = "whole"
    until_error: float = 0.005
    most: int | None = None
    unknowns: tuple[str, ...] = ()
    positions: str = ""
    order: str | None = None
    darks: int | None = None
    dark_every: int | None = None
    cover: bool = False
    reference_every: int | None = None
    controls: int | None = None
    bracket: tuple[float, ...] | None = None
    retries: int | None = None
    on_suspect: str | None = None
    allow_automatic: bool = False
    suspend: tuple[str, ...] = ()
    steady: float | None = None
    tolerance: tuple[float, ...] | None = None
    overshoot: tuple[float, ...] | None = None
    keep_free: float | None = None
    margin: int | None = None
    check_stage: bool | None = None
    check_origin: bool = True

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``, and why values were refused; earlier versions stored all defaults."""
        return super().read(_renewed(data) if isinstance(data, Mapping) else data)

    def usable(self) -> None:
        """Raise `InputError` if the options do not match."""
        check_choice("positions to record", self.extent, tuple(key for key, _ in EXTENTS))
        dict(self.device_options)
        self.options()
        first = AcquireSettings()
        if any(getattr(self, one.key) != getattr(first, one.key) for one in _ENDS):
            self._until("plan.json", "session")

    def devices(self) -> dict[str, str]:
        """Return the options of the backend; for the simulator they include the recorded target."""
        options = dict(self.device_options)
        return {"target": self.target, **options} if self.target and self.backend == "sim" else options

    def task(
        self, plan: str, out: str, *, begun: bool = False, redo: str = "", origin: tuple[float, ...] | None = None
    ) -> Acquire | AcquireTarget | AcquireUntil:
        """Return the task that records the session.

        Parameters
        ----------
        plan, out
            File of the plan, and folder of the session.
        begun
            Whether the folder contains a session to resume, which keeps its initial options.
        redo
            File with the positions to record again; empty: none.
        origin
            Stage coordinates (µm) of the sensor centre, which replace those in the file of a target plan.
        """
        again = Path(redo) if redo else None
        if self.target:
            return AcquireTarget(**self._given(AcquireTarget, plan, out, begun=begun), redo=again, origin=origin)
        if self.extent == "error" and not redo:
            return self._until(plan, out, begun=begun)
        return Acquire(**self._given(Acquire, plan, out, begun=begun), redo=again)

    def _until(self, plan: str, out: str, *, begun: bool = False) -> AcquireUntil:
        return AcquireUntil(**self._given(AcquireUntil, plan, out, begun=begun))

    def _given(self, kind: type, plan: str, out: str, *, begun: bool) -> dict[str, Any]:
        names = {row.name for row in rows(kind)} - set(BEGUN if begun else ())
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name in names}
        option = tuple(f"{name}={value}" for name, value in self.devices().items())
        return own | {"plan": Path(plan), "out": Path(out), "option": option}

    def options(self) -> Options:
        """Return the options of a new session; raises `InputError` if they do not match."""
        return replace(self, extent="whole").task("plan.json", "session").options()

    def goal(self) -> Goal | None:
        """Return the goal that ends the recording; None if every position is recorded."""
        task = self.task("plan.json", "session")
        return task.goal if isinstance(task, AcquireUntil) else None

    def values(self, plan: ScanPlan) -> dict[str, Any]:
        """Return the value of every field of the form."""
        own = {one.name: getattr(self, one.name) for one in fields(self)} | {"most": self.most or None}
        shown = shown_of(AcquireUntil, own) | shown_of(Acquire, own | {"origin": plan.stage.origin_um})
        order = "coarse" if self.order == "coarse" else plan.order
        shown |= {"order": order, "frames_averaged": plan.frames_averaged}
        return {spec.key: shown[spec.key] for spec in (*FIELDS, *MORE, *UNTIL)}

    def changed_on(self, plan: ScanPlan, key: str, value: Any) -> tuple[AcquireSettings, ScanPlan]:
        """Return settings and plan with one field changed; raise `LfcalError` if the value is refused."""
        settings = self
        if key == "order":
            settings = replace(self, order="coarse" if value == "coarse" else None)
            plan = plan if value == "coarse" else replace(plan, order=value)
        elif key == "frames_averaged":
            plan = replace(plan, frames_averaged=value)
        elif key == "origin":
            plan = moved(plan, value_in(Acquire, key, value))
        elif key == "extent":
            settings = replace(self, extent=value)
        elif key == "positions":
            settings = replace(self, positions=str(value_in(Acquire, key, value) or ""))
        else:
            settings = replace(self, **{key: value_in(AcquireUntil, key, value)})
        settings.usable()
        settings.options().motion(plan)
        return settings, plan


def _renewed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of an earlier version under their current names, without its defaults."""
    if not {"coarse", *EARLIER}.intersection(data):
        return dict(data)
    defaults = Options().to_dict() | {"tolerance_um": (), "most": None, "suspend": ""}
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
    found = {EARLIER.get(key, key): data[key] for key, value in given.items() if value != defaults.get(key, ...)}
    if found.pop("coarse", False):
        found["order"] = "coarse"
    if isinstance(found.get("suspend"), str):
        found["suspend"] = [part.strip() for part in found["suspend"].split(";") if part.strip()]
    if not found.get("suspend"):
        found.pop("steady", None)
    if found.get("darks") == 0:
        found.pop("dark_every", None)
    return found


def moved(plan: ScanPlan, origin: tuple[float, ...] | None) -> ScanPlan:
    """Return ``plan`` with ``origin`` (µm), the stage position whose image is at the sensor centre.

    Raise `InputError` unless ``origin`` has three values.
    """
    if origin is None or len(origin) != 3:
        raise InputError.expected("Origin", "X,Y,Z in µm", origin or "none", "enter three numbers: 100,-20,1500")
    x, y, z = origin
    return replace(plan, stage=replace(plan.stage, origin_um=(x, y, z)))


def target_of(plan: ScanPlan, z: int) -> tuple[float, float, float]:
    """Return the stage position of the middle of the period in plane ``z`` (µm)."""
    if not 0 <= z < len(plan.depths_um):
        raise InputError.expected("depth plane", f"0 to {len(plan.depths_um) - 1}", z, "choose a plane of the scan")
    ny, nx = plan.period
    x, y, depth = plan.stage_um(np.array([z, ny // 2, nx // 2])).tolist()
    return x, y, depth
