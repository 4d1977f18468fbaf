"""Selection, order and texts of the results on the Sessions page. No Qt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from lfcal.base import InputError, any_of, format_bytes
from lfcal_gui.models import PageSettings, ProjectState, capital, kept_verdict

if TYPE_CHECKING:
    from lfcal.judge import StoredResult

Verdict = tuple[str, str]
"""Merit and verdict as a sentence."""

NOT_JUDGED = "Not judged"
PROJECT = ""
"""Entry of the folder list for the folders of the project."""

KIND_WORDS = {
    "": "All kinds",
    "recording": "Recordings",
    "H": "H",
    "fit": "Fits",
    "report": "Quality reports",
    "export": "Exports",
    "volume": "Volumes",
    "unreadable": "Unreadable",
}
"""Kinds of results with the names shown in the filter."""

ORDERS = (("newest", "Newest first"), ("oldest", "Oldest first"), ("name", "By name"), ("verdict", "Worst first"))

WORST = ("bad", "fair", "unknown", "good")
"""Merits, worst first."""

RECENT = 8
FACTS_SHOWN = 2
"""Details in the place of a picture."""


@dataclass(frozen=True)
class SessionsSettings(PageSettings):
    """Settings of the page.

    Attributes
    ----------
    folder
        Folder to search; empty: the folders of the project.
    kind, order
        Kind of results shown (one of `KIND_WORDS`), and their order (one of `ORDERS`).
    """

    page: ClassVar[str] = "sessions"

    folder: str = PROJECT
    kind: str = ""
    order: str = "newest"

    def __post_init__(self) -> None:
        """Check every value."""
        for name, value, known in (("kind", self.kind, KIND_WORDS), ("order", self.order, dict(ORDERS))):
            if value not in known:
                raise InputError.expected(name, any_of(known), value, "choose one of these")


def own_folders(project: ProjectState, path: Path | None) -> tuple[str, ...]:
    """Return the folders that contain the project and its files, without accessing the disk."""
    files = (str(path or ""), project.psf, project.reference, project.volume)
    # a recording is a folder itself, and what is made of it is often next to it
    folders = [str(Path(one).parent) for one in (*files, project.recording, project.frames) if one]
    return tuple(dict.fromkeys(folders))


def recent_with(folder: str, recent: Iterable[str]) -> list[str]:
    """Return the recently used folders with ``folder`` first."""
    return [folder, *(one for one in recent if one != folder)][:RECENT]


def shown(
    results: Iterable[StoredResult],
    settings: SessionsSettings,
    words: str = "",
    verdicts: Mapping[Path, Verdict] | None = None,
) -> list[StoredResult]:
    """Return the results of the chosen kind whose name, folder, verdict or facts contain all ``words``, in order."""
    wanted = words.lower().split()
    found = [
        one
        for one in results
        if settings.kind in ("", one.kind) and all(word in _searched(one, verdicts or {}) for word in wanted)
    ]
    if settings.order == "name":
        return sorted(found, key=lambda one: (one.name.lower(), str(one.path)))
    found.sort(key=lambda one: one.when, reverse=settings.order != "oldest")
    if settings.order == "verdict":
        found.sort(key=lambda one: WORST.index(_verdict(one, verdicts or {})[0]))
    return found


def _searched(result: StoredResult, verdicts: Mapping[Path, Verdict]) -> str:
    facts = " ".join(f"{name} {value}" for name, value in result.facts)
    return f"{result.path} {result.kind} {verdict_words(result, verdicts)[1]} {facts}".lower()


def _verdict(result: StoredResult, verdicts: Mapping[Path, Verdict]) -> Verdict:
    if result.problem:
        return "bad", result.problem.removeprefix(f"{result.path}: ")
    return verdicts.get(result.path) or (result.merit, result.verdict)


def verdict_words(result: StoredResult, verdicts: Mapping[Path, Verdict]) -> Verdict:
    """Return merit and verdict of a result; an H without a verdict is "not judged"."""
    merit, words = _verdict(result, verdicts)
    return merit, words or (NOT_JUDGED if can_judge(result) else "")


def verdict_on(result: StoredResult, project: ProjectState) -> Verdict | None:
    """Return the verdict stored in a project for a result; None if there is none for the current file."""
    found = kept_verdict(project, str(result.path)) if can_judge(result) else None
    return None if found is None else (found.merit, found.sentence)


def kind_word(result: StoredResult) -> str:
    """Return the kind of a result in a word."""
    return capital(result.kind)


def picture_words(result: StoredResult) -> str:
    """Return the words in the place of a picture: the kind of a result, and its first details."""
    return "\n".join((kind_word(result), *(f"{name}: {value}" for name, value in result.facts[:FACTS_SHOWN])))


def can_judge(result: StoredResult) -> bool:
    """Return whether a result is an H that can be judged."""
    return not result.problem and (result.kind == "H" or (result.kind == "export" and _opens(result.path)))


def _opens(path: Path) -> bool:
    """Return whether `lfcal.psf.open_psf` reads an export of this name."""
    return path.suffix.lower() in (".mat", ".npy")


def how_opened(result: StoredResult) -> str:
    """Return how to open a result: key of a page, ``"browser"``, or a sentence on why it cannot be opened."""
    if result.problem:
        return "This result cannot be opened, because it cannot be read."
    if result.kind == "export" and not _opens(result.path):
        return "A TIFF export is for other programs. Open the H from which it was made."
    return {"recording": "acquire", "volume": "reconstruct", "fit": "browser", "report": "browser"}.get(
        result.kind, "h"
    )


def fact_rows(result: StoredResult, verdicts: Mapping[Path, Verdict]) -> list[tuple[str, str]]:
    """Return all facts about a result as rows (name, value)."""
    when = f"{result.when.astimezone():%Y-%m-%d %H:%M}"
    rows = [("Kind", kind_word(result))]
    rows += [("Problem", result.problem)] if result.problem else []
    words = "" if result.problem else verdict_words(result, verdicts)[1]
    rows += [("Verdict", words)] if words else []
    dated = "" if result.dated else " (time of the file)"
    return [*rows, ("Date", when + dated), ("Folder", str(result.path.parent)), *result.facts, _size(result)]


def _size(result: StoredResult) -> tuple[str, str]:
    return "Size", format_bytes(result.bytes)


def pair_rows(first: Sequence[tuple[str, str]], second: Sequence[tuple[str, str]]) -> list[tuple[str, str, str, str]]:
    """Return the facts of two results side by side; the last column marks differences."""
    a, b = dict(first), dict(second)
    names = [*a, *(name for name in b if name not in a)]
    return [
        (name, a.get(name, "–"), b.get(name, "–"), "" if a.get(name) == b.get(name) else "differs") for name in names
    ]
