"""Sources of findings for each kind of data, and the verdict from all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from lfcal.base import Finding, Judgement, Registry

__all__ = ["FINDING_SOURCES", "FindingSource", "Judged", "judgement_of"]


@runtime_checkable
class Judged(Protocol):
    """Protocol for measurements of data, in which sources find problems."""

    @property
    def data(self) -> str:
        """Kind of the data for the verdict, such as "H", "session" or "camera"."""
        ...

    @property
    def known(self) -> str:
        """Summary of the checks that the data passed, such as "good by 26 checks"; may be empty."""
        ...


@dataclass(frozen=True, slots=True)
class FindingSource:
    """Source of findings about data.

    Attributes
    ----------
    name
        Name of the kind of problem that the source finds.
    of
        Names of the measurement classes that the source accepts.
    find
        Function that takes an object of one of these classes, and yields findings.

    Examples
    --------
    >>> from lfcal.judge import Finding, FindingSource
    >>> def few(report):
    ...     if report.frames < 100:
    ...         yield Finding(kind="few", what="few frames", subject="frames", merit="fair")
    >>> source = FindingSource("few frames", ("AssemblyReport",), few)
    """

    name: str
    of: tuple[str, ...]
    find: Callable[[Any], Iterable[Finding]]


FINDING_SOURCES: Registry[FindingSource] = Registry(
    "source of findings", "lfcal.judge.sources", "FINDING_SOURCES", "lfcal.findings", order=lambda _: 0
)
"""All known sources of findings, in the order in which modules list them."""


def judgement_of(measured: Judged) -> Judgement:
    """Return the findings of all sources about measured data, with the verdict.

    Parameters
    ----------
    measured
        Result of `inspect`, `iter_inspection` or `check` (for an H), ``verify`` (for a file or a session) or
        ``check_camera`` (for a camera), or the report of an assembly.

    Examples
    --------
    >>> from lfcal.judge import judgement_of
    >>> from lfcal.psf import verify
    >>> print(judgement_of(verify("H.h5")).verdict)
    This H file is intact in 2 of 2 planes (compared with their checksums).
    """
    # by name, so that judging an H does not load the modules that record sessions
    names = {kind.__name__ for kind in type(measured).__mro__}
    found = [one for source in FINDING_SOURCES if names & set(source.of) for one in source.find(measured)]
    return Judgement.of(measured.data, found, measured.known)
