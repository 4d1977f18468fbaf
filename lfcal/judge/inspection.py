"""Inspection of an H: metrics that need no camera, and a comparison with the model of its camera, if it has one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import ClassVar

from lfcal.base import RANK, Judgement, Merit, Work, format_count, format_seconds, format_share, listed
from lfcal.fit import Setup
from lfcal.judge._cost import iter_costs
from lfcal.judge._metric_costs import FRAMES, as_faults, with_costs
from lfcal.judge._suspects import suspects
from lfcal.judge.evidence import PATTERNS, Evidence, Unlike, iter_evidence
from lfcal.judge.explained import EXPLAINED, Disagreement, iter_explained, iter_rearranged
from lfcal.judge.fault import FoundFault
from lfcal.judge.quality import BAD, FAIR, Metric, QualityReport
from lfcal.judge.search import iter_search
from lfcal.judge.source import judgement_of
from lfcal.psf import PSFMatrix

__all__ = ["BAD", "FAIR", "MEASURED", "Inspection", "is_bad", "is_fair", "iter_inspection", "worst_first"]

FAIR_SHARE, BAD_SHARE = 0.01, 0.05
"""Thresholds for the fraction of the light that a fault changes, used if its cost was not measured."""

LIMIT_S = 1800.0
"""Time limit of a comparison (s): much more than it takes on a slow machine, because its work is fixed."""

ODDEST = 48
"""Largest number of suspect positions that are compared."""

ORIENTATION = "scan_order"
"""Key of the metric of the orientation of frames."""

KINDS, LARGE = 3, 0.02
"""Number of different faults, each with at least that fraction of the light, above which a wrong camera is more likely
than all of these faults together."""

LEFT, DEPTHS = 0.02, ("depth_label", "focus_drift")
"""Remaining fraction of the light, with planes at other depths, above which other explanations are tried."""

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
        "step",
    }
)
"""Keys of model-free metrics whose subject the comparison with a camera measures more reliably."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """Metrics of H, and faults found by comparing H with its camera.

    Attributes
    ----------
    quality
        The metrics that need no model.
    faults
        Faults found, in order of decreasing cost.
    compared
        Number of patterns compared with the camera; 0: H was not compared.
    misfit
        Typical error of the patterns predicted by the camera, as a fraction of the light (relative L2).
    why_not
        Reason why nothing was compared; empty otherwise.
    seconds
        Duration of the comparison (s).
    clean
        Error of a reconstruction due to the noise of H alone (NRMSE). None: not measured.
    as_it_is
        Error of a reconstruction due to the noise and faults of H (NRMSE). None: not measured.
    disagreement
        Disagreement of the stated camera with H. None: there is none. An H with a disagreement is never good.
    unfinished
        Reason why the comparison with the stated camera is unfinished; empty: it is finished. An H with an unfinished
        comparison is never good.

    Examples
    --------
    >>> from lfcal.judge import Inspection, iter_inspection
    >>> from lfcal.base import drain
    >>> from lfcal.psf import PSFMatrix, open_psf
    >>> from lfcal.judge import inspect
    >>> with open_psf("H.h5") as H:
    ...     no_camera = PSFMatrix(H[:1])
    >>> found: Inspection = drain(iter_inspection(no_camera, inspect(no_camera)))
    >>> print(found.compared, found.why_not)
    0 H has no camera
    """

    data: ClassVar[str] = "H"

    quality: QualityReport
    faults: tuple[FoundFault, ...] = ()
    compared: int = 0
    misfit: float = 0.0
    why_not: str = ""
    seconds: float = 0.0
    clean: float | None = None
    as_it_is: float | None = None
    disagreement: Disagreement | None = None
    unfinished: str = ""

    def settled(self, metric: Metric) -> FoundFault | None:
        """Return the fault that explains the value of ``metric`` and is reported instead; None if there is none."""
        return next((one for one in self.faults if metric.key in one.fault.settles), None)

    def withdrawn(self, metric: Metric) -> bool:
        """Return whether the comparison with the camera refutes ``metric``.

        H must have been compared, and no fault may explain the metric. In addition, the comparison must measure the
        same effect more reliably, or the metric must have a measured cost that is negligible.
        """
        harmless = metric.measured and metric.key not in FRAMES and metric.cost < FAIR
        return bool(self.compared) and (metric.key in MEASURED or harmless) and self.settled(metric) is None

    @property
    def doubts(self) -> tuple[Metric, ...]:
        """The metrics rated bad or fair that are neither explained by a fault nor refuted by the comparison."""
        return tuple(m for m in self.standing if m.merit in ("bad", "fair"))

    @property
    def standing(self) -> tuple[Metric, ...]:
        """The metrics that are neither explained by a fault nor refuted by the comparison."""
        return tuple(m for m in self.quality.metrics if self.settled(m) is None and not self.withdrawn(m))

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)`` of H."""
        return self.quality.shape

    @property
    def bad(self) -> bool:
        """Whether H should not be used as it is."""
        return self.merit == "bad"

    @property
    def judgement(self) -> Judgement:
        """Rating and verdict of H, with the findings from its metrics and from the comparison with the camera."""
        return judgement_of(self)

    @property
    def merit(self) -> Merit:
        """Rating of H: "good", "fair", "unknown" or "bad".

        It is "unknown" or "bad" if its camera does not explain H, or if the comparison is unfinished.
        """
        return self.judgement.merit

    @property
    def verdict(self) -> str:
        """Text with the rating of H, the positions, cost and remedy of its faults, and the other findings."""
        return self.judgement.verdict

    @property
    def known(self) -> str:
        """Text with the number of checks that H passed, and the result of the comparison with the camera.

        It is empty if H passed no check and there is neither a comparison nor a fault.
        """
        good = sum(m.merit == "good" for m in self.quality.metrics)
        by = f"good by {format_count(good, 'check', 'checks')}"
        if self.compared or self.faults:
            return f"{by}, and {self._shown}"
        if not good:
            return ""
        return f"{by}; it was not compared with a camera{f' ({self.why_not})' if self.why_not else ''}"

    @property
    def _shown(self) -> str:
        """Further findings in the patterns, as text: none, or faults that are too small to matter."""
        source = f"{self.compared} patterns compared with the camera show" if self.compared else "its patterns show"
        found = [one for one in self.faults if not (is_bad(one) or is_fair(one) or is_of_single_frames(one))]
        if not found:
            return f"{source} no {'other ' if self.faults else ''}fault"
        measured = all(one.cost is not None for one in found)
        which = "cost a reconstruction almost nothing" if measured else "are too small to matter"
        which = which.replace("cost ", "costs ").replace("are ", "is ") if len(found) == 1 else which
        many = format_count(len(found), "fault", "faults")
        return f"{source} {many} that {which} ({listed([one.title for one in found], 4)})"

    def redo(self) -> list[tuple[tuple[int, int, int], str]]:
        """Return the positions (z, y, x) to record again, each with the reasons as text, sorted by position."""
        others = [m.key for m in self.quality.metrics if self.withdrawn(m) or self.settled(m) is not None]
        reasons = {place: [words] for place, words in self.quality.redo(others)}
        for one in self.faults:
            # a single frame can be recorded again quickly, whatever it costs
            if one.redo and len(one.positions) and (one.extent is not None or is_bad(one) or is_fair(one)):
                for place in map(tuple, one.positions.tolist()):
                    reasons.setdefault(place, []).append(one.title)
        return [(place, ", ".join(reasons[place])) for place in sorted(reasons)]

    def to_dict(self, *, every: bool = False) -> dict[str, object]:
        """Return metrics, findings and the positions to record again as plain JSON types, without maps.

        With ``every``, metrics that do not apply are included.
        """
        model = {"model": self._model()} if self.asked else {}
        redo = {"redo": [list(place) for place, _ in self.redo()]}
        return self.quality.to_dict(every=every) | model | self.judgement.to_dict() | redo

    @property
    def asked(self) -> bool:
        """Whether a comparison with the camera was requested, whatever its result."""
        return bool(self.compared or self.why_not)

    def _model(self) -> dict[str, object]:
        return {
            "compared": self.compared,
            "misfit": self.misfit,
            "why_not": self.why_not,
            "unfinished": self.unfinished,
            "disagreement": None if self.disagreement is None else self.disagreement.to_dict(),
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
                for one in self.faults
            ],
            "withdrawn": [m.key for m in self.quality.metrics if m.merit in ("bad", "fair") and self.withdrawn(m)],
        }


def is_bad(finding: FoundFault) -> bool:
    """Return whether a fault makes H unusable: by its cost or, if this is unknown, by the light that it changes."""
    return finding.share >= BAD_SHARE if finding.cost is None else finding.cost >= BAD


def is_fair(finding: FoundFault) -> bool:
    """Return whether a fault is significant: by its cost or, if this is unknown, by the light that it changes.

    A fault that makes H unusable is significant, too.
    """
    return finding.share >= FAIR_SHARE if finding.cost is None else finding.cost >= FAIR


def is_of_single_frames(finding: FoundFault) -> bool:
    """Return whether a fault concerns only single frames, which can be recorded again quickly."""
    return finding.redo and finding.extent is not None and len(finding.positions) > 0


def worst_first(finding: FoundFault) -> tuple[float, float]:
    """Return the key that sorts faults by decreasing cost.

    If the cost is unknown, it is estimated from the fraction of the light that the fault changes.
    """
    # without a cost, use the fraction of the changed light relative to its limit
    cost = finding.share * BAD / BAD_SHARE if finding.cost is None else finding.cost
    return -cost, -finding.share


def iter_inspection(
    matrix: PSFMatrix,
    quality: QualityReport,
    *,
    setup: Setup | None = None,
    seconds: float = LIMIT_S,
    patterns: int = PATTERNS,
) -> Work[Inspection]:
    """Compare H with its camera; return its metrics and the faults that explain the differences.

    The compared patterns do not depend on the speed of the computer. The verdict is therefore the same on every
    computer that reaches the end within the time limit.

    Parameters
    ----------
    matrix
        H.
    quality
        Metrics of H.
    setup
        Setup with the camera of a fit. None: the camera stated in H.
    seconds
        Time limit of the comparison (s); 0: no comparison. If it is reached, the comparison ends, and the verdict
        states that H was not fully examined.
    patterns
        Number of patterns to compare, in addition to those that the metrics find unusual.

    Examples
    --------
    >>> from lfcal.judge import iter_inspection
    >>> from lfcal.base import drain
    >>> from lfcal.judge import inspect
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     found = drain(iter_inspection(H, inspect(H), patterns=24))
    >>> print(found.verdict)
    This H is good by ... checks, and 24 patterns compared with the camera show no fault.
    """
    start = time.perf_counter()
    kept = [Inspection(quality)]
    with closing(_iter_stages(matrix, kept, setup, patterns)) as work:
        for record in work:
            # without a camera, nothing takes a long time
            if matrix.camera is not None and time.perf_counter() - start >= seconds:
                break
            yield record
        else:
            return replace(kept[-1], seconds=time.perf_counter() - start)
    why = f"its comparison with the camera was not finished within {format_seconds(seconds)} (--seconds)"
    why = why if seconds > 0 else "its comparison with the camera was left out (--seconds 0)"
    best = replace(kept[-1], unfinished=why, why_not="" if kept[-1].compared else why)
    return replace(best, seconds=time.perf_counter() - start)


def _iter_stages(matrix: PSFMatrix, kept: list[Inspection], setup: Setup | None, patterns: int) -> Work[None]:
    """Add results to ``kept``, stage by stage; the last one is complete."""
    quality, fitted = kept[0].quality, setup is not None
    odd = suspects(quality)
    evidence = yield from iter_evidence(
        matrix,
        setup=setup,
        patterns=patterns,
        suspected=odd[:ODDEST],
        more_suspected=max(0, len(odd) - ODDEST),
    )
    if isinstance(evidence, Unlike):
        kept.append((yield from _iter_unlike(matrix, quality, evidence, fitted)))
        return
    if evidence.misfit > EXPLAINED:
        turned = yield from iter_rearranged(matrix, evidence.camera, evidence.misfit)
        if turned is not None:
            kept.append(_disagreeing(quality, Disagreement(turned.words, evidence.misfit, None, turned, fitted)))
            return
    found, cleaned = yield from iter_search(evidence)
    misfit = _unexplained(evidence, cleaned, found)
    explanation = None
    if misfit is not None or _doubtful(cleaned, found):
        explanation = yield from iter_explained(matrix, evidence.camera, iris=quality.iris, evidence=evidence)
    if misfit is not None or explanation is not None:
        misfit = cleaned.misfit if misfit is None else misfit
        reason = f"its camera leaves {format_share(min(misfit, 1.0))} of the light unexplained"
        disagreement = Disagreement(reason, misfit, None, explanation, fitted)
        kept.append((yield from _iter_unexplained(quality, evidence, found, disagreement)))
        return
    quality = _confirmed(quality)
    whole = Inspection(quality, found, len(evidence), cleaned.misfit)
    kept.append(whole)
    reported = dict(as_faults(whole.doubts, cleaned))
    costs = yield from iter_costs(cleaned, (*found, *reported.values()))
    quality = with_costs(quality, tuple(reported), costs, costs.costs[: len(found)])
    found = tuple(replace(one, cost=cost) for one, cost in zip(found, costs.costs, strict=False))
    ranked = tuple(sorted(found, key=worst_first))
    kept.append(replace(whole, quality=quality, faults=ranked, clean=costs.clean, as_it_is=costs.as_it_is))


def _disagreeing(quality: QualityReport, disagreement: Disagreement) -> Inspection:
    misfit = 0.0 if disagreement.misfit is None else disagreement.misfit
    return Inspection(quality, misfit=misfit, why_not=disagreement.reason, disagreement=disagreement)


def _iter_unlike(matrix: PSFMatrix, quality: QualityReport, unlike: Unlike, fitted: bool) -> Work[Inspection]:
    """Return the inspection of an H that was not compared: the reason and, with a stated camera, an explanation."""
    if not unlike.stated:
        return Inspection(quality, why_not=unlike.reason)
    explanation = None
    if unlike.camera is not None:
        explanation = yield from iter_rearranged(matrix, unlike.camera)
        if explanation is None:
            explanation = yield from iter_explained(matrix, unlike.camera, iris=quality.iris)
    return _disagreeing(quality, Disagreement(unlike.reason, None, unlike.correlation, explanation, fitted))


def _iter_unexplained(
    quality: QualityReport, evidence: Evidence, found: Sequence[FoundFault], disagreement: Disagreement
) -> Work[Inspection]:
    """Return the result if the camera leaves too much unexplained, or another explanation is better."""
    # residuals of an unsuitable model look like any fault, so its findings must not be removed from H
    sure = () if disagreement.certain else tuple(one for one in found if not one.fault.needs_camera)
    costs = yield from iter_costs(evidence, sure)
    sure = tuple(replace(one, cost=cost) for one, cost in zip(sure, costs.costs, strict=True))
    return replace(_disagreeing(quality, disagreement), faults=sure, clean=costs.clean, as_it_is=costs.as_it_is)


def _confirmed(quality: QualityReport) -> QualityReport:
    """Return the metrics with a good orientation of the frames, because the camera explains the patterns."""
    metrics = [
        replace(m, value=0.0, merit="good", cost=0.0, detail="") if m.key == ORIENTATION and m.merit == "unknown" else m
        for m in quality.metrics
    ]
    return replace(quality, metrics=tuple(sorted(metrics, key=lambda m: RANK[m.merit])))


def _unexplained(evidence: Evidence, cleaned: Evidence, found: Sequence[FoundFault]) -> float | None:
    """Return the fraction of the light that the camera does not explain; None if it explains the patterns."""
    if cleaned.misfit > EXPLAINED:
        return cleaned.misfit
    kinds = {one.name for one in found if one.fault.needs_camera and one.share >= LARGE}
    return evidence.misfit if evidence.misfit > EXPLAINED and len(kinds) > KINDS else None


def _doubtful(cleaned: Evidence, found: Sequence[FoundFault]) -> bool:
    """Return whether wrong depths may not be the cause, because a wrong gap also moves all planes, and blurs them."""
    return cleaned.misfit > LEFT and any(one.name in DEPTHS for one in found)
