"""Sources of findings: who says what is wrong with which kind of data, and the judgement from all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from lfcal.base import Finding, Judgement, Registry

__all__ = ["FINDING_SOURCES", "FindingSource", "Judged", "judgement_of"]


@runtime_checkable
class Judged(Protocol):
    """What was measured of some data; sources find in it what is wrong with them."""

    @property
    def data(self) -> str:
        """What the data are, for the verdict: "PSF", "session", "camera"."""
        ...

    @property
    def known(self) -> str:
        """What is known of the data besides what is wrong, as "good by 26 metrics"; empty: nothing."""
        ...


@dataclass(frozen=True, slots=True)
class FindingSource:
    """A source of findings.

    Attributes
    ----------
    name
        What it finds.
    of
        Names of the classes that it takes.
    find
        Takes an object of one of them, and yields what is wrong.

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
"""Every source of findings that is known, in the order in which modules name them."""


def judgement_of(measured: Judged) -> Judgement:
    """Return the findings of all sources about data, and the verdict.

    Parameters
    ----------
    measured
        Measurements: of an H by `inspect` or `iter_inspection`, of its file or a session by ``verify``, of a
        camera by ``check_camera``, of an H against new frames by `check`, or the report of an assembly.

    Examples
    --------
    >>> from lfcal.judge import judgement_of
    >>> from lfcal.psf import verify
    >>> print(judgement_of(verify("H.h5")).verdict)
    This H file is whole in 2 of 2 planes (compared with their checksums).
    """
    # by name: a source of sessions must not load what records them where an H is judged
    names = {kind.__name__ for kind in type(measured).__mro__}
    found = [one for source in FINDING_SOURCES if names & set(source.of) for one in source.find(measured)]
    return Judgement.of(measured.data, found, measured.known)
