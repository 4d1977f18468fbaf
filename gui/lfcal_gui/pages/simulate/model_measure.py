"""Plan of the bead frames that determine undescribed effects: its words, its files, and what it changes. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import Work, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal.tasks import PlanFit, PositionsPlanned
from lfcal_gui.models import CommandStep, ProjectState, list_beside

if TYPE_CHECKING:
    from lfcal.simulate import EffectMeasurement

BEADS_FILE = "beads.json"


@dataclass(frozen=True, eq=False)
class BeadPlan:
    """A scan of the depths at which bead frames show the effects, and the positions chosen for the fit.

    Attributes
    ----------
    measurement
        Measurement for which the frames are recorded.
    scan
        The plan of the project with these depths only.
    made
        The chosen positions.
    """

    measurement: EffectMeasurement
    scan: ScanPlan
    made: PositionsPlanned

    def words(self) -> str:
        """Return what is recorded, and the error that a fit is expected to reach, as text."""
        found, last = self.made.plan, self.made.plan.curve[-1]
        return (
            f"{len(found.fitted)} positions to fit the optics, {len(found.held_out)} held out to check the fit. "
            f"Recording: about {format_seconds(3600 * last.hours)}, without readout. "
            f"Expected error of H after the fit: {format_share(last.error)}."
        )

    def files(self, path: str | Path) -> dict[Path, str]:
        """Return the texts of the plan ``path`` and of the list of positions next to it, by file."""
        return {Path(path): self.scan.to_json(), list_beside(path): self.made.listed.to_json()}

    def step(self, path: str) -> CommandStep:
        """Return the step that makes the list of positions for the plan ``path``."""
        return CommandStep.of(bead_task(self.measurement, path), ((path, self.scan.to_json()),))

    def changes(self, project: ProjectState, positions: Path) -> dict[str, Any]:
        """Return the changes of the project with which these frames are recorded and the effects are then fitted."""
        recorded = {"positions": str(positions), "extent": "whole", "target": "", "order": None}
        fitted = {"auto": False, "groups": self.measurement.unknowns}
        settings = dict(project.settings)
        for page, values in (("acquire", recorded), ("fit", fitted)):
            own = settings.get(page)
            settings[page] = {**(own if isinstance(own, Mapping) else {}), **values}
        # the earlier folder belongs to the earlier plan
        return {"plan": self.scan, "recording": "", "redo": (), "settings": settings}


def bead_task(measurement: EffectMeasurement, path: str = BEADS_FILE) -> PlanFit:
    """Return the task that chooses the positions of bead frames in the plan ``path``."""
    return PlanFit(plan=Path(path), count=measurement.frames, unknowns=measurement.unknowns, out=list_beside(path))


def iter_beads(plan: ScanPlan, measurement: EffectMeasurement) -> Work[BeadPlan]:
    """Choose the positions of bead frames, as a job that writes nothing; ``plan`` is that of the project."""
    kept = [k for k, z_um in enumerate(plan.depths_um) if z_um in measurement.depths_um]
    scan = replace(plan, depths_um=measurement.depths_um, exposure_s=tuple(plan.exposures[k] for k in kept))
    made = yield from replace(bead_task(measurement), out=None).iter_planned(scan)
    return BeadPlan(measurement, scan, made)
