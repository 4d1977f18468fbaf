"""Where each value of a camera comes from: stated by a file or person, measured, derived from those, or assumed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from lfcal.base import check_choice, check_type

__all__ = ["MARKS", "Marks"]

MARKS = ("stated", "measured", "derived", "assumed")


@dataclass(frozen=True, slots=True)
class Marks:
    """A mark, one of `MARKS`, for values of a camera by their path, such as ``"sensor.pixel_um"``.

    Values without a mark were given by whoever made the description.

    Attributes
    ----------
    entries
        Pairs (path, mark), sorted by path.

    Examples
    --------
    >>> from lfcal.camera import Marks
    >>> marks = Marks.of({"lattice.pitch_um": "measured", "lattice.gap_um": "assumed"})
    >>> print(marks["lattice.pitch_um"], marks["sensor.pixel_um"], marks.paths("assumed"))
    measured stated ('lattice.gap_um',)
    >>> print(marks.marked(["lattice.gap_um"], "stated").paths("assumed"))
    ()
    """

    entries: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check and sort the entries."""
        for path, mark in self.entries:
            check_type("path of a mark", path, str)
            check_choice(f"mark of {path}", mark, MARKS)
        object.__setattr__(self, "entries", tuple(sorted(dict(self.entries).items())))

    @classmethod
    def of(cls, entries: Mapping[str, str]) -> Marks:
        """Return the marks of a mapping from path to mark."""
        return cls(tuple(entries.items()))

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Iterate over pairs (path, mark)."""
        return iter(self.entries)

    def __getitem__(self, path: str) -> str:
        """Return the mark of the value at ``path``: ``"stated"`` where it has none."""
        return dict(self.entries).get(path, "stated")

    def paths(self, mark: str) -> tuple[str, ...]:
        """Return the paths of the values with ``mark``."""
        return tuple(path for path, own in self.entries if own == mark)

    def marked(self, paths: Iterable[str], mark: str) -> Marks:
        """Return these marks with ``mark`` at ``paths`` in place of what was there."""
        return Marks.of(dict(self.entries) | dict.fromkeys(paths, mark))
