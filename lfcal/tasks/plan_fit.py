"""Choose a few positions of a scan for a fit of the optics, and predict the error of H."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from lfcal.base import Work
from lfcal.records import opt, read_names, read_share, record, required, show_names
from lfcal.tasks.planned import Planned, PlanTask, scan_of
from lfcal.tasks.task import RunSettings, TaskSet

if TYPE_CHECKING:
    from lfcal.acquire import RedoList
    from lfcal.camera import ScanPlan
    from lfcal.fit import Earlier, PositionDesign

__all__ = ["PLAN_FIT", "PlanFit", "PositionsPlanned"]

POSITION_ERROR = 0.05
"""Error of source positions (px rms) if no fit states it."""

CHOSEN, HELD_OUT = "chosen to fit the optics", "held out to check the fit"
"""Reasons stated in the list of positions: to fit, or to hold out."""


def _groups() -> tuple[str, ...]:
    from lfcal.fit import GROUPS

    return tuple(GROUPS.names())


@dataclass(frozen=True, kw_only=True)
class PositionsPlanned(Planned):
    """Positions chosen for a fit, with the expected error of H.

    ``earlier`` is the fit to whose positions they are added, None if there is none.
    """

    plan: PositionDesign
    earlier: Earlier | None

    @property
    def listed(self) -> RedoList:
        """List of the positions for ``lfcal acquire``: those to fit, then those to hold out."""
        from lfcal.acquire import RedoList

        fitted, held_out = self.plan.fitted.tolist(), self.plan.held_out.tolist()
        reasons = [CHOSEN] * len(fitted) + [HELD_OUT] * len(held_out)
        return RedoList.of([*fitted, *held_out], reasons, kept_aside=held_out)


@record
class PlanFit(PlanTask):
    """Choose the few positions of a scan that a fit of the optics needs, and predict the error of H.

    Examples
    --------
    >>> from lfcal.tasks import PlanFit
    >>> (chosen,) = PlanFit(plan="session/plan.json", count=5, unknowns="iris", candidates=12).run()
    >>> print(len(chosen.plan.fitted), "positions to fit,", len(chosen.plan.held_out), "to check the fit")
    4 positions to fit, 1 to check the fit
    """

    name: ClassVar[str] = "plan fit"

    plan: Path = required("Scan plan (.json), made by lfcal plan.", argument=True, file="in")
    count: int = required(
        "Number of positions to choose. One fifth of them is held out to check the fit.",
        label="Positions",
        short="-n",
        at_least=1,
    )
    out: Path | None = opt(
        None,
        "File for the list of positions (.json), to be used with lfcal acquire.",
        label="List of positions",
        short="-o",
        file="out",
        empty="not written",
    )
    earlier: Path | None = opt(
        None,
        "Folder of an earlier fit (lfcal fit), to whose positions the chosen ones are added.",
        label="Earlier fit",
        flag="--from",
        file="in",
        empty="no earlier fit",
    )
    unknowns: str | tuple[str, ...] = opt(
        (),
        "Groups of unknowns to fit, separated by commas.",
        choices=_groups,
        read=read_names,
        show=show_names,
        empty="the groups of the earlier fit, else geometry,focal_lengths,iris",
    )
    full: float = opt(
        0.8,
        "Brightest pixel of the scan, as a fraction of the full well.",
        label="Brightest pixel",
        above=0,
        at_most=1,
        read=read_share,
        more=True,
    )
    position_error: float | None = opt(
        None,
        "Position error of the source (rms).",
        unit="px",
        at_least=0,
        at_most=5,
        empty="as in the earlier fit, else 0.05",
        more=True,
    )
    candidates: int = opt(
        300,
        "Number of candidate positions, spread evenly over the scan. 0 considers all positions.",
        at_least=0,
        more=True,
    )
    draw: Path | None = opt(
        None,
        "File for a plot of the expected error (.png).",
        label="Plot",
        file="out",
        empty="not drawn",
        more=True,
    )

    def work(self, run: RunSettings | None = None) -> Work[tuple[PositionsPlanned, ...]]:
        """Choose the positions, and write their list and the plot if requested."""
        from lfcal.fit import draw_design

        made = yield from self.iter_planned(scan_of(self.plan), run)
        if self.out is not None:
            made.listed.write(self.out)
        if self.draw is not None:
            draw_design(made.plan, self.draw, made.forecast.positions, made.forecast.hours)
        return (made,)

    def iter_planned(self, scan: ScanPlan, run: RunSettings | None = None) -> Work[PositionsPlanned]:
        """Choose the positions of a scan, and write nothing."""
        from lfcal.fit import Expected, Spread, iter_next_positions, read_earlier

        earlier = None if self.earlier is None else read_earlier(self.earlier)
        whole = self.forecast(scan)
        # from the earlier fit, or else the usual value
        spread = Spread(POSITION_ERROR) if earlier is None else earlier.spread
        if self.position_error is not None:
            spread = replace(spread, stage_px=self.position_error)
        found = yield from iter_next_positions(
            scan,
            self.count,
            groups=self.unknowns or None,
            earlier=earlier,
            expected=Expected(self.full, **asdict(spread)),
            candidates=self.candidates,
            **self.rates,
            workers=run.workers if run else None,
        )
        facts = {
            "positions": found.positions,
            "kept_aside": found.held_out,
            "curve": found.curve,
            "pattern_error": found.pattern_error,
            "start_error": found.start_error,
            "sigmas": found.sigmas,
            "candidates": found.candidates,
            "whole_scan": {"positions": whole.positions, "hours": whole.hours, "readout_hours": whole.readout_hours},
            "files": self.files("out"),
        }
        return PositionsPlanned(task=self, plan=found, forecast=whole, facts=facts, earlier=earlier)


PLAN_FIT = TaskSet("plan fit", (PlanFit,), lambda given: PlanFit, "lfcal plan fit plan.json -n 24 -o positions.json")
