"""Verdicts on H stored in a project, each valid while the file of H is unchanged. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import Stamp, stamp_of

if TYPE_CHECKING:
    from lfcal.base import Judgement

KEY = "verdicts"
"""Entry of a project's settings that contains the verdicts, newest first."""

MOST_KEPT = 50
"""Largest number of verdicts stored in a project."""

MOST_BAD = 0.05
"""Largest fraction of bad positions in a plane for which recording them again or leaving them out is proposed."""

REMEDIES = {"background": "dark", "hot_pixels": "dark"}
"""Kinds of findings that a correction of the frames removes, with the name of the correction."""


@dataclass(frozen=True)
class Verdict:
    """Stored summary of a judgement of H.

    Attributes
    ----------
    merit, sentence
        Merit of H, and the verdict in words.
    bad, share
        Number of positions to record again, and their largest fraction of the positions of a plane.
    rest
        Merit of H without the effect of these positions.
    failed, checks
        Number of findings, and number of measured metrics.
    redo
        These positions (z, y, x), if they are few.
    remedy, cause
        Correction that removes the worst finding, one of the values of `REMEDIES` (empty: none is known), and its name.
    """

    merit: str = "unknown"
    sentence: str = ""
    bad: int = 0
    share: float = 0.0
    rest: str = "good"
    failed: int = 0
    checks: int = 0
    redo: tuple[tuple[int, ...], ...] = ()
    remedy: str = ""
    cause: str = ""

    @property
    def usable(self) -> bool:
        """Whether H can be used without changes."""
        return self.merit in ("good", "fair")

    @property
    def few(self) -> bool:
        """Whether only a few positions are bad and the rest is usable."""
        return bool(self.bad) and self.share <= MOST_BAD and self.rest in ("good", "fair")


def verdict_of(
    judgement: Judgement, redo: tuple[tuple[int, ...], ...] = (), plane: int = 0, checks: int = 0
) -> Verdict:
    """Return the summary of a judgement to store in a project.

    Parameters
    ----------
    judgement
        Judgement of H.
    redo
        Positions (z, y, x) to record again.
    plane
        Number of positions per plane.
    checks
        Number of metrics that were measured.
    """
    from lfcal.base import RANK

    others = [one for one in judgement.findings if not one.repeat]
    rest = min((one.merit for one in others), key=lambda merit: RANK[merit], default="good")
    if any(one.merit == "unknown" for one in others) and rest != "bad":
        rest = "unknown"
    planes = [position[0] for position in redo]
    most = max((planes.count(z) for z in set(planes)), default=0)
    share = most / plane if plane else 0.0
    worst = judgement.findings[0] if judgement.findings else None
    remedy = "" if worst is None else REMEDIES.get(worst.kind, "")
    return Verdict(
        judgement.merit,
        judgement.verdict,
        len(redo),
        share,
        rest,
        len(judgement.findings),
        max(checks, len(judgement.findings)),
        redo if share <= MOST_BAD else (),
        remedy,
        worst.what if worst is not None and remedy else "",
    )


def with_verdict(project: ProjectState, stamp: Stamp, verdict: Verdict) -> dict[str, Any]:
    """Return the settings of a project with the verdict on the H of ``stamp`` added."""
    entry = {"stamp": list(stamp[1:]), **asdict(verdict), "redo": [list(one) for one in verdict.redo]}
    others = [one for one in _kept(project) if one.get("stamp") != entry["stamp"]]
    return {**project.settings, KEY: [entry, *others][:MOST_KEPT]}


def kept_verdict(project: ProjectState, path: str = "") -> Verdict | None:
    """Return the verdict on the H at ``path`` (empty: of the project); None if the current file was not judged."""
    stamp = stamp_of(path or project.psf)
    found = (
        None if stamp is None else next((one for one in _kept(project) if one.get("stamp") == list(stamp[1:])), None)
    )
    if found is None:
        return None
    given: dict[str, Any] = {one.name: found.get(one.name) for one in fields(Verdict)}
    if isinstance(given["redo"], list):
        given["redo"] = tuple(tuple(position) for position in given["redo"])
    if any(type(given[one.name]) is not type(one.default) for one in fields(Verdict)):
        return None
    return Verdict(**given)


def _kept(project: ProjectState) -> list[Mapping[str, Any]]:
    """Return the verdicts stored in a project, newest first."""
    found = project.settings.get(KEY)
    return [one for one in found if isinstance(one, Mapping)] if isinstance(found, list) else []
