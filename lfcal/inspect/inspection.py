"""What is wrong with an H: by its camera's model where there is one, beside the metrics that need none."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lfcal.fit.setup import Setup
from lfcal.inspect.compared import iter_evidence
from lfcal.inspect.cost import iter_costs
from lfcal.inspect.evidence import Evidence, Unlike
from lfcal.inspect.finding import Finding
from lfcal.inspect.metric_costs import FRAMES, as_findings, with_costs
from lfcal.inspect.search import iter_search
from lfcal.inspect.suspects import suspects
from lfcal.progress import Work
from lfcal.psf import PSFMatrix
from lfcal.psf.quality import QualityReport
from lfcal.psf.quality.metric import Merit, Metric
from lfcal.units import format_count, format_share

__all__ = ["BAD", "FAIR", "MEASURED", "Inspection", "is_bad", "is_fair", "iter_inspection", "worst_first"]

FAIR, BAD = 0.03, 0.1
"""Cost (NRMSE) of a fault from which on H is worth a look, and should not be used as it is."""

FAIR_SHARE, BAD_SHARE = 0.01, 0.05
"""The same of the share of the light that it changes, where no cost was measured."""

COST_OF = 0.25
"""Share of the time of a comparison that the patterns take on which costs are measured."""

ODDEST = 48
"""Suspected positions that are compared at most."""

EXPLAINED = 0.06
"""Share of the light that a camera may be off by, with all faults taken out, for these to be believed."""

KINDS, LARGE = 3, 0.02
"""Different faults, each of that share of the light at least, beyond which a camera that does not explain the patterns
as they are is likelier than all of them at once."""

MEASURED = frozenset(
    {
        "stage_gain",
        "drift",
        "backlash",
        "jitter",
        "position",
        "lamp",
        "flicker",
        "depth",
        "background",
        "hot_pixels",
    }
)
"""Keys of model-free metrics whose subject the comparison with a camera measures itself, and more surely."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """The metrics of an H, and what stands out beside its camera.

    Attributes
    ----------
    quality
        The metrics that need no model.
    findings
        Faults that were found, the costliest first.
    compared
        Patterns that were compared with the camera; 0: none.
    misfit
        Share of the light by which the camera is off as a rule.
    why_not
        Why nothing was compared; empty where it was.
    seconds
        What the comparison took.
    clean
        Error of a reconstruction by the noise of H alone (NRMSE); None: not measured.
    as_it_is
        The same of H as it is.

    Examples
    --------
    >>> from lfcal.inspect import Inspection, iter_inspection
    >>> from lfcal.progress import drain
    >>> from lfcal.psf import PSFMatrix, inspect, open_psf
    >>> with open_psf("H.h5") as H:
    ...     no_camera = PSFMatrix(H[:1])
    >>> found: Inspection = drain(iter_inspection(no_camera, inspect(no_camera)))
    >>> print(found.compared, found.why_not)
    0 H has no camera
    """

    quality: QualityReport
    findings: tuple[Finding, ...]
    compared: int
    misfit: float
    why_not: str
    seconds: float
    clean: float | None = None
    as_it_is: float | None = None

    def settled(self, metric: Metric) -> Finding | None:
        """Return the fault that stands for a metric, or None."""
        return next((one for one in self.findings if metric.key in one.fault.settles), None)

    def withdrawn(self, metric: Metric) -> bool:
        """Return whether the comparison measured what a metric suspects, and found next to nothing of it."""
        harmless = metric.measured and metric.key not in FRAMES and metric.cost < FAIR
        return bool(self.compared) and (metric.key in MEASURED or harmless) and self.settled(metric) is None

    @property
    def alarms(self) -> tuple[Metric, ...]:
        """The bad metrics that no fault stands for and that the comparison does not refute."""
        left = (m for m in self.quality.alarms if self.settled(m) is None and not self.withdrawn(m))
        return tuple(left)

    @property
    def bad(self) -> bool:
        """Whether H should not be used as it is."""
        return bool(self.alarms) or any(is_bad(one) for one in self.findings)

    @property
    def merit(self) -> Merit:
        """The merit that the verdict stands for."""
        if self.bad:
            return "bad"
        if self._doubtful:
            return "fair"
        return "good" if self.compared or self.findings else self.quality.merit

    @property
    def verdict(self) -> str:
        """One sentence for people, which names or counts every fault that was found."""
        worst = [one.title for one in self.findings if is_bad(one)] + [m.spec.title.lower() for m in self.alarms]
        if worst:
            return f"This PSF should not be used as it is: {_listed(worst, 3)}."
        if self._doubtful:
            return f"This PSF can be used; worth a look: {_listed(self._doubtful, 4)}."
        if not self.compared and not self.findings:
            return self.quality.verdict
        known = sum(m.merit == "good" for m in self.quality.metrics)
        rest = sum(m.merit == "unknown" for m in self.quality.metrics)
        unknown = f"; {format_count(rest, 'metric is', 'metrics are')} unknown." if rest else "."
        return f"This PSF is good by {format_count(known, 'metric', 'metrics')}, and {self._shown}{unknown}"

    @property
    def _doubtful(self) -> list[str]:
        """What is worth a look, by title."""
        fair = (m for m in self.quality.metrics if m.merit == "fair")
        left = [m.spec.title.lower() for m in fair if self.settled(m) is None and not self.withdrawn(m)]
        return [one.title for one in self.findings if is_fair(one)] + left

    @property
    def _shown(self) -> str:
        """What was found in patterns where none of it matters: nothing, or faults that are there."""
        source = f"{self.compared} patterns compared with the camera show" if self.compared else "its patterns show"
        if not self.findings:
            return f"{source} no fault"
        measured = all(one.cost is not None for one in self.findings)
        which = "cost a reconstruction next to nothing" if measured else "are too small to matter"
        which = which.replace("cost ", "costs ").replace("are ", "is ") if len(self.findings) == 1 else which
        many = format_count(len(self.findings), "fault", "faults")
        return f"{source} {many} that {which} ({_listed([one.title for one in self.findings], 4)})"

    def redo(self) -> list[tuple[tuple[int, int, int], str]]:
        """Return positions (z, y, x) to record again with the reasons, in scan order."""
        others = [m.key for m in self.quality.metrics if self.withdrawn(m) or self.settled(m) is not None]
        reasons = {place: [words] for place, words in self.quality.redo(others)}
        for one in self.findings:
            # a single frame is soon taken again, whatever it costs
            if one.redo and len(one.positions) and (one.extent is not None or is_bad(one) or is_fair(one)):
                for place in map(tuple, one.positions.tolist()):
                    reasons.setdefault(place, []).append(one.title)
        return [(place, ", ".join(reasons[place])) for place in sorted(reasons)]

    def to_dict(self) -> dict[str, object]:
        """Return what the comparison found as plain values."""
        return {
            "compared": self.compared,
            "misfit": self.misfit,
            "why_not": self.why_not,
            "seconds": self.seconds,
            "error_clean": self.clean,
            "error_as_it_is": self.as_it_is,
            "faults": [
                {
                    "name": one.name,
                    "title": one.title,
                    "detail": one.detail,
                    "sigmas": one.sigmas,
                    "confidence": one.confidence,
                    "share": one.share,
                    "cost": one.cost,
                    "advice": one.fault.advice,
                    "positions": one.positions.tolist(),
                    "pixels": one.pixels.tolist(),
                    "redo": one.redo,
                }
                for one in self.findings
            ],
            "withdrawn": [m.key for m in self.quality.metrics if m.merit in ("bad", "fair") and self.withdrawn(m)],
        }


def _listed(names: Sequence[str], most: int) -> str:
    """Return the first of the names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def is_bad(finding: Finding) -> bool:
    """Return whether an H with this fault should not be used: by what it costs, else by what it changes."""
    return finding.share >= BAD_SHARE if finding.cost is None else finding.cost >= BAD


def is_fair(finding: Finding) -> bool:
    """Return whether an H with this fault is worth a look: by what it costs, else by what it changes."""
    return finding.share >= FAIR_SHARE if finding.cost is None else finding.cost >= FAIR


def worst_first(finding: Finding) -> tuple[float, float]:
    """Return what findings are sorted by: less what they cost, else what they change."""
    # without a cost by the share of the limit that the changed light is
    cost = finding.share * BAD / BAD_SHARE if finding.cost is None else finding.cost
    return -cost, -finding.share


def iter_inspection(
    matrix: PSFMatrix,
    quality: QualityReport,
    *,
    setup: Setup | None = None,
    seconds: float = 10.0,
    patterns: int | None = None,
) -> Work[Inspection]:
    """Compare H with its camera, and name the faults that differences show.

    Parameters
    ----------
    matrix
        H.
    quality
        Its metrics.
    setup
        The camera as it was found by a fit; None takes what H says of it.
    seconds
        Time that the comparison may take.
    patterns
        Compare so many patterns instead.

    Examples
    --------
    >>> from lfcal.inspect import iter_inspection
    >>> from lfcal.progress import drain
    >>> from lfcal.psf import inspect, open_psf
    >>> with open_psf("H.h5") as H:
    ...     found = drain(iter_inspection(H, inspect(H), patterns=24))
    >>> print(found.verdict)
    This PSF is good by ... metrics, and 24 patterns compared with the camera show no fault; ... metrics are unknown.
    """
    start = time.perf_counter()
    odd = suspects(quality)
    evidence = yield from iter_evidence(
        matrix,
        setup=setup,
        seconds=seconds,
        patterns=patterns,
        suspected=odd[:ODDEST],
        more_suspected=max(0, len(odd) - ODDEST),
    )
    if isinstance(evidence, Unlike):
        return Inspection(quality, (), 0, 0.0, evidence.reason, 0.0)
    assert isinstance(evidence, Evidence)
    found, cleaned = yield from iter_search(evidence)
    misfit = _unexplained(evidence, cleaned, found)
    if misfit is not None:
        # what an unsuitable model leaves looks like any fault, and what was taken out for it is in H
        sure = tuple(one for one in found if not one.fault.needs_camera)
        costs = yield from iter_costs(evidence, sure, COST_OF * seconds if patterns is None else None)
        sure = tuple(replace(one, cost=cost) for one, cost in zip(sure, costs.costs, strict=True))
        why = f"its camera leaves {format_share(misfit)} of the light unexplained"
        why += "; find the true one with lfcal fit, and name it" if setup is None else ""
        return Inspection(quality, sure, 0, misfit, why, evidence.seconds)
    told = dict(as_findings(Inspection(quality, found, len(evidence), 0.0, "", 0.0).alarms, cleaned))
    several = (*found, *told.values())
    costs = yield from iter_costs(cleaned, several, COST_OF * seconds if patterns is None else None)
    quality = with_costs(quality, tuple(told), costs, costs.costs[: len(found)])
    found = tuple(replace(one, cost=cost) for one, cost in zip(found, costs.costs, strict=False))
    ranked = tuple(sorted(found, key=worst_first))
    took = time.perf_counter() - start
    return Inspection(quality, ranked, len(evidence), cleaned.misfit, "", took, costs.clean, costs.as_it_is)


def _unexplained(evidence: Evidence, cleaned: Evidence, found: Sequence[Finding]) -> float | None:
    """Return the share of the light that the camera does not explain; None where it does."""
    if cleaned.misfit > EXPLAINED:
        return cleaned.misfit
    kinds = {one.name for one in found if one.fault.needs_camera and one.share >= LARGE}
    return evidence.misfit if evidence.misfit > EXPLAINED and len(kinds) > KINDS else None
