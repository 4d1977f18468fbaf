"""What the user chooses on the Acquire page. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lfcal.acquire import Options
from lfcal.base import InputError, check_choice, check_number
from lfcal.camera import ScanPlan
from lfcal_gui.models import Field, PageSettings

if TYPE_CHECKING:
    from lfcal.campaign import Goal

__all__ = ["EXTENTS", "FIELDS", "UNTIL", "AcquireSettings", "target_of"]

ORDERS = (("serpentine", "serpentine"), ("raster", "raster"), ("coarse", "coarse grid first"))

EXTENTS = (("whole", "Record every position"), ("error", "Record until H is known"))
"""How much is recorded."""

UNTIL = (
    Field("error", "H known to", "%", "Wanted error of H (relative L2), as the fit states it", scale=0.01),
    Field(
        "most",
        "At most",
        "pos.",
        "Positions recorded at most, also where the wanted error is not reached; empty: all of the plan",
        kind="int",
        optional=True,
    ),
)
"""What ends a recording that is not of every position."""

DOUBTS = (("stop", "stop"), ("flag", "keep and name"))

FIELDS = (
    Field(
        "order",
        "Order",
        kind="choice",
        choices=ORDERS,
        tip="Serpentine has no long return moves; raster scans every row in the same direction; coarse "
        "records all planes on a coarse grid first and the rest afterwards",
    ),
    Field("frames_averaged", "Frames averaged", "", "Exposures averaged at each position", kind="int"),
    Field(
        "bracket",
        "Exposures",
        "× plane's",
        "Factors of each plane's exposure, 1 among them, merged to a high dynamic range; 1 alone: no merging",
        kind="floats",
    ),
    Field(
        "darks", "Dark frames", "", "Exposures averaged into each dark frame, light off; 0: no dark frames", kind="int"
    ),
    Field(
        "dark_every",
        "Dark every",
        "pos.",
        "Dark frames again after so many positions; 0: at the start only",
        kind="int",
    ),
    Field(
        "reference_every",
        "Reference every",
        "pos.",
        "A frame at a fixed position every so many positions shows whether the lamp drifts; 0: none",
        kind="int",
    ),
    Field(
        "controls",
        "Control frames",
        "",
        "Per plane and direction, whole periods away up to the field's edge: shows whether the PSF is periodic",
        kind="int",
    ),
    Field("retries", "Retries", "", "How often a position is tried again after a temporary fault", kind="int"),
    Field(
        "on_suspect",
        "Doubtful frame",
        kind="choice",
        choices=DOUBTS,
        tip="What becomes of a frame that is not what it should be, taken again and still so (blank, repeated, torn, "
        "displaced, too light or dark): the session stops, or the frame is kept and its position named",
    ),
    Field(
        "check_stage",
        "Check the stage",
        kind="bool",
        tip="Sign, scale, scatter and depth of the stage are measured before the first frame, with some 16 frames. "
        "Without it a wrong stage makes a wrong H that looks right",
    ),
    Field(
        "allow_automatic",
        "Allow automatic",
        kind="bool",
        tip="Record although the camera's exposure, gain or black level stays automatic, or its gamma on: frames and H "
        "are then not proportional to light",
    ),
    Field(
        "suspend",
        "Hold unless",
        "",
        "The session holds while a gauge is out of bounds and goes on by itself: temperature=20:22; lamp=95:105, or "
        "the path of a text file that ends with the newest number. Empty: never",
        kind="text",
        empty="never",
    ),
    Field(
        "steady_s",
        "Go on after",
        "s",
        "How long all gauges must be within their bounds before a session that holds goes on",
    ),
    Field(
        "margin_px",
        "Margin",
        "px",
        "Recorded around the cutout; empty: what interpolation needs",
        kind="int",
        optional=True,
        empty="auto",
    ),
    Field(
        "tolerance_um",
        "Tolerance xyz",
        "µm",
        "Largest difference of measured and target position; empty: a tenth of a step laterally, one step in depth",
        kind="floats",
        empty="auto",
    ),
    Field(
        "overshoot_um",
        "Approach xyz",
        "µm",
        "Moves in the negative direction go this far beyond the "
        "target first, which takes up the backlash of the drive; 0: none",
        kind="floats",
    ),
)

FEWEST = 12
"""Positions before the first fit: no session that ends by it has fewer."""

DEFAULTS = Options()
"""What a session does unless it is told otherwise."""


@dataclass(frozen=True)
class AcquireSettings(PageSettings):
    """What the user chose on this page; the plan holds the rest.

    Attributes
    ----------
    backend, stage
        Names of the device backend, and of the one whose stage is used with it (empty: its own).
    device_options
        Pairs of name and text for the backend.
    target
        File of the plan of a target that is recorded in the place of the scan; empty: the scan.
    coarse
        Whether a coarse grid comes first.
    extent, error, most
        ``"whole"``: every position; ``"error"``: until H is known to this relative error, or so many are recorded.
    suspend
        Bounds of gauges separated by ``;``, each as `lfcal.acquire.Bound.parse` reads it.
    bracket, darks, dark_every, reference_every, controls, retries, on_suspect, allow_automatic, check_stage, steady_s,
    margin_px, tolerance_um, overshoot_um
        As in `lfcal.acquire.options.Options`; an empty tolerance is the default.
    """

    page: ClassVar[str] = "acquire"

    backend: str = "sim"
    stage: str = ""
    device_options: tuple[tuple[str, str], ...] = ()
    target: str = ""
    coarse: bool = False
    extent: str = "whole"
    error: float = 0.005
    most: int | None = None
    bracket: tuple[float, ...] = DEFAULTS.bracket
    darks: int = DEFAULTS.darks
    dark_every: int = DEFAULTS.dark_every
    reference_every: int = DEFAULTS.reference_every
    controls: int = DEFAULTS.controls
    retries: int = DEFAULTS.retries
    on_suspect: str = DEFAULTS.on_suspect
    allow_automatic: bool = DEFAULTS.allow_automatic
    check_stage: bool = DEFAULTS.check_stage
    suspend: str = ""
    steady_s: float = DEFAULTS.steady_s
    margin_px: int | None = DEFAULTS.margin_px
    tolerance_um: tuple[float, ...] = ()
    overshoot_um: tuple[float, ...] = DEFAULTS.overshoot_um

    def usable(self) -> None:
        """Raise `InputError` where the options do not go together."""
        self.options()
        self.goal()
        dict(self.device_options)

    def devices(self) -> dict[str, str]:
        """Return the options of the backend; the target that is recorded stands before the simulator."""
        options = dict(self.device_options)
        return {"target": self.target, **options} if self.target and self.backend == "sim" else options

    def options(self) -> Options:
        """Return the options of a session; raises `InputError` if they do not go together."""
        return Options(
            "coarse" if self.coarse else "plan",
            self.bracket,
            self.margin_px,
            self.darks,
            self.dark_every,
            self.reference_every,
            self.controls,
            self.retries,
            self.tolerance_um or None,
            self.overshoot_um,
            on_suspect=self.on_suspect,
            allow_automatic=self.allow_automatic,
            check_stage=self.check_stage,
            suspend=tuple(part.strip() for part in self.suspend.split(";") if part.strip()),
            steady_s=self.steady_s,
        )

    def goal(self) -> Goal | None:
        """Return when to end, None where every position is recorded; raises `InputError` for what is no error of H."""
        check_choice("positions to record", self.extent, tuple(key for key, _ in EXTENTS))
        check_number("wanted error of H (%)", 100 * self.error, at_least=0.06, below=100, remedy="for example 0.5")
        if self.most is not None:
            check_number("most positions", self.most, at_least=FEWEST, integer=True)
        if self.extent == "whole":
            return None
        from lfcal.campaign import Goal

        return Goal(self.error, most=self.most)

    def values(self, plan: ScanPlan) -> dict[str, Any]:
        """Return the value of every field of the form."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        order = "coarse" if self.coarse else plan.order
        return {spec.key: own.get(spec.key) for spec in (*UNTIL, *FIELDS)} | {
            "order": order,
            "frames_averaged": plan.frames_averaged,
        }

    def changed(self, plan: ScanPlan, key: str, value: Any) -> tuple[AcquireSettings, ScanPlan]:
        """Return settings and plan with one field changed; raises `LfcalError` if it cannot be."""
        settings = self
        if key == "order":
            settings = replace(self, coarse=value == "coarse")
            plan = plan if value == "coarse" else replace(plan, order=value)
        elif key == "frames_averaged":
            plan = replace(plan, frames_averaged=value)
        else:
            settings = replace(self, **{key: value})
        settings.options().motion(plan)
        settings.goal()
        return settings, plan


def target_of(plan: ScanPlan, z: int) -> tuple[float, float, float]:
    """Return the stage position of the middle of the cell in plane ``z`` (µm)."""
    if not 0 <= z < len(plan.depths_um):
        raise InputError.expected("depth plane", f"0 to {len(plan.depths_um) - 1}", z, "choose one")
    ny, nx = plan.period
    x, y, depth = plan.stage_um(np.array([z, ny // 2, nx // 2])).tolist()
    return x, y, depth
