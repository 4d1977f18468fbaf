"""The verdicts on H that a project keeps, each as long as the file of H is the same. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import Stamp, stamp_of

if TYPE_CHECKING:
    from lfcal.base import Judgement

KEY = "verdicts"
"""Entry of a project's settings that holds the verdicts, the newest first."""

MOST_KEPT = 50
"""Verdicts that a project keeps."""

MOST_BAD = 0.05
"""Share of a plane's positions up to which recording them again, or leaving them out, is the remedy."""

REMEDIES = {"background": "dark", "hot_pixels": "dark"}
"""Kinds of findings that a correction of frames removes, and the name of that correction."""


@dataclass(frozen=True)
class Verdict:
    """What is kept of a judgement of H.

    Attributes
    ----------
    merit, sentence
        The merit of H, and the verdict in words.
    bad, share
        Number of positions to record again, and the largest share of a plane's positions that they are.
    rest
        The merit of H without what these positions cause.
    failed, checks
        How many findings there are, and how many metrics were measured.
    redo
        These positions (z, y, x), where they are few.
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
        """Whether H can be used as it is."""
        return self.merit in ("good", "fair")

    @property
    def few(self) -> bool:
        """Whether only a few positions are bad, and all else is usable."""
        return bool(self.bad) and self.share <= MOST_BAD and self.rest in ("good", "fair")


def verdict_of(
    judgement: Judgement, redo: tuple[tuple[int, ...], ...] = (), plane: int = 0, checks: int = 0
) -> Verdict:
    """Return what is kept of a judgement.

    Parameters
    ----------
    judgement
        Of H.
    redo
        Positions (z, y, x) to record again.
    plane
        Number of positions of a plane.
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
    """Return the settings of a project with the verdict on the H of ``stamp``; those on other H stay."""
    entry = {"stamp": list(stamp[1:]), **asdict(verdict), "redo": [list(one) for one in verdict.redo]}
    others = [one for one in _kept(project) if one.get("stamp") != entry["stamp"]]
    return {**project.settings, KEY: [entry, *others][:MOST_KEPT]}


def kept_verdict(project: ProjectState, path: str = "") -> Verdict | None:
    """Return the verdict on the H at ``path`` (empty: the project's); None: it was not judged as it is now."""
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
    """Return the verdicts of a project, the newest first."""
    found = project.settings.get(KEY)
    return [one for one in found if isinstance(one, Mapping)] if isinstance(found, list) else []
