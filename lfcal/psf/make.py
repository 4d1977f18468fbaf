"""Make a matrix from planes of any source: in memory, in a file, or as units of a run in other processes.

A `PlaneSource` makes planes: from frames, by simulation, or from another matrix. `iter_make` and `iter_write` use it.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Progress, Work, drain, plain, require_space
from lfcal.psf._joining import adopt
from lfcal.psf._nexus import mark_default_plot
from lfcal.psf.facts import stacked
from lfcal.psf.layout import Header, Plane, Stored
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.provenance import with_simulated
from lfcal.psf.store import REGIONS, MatrixGroup, PSFWriter, check_storable, new_file, stored_bytes
from lfcal.work import ProcessCache

if TYPE_CHECKING:
    from lfcal.work import RunChoice, Unit

__all__ = [
    "PlaneSource",
    "Reopening",
    "Zeros",
    "do_plane",
    "iter_make",
    "iter_write",
    "iter_write_regions",
    "units_of",
]

Zeros = Callable[[], NDArray[np.float32]]
"""Function that returns zeros ``(ny, nx, nt, ns)`` for a plane; the next call may return the same memory."""


@dataclass(frozen=True)
class Reopening:
    """Description of how another process opens the source of a plane.

    Attributes
    ----------
    opener
        ``"package.module:function"``; the function is called with ``values`` and a number of threads, and returns the
        `PlaneSource`. Empty: only threads of this process can compute the plane, from objects that are already open.
    values
        Everything that determines the plane, except its index, as plain JSON types.
    inputs
        Paths of the input files.
    held
        Whether a process keeps the source open for other planes of the run, because opening it is expensive.
    concurrent_bytes
        As in `lfcal.work.Unit`.
    """

    opener: str
    values: Mapping[str, Any]
    inputs: tuple[str, ...] = ()
    held: bool = False
    concurrent_bytes: int = field(default=0, compare=False)


class PlaneSource:
    """Base class of sources of the planes of a matrix.

    Subclasses set the header and implement `iter_plane` and, for runs of units, `reopening`.
    """

    header: Header
    title: str = "make"
    """Word for the work of a run of units in messages, such as ``"assemble"``."""
    in_order: bool = False
    """Whether finished planes of a run of units are joined while others are being made."""

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute or read plane ``z``; yield progress and return the plane.

        Parameters
        ----------
        z
            Index of the plane.
        zeros
            Function that returns an array of zeros to fill; sources that already have an array do not call it.
        workers
            Number of threads. None: one for each available CPU core.
        alone
            Whether progress refers to this plane only, as for a unit of a run; otherwise it refers to all planes.
        """
        raise NotImplementedError

    def reopening(self, z: int, stored: Stored) -> Reopening | None:
        """Return how another process opens the source of plane ``z``, to store its values as in ``stored``.

        None: this process computes the plane at the end.
        """
        raise NotImplementedError

    def named(self, out: Path) -> str:
        """Return the title of a run of units that writes ``out``, for messages."""
        return f"{self.title} {out.name}"

    def shown(self, record: Progress) -> Progress:
        """Return the progress ``record`` of a run of units; subclasses may add what this process knows about planes."""
        return record

    def late_provenance(self) -> Mapping[str, Any]:
        """Return provenance entries that are known only after this process has computed all planes."""
        return {}

    def close(self) -> None:
        """Close the files that the source has opened itself; called before the new file gets its final name."""


def iter_make(
    source: PlaneSource,
    out: str | os.PathLike[str] | None = None,
    stored: Stored | None = None,
    *,
    run: RunChoice | None = None,
    workers: int | None = None,
) -> Work[PSFMatrix]:
    """Make a matrix in memory as float32, or write it to ``out`` as `iter_write` does; return the opened matrix.

    Raises
    ------
    InputError
        If a plane contains values that are not finite, or a ``run`` is stated without a file.
    """
    if out is not None:
        return open_psf((yield from iter_write(source, out, stored, run=run, workers=workers)))
    if run is not None:
        raise InputError.expected(
            "H that is made unit by unit", "the name of the file to write", "none", "give a file with out="
        )
    return (yield from _in_memory(source, workers))


def iter_write(
    source: PlaneSource,
    out: str | os.PathLike[str],
    stored: Stored | None = None,
    *,
    run: RunChoice | None = None,
    keep: bool = False,
    workers: int | None = None,
) -> Work[Path]:
    """Write a matrix to an H file with one plane in memory at a time, and return its path.

    An incomplete file is never left at ``out``.

    Parameters
    ----------
    source
        Source of the planes.
    out
        File to write.
    stored
        How values are stored. None: the defaults of `PSFWriter`.
    run
        Settings for processing the planes as separate work units: the executor, and what to do with units left by an
        earlier run. If the run is stopped, finished units are kept. None: this process makes the planes one by one.
    keep
        Whether to keep the files of the units of a ``run``, as in `lfcal.work.iter_made`.
    workers
        Number of threads if there is no ``run``. None: one for each available CPU core.

    Raises
    ------
    InputError, FileFormatError, StorageError
        The errors of the source, of `PSFWriter` and of `lfcal.work.iter_made`.
    """
    target, stored = Path(out), stored or Stored()
    if run is not None:
        yield from _iter_units(source, target, stored, run, keep=keep)
        return target
    zeros = _Buffer(source.header.shape[1:])
    with PSFWriter.of(target, source.header, stored, workers) as writer, closing(source):
        for z in range(source.header.shape[0]):
            writer.write(z, (yield from source.iter_plane(z, zeros, workers)))
        writer.note(source.late_provenance())
    return target


def iter_write_regions(
    sources: Mapping[str, tuple[PlaneSource, Stored]], out: str | os.PathLike[str], *, workers: int | None = None
) -> Work[Path]:
    """Write the matrices of several regions of the field to one H file, and return its path.

    ``sources`` maps the name of each region to the source of its planes and the way in which its values are stored. The
    first region is the default when the file is opened. `iter_write` writes a single matrix.
    """
    target = Path(out)
    need = sum(stored_bytes(source.header.shape, stored) for source, stored in sources.values())
    require_space(target.parent, need, what=target.name)
    clock = Clock("write planes", sum(source.header.shape[0] for source, _ in sources.values()))
    done = 0
    with new_file(target) as file:
        yield clock.at(0)
        for number, (name, (source, stored)) in enumerate(sources.items()):
            group = file if number == 0 else file.require_group(REGIONS).create_group(name)
            part, zeros = MatrixGroup(group, source.header, stored, workers), _Buffer(source.header.shape[1:])
            with closing(source):
                for z in range(source.header.shape[0]):
                    part.write_plane(z, drain(source.iter_plane(z, zeros, workers)))
                    done += 1
                    yield clock.at(done)
                part.note(source.late_provenance())
            part.complete()
        mark_default_plot(file)
    return target


class _Buffer:
    """Reusable array of zeros, so that writing a file of any size needs the memory of one plane."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._values: NDArray[np.float32] | None = None

    def __call__(self) -> NDArray[np.float32]:
        if self._values is None:
            self._values = np.zeros(self._shape, np.float32)
        else:
            self._values[:] = 0
        return self._values


def _in_memory(source: PlaneSource, workers: int | None) -> Work[PSFMatrix]:
    header = source.header
    whole, made = np.zeros(header.shape, np.float32), []
    uncertainty: NDArray[np.float32] | None = None
    for z, values in enumerate(whole):
        plane = yield from source.iter_plane(z, lambda values=values: values, workers)  # type: ignore[misc]
        if plane.values is not values:
            values[:] = plane.values
        if not np.isfinite(values.sum(dtype=np.float64)):
            remedy = "find the frame with this value and record it again"
            raise InputError.expected(f"plane {z}", "finite values", "NaN or infinity", remedy)
        if plane.uncertainty is not None:
            uncertainty = np.zeros_like(whole) if uncertainty is None else uncertainty
            uncertainty[z] = plane.uncertainty
        made.append((plane.facts, plane.simulated))
    known = {**vars(header)}
    del known["shape"]
    if any(simulated is not None for _, simulated in made):
        known["provenance"] = with_simulated(header.provenance, [simulated for _, simulated in made])
    known["provenance"] = {**known["provenance"], **source.late_provenance()}
    return PSFMatrix(whole, facts=stacked([facts for facts, _ in made]), uncertainty=uncertainty, **known)


# -- units: other threads, processes, machines -------------------------------------------------------------------------
_HELD: ProcessCache[PlaneSource] = ProcessCache(lambda source: source.close())


def _iter_units(source: PlaneSource, out: Path, stored: Stored, run: RunChoice, *, keep: bool) -> Work[None]:
    """Write the planes of a matrix as units of a run."""
    from lfcal.work import iter_made

    check_storable(source.header, stored)
    # before any plane is made: planes stay in separate files until all are complete
    require_space(out.parent, stored_bytes(source.header.shape, stored), what=out.name)
    units = units_of(source, stored)
    writer = PSFWriter.of(out, source.header, stored, run.workers)
    join = partial(_iter_joined, source=source, numbers=tuple(units), writer=writer)
    todo, title = tuple(units.values()), source.named(out)
    with (
        _lent(source, todo),
        closing(iter_made(todo, out, run, join, title=title, keep=keep, in_order=source.in_order)) as work,
    ):
        for record in work:
            yield source.shown(record)


def _lent(source: PlaneSource, units: tuple[Unit, ...]) -> AbstractContextManager[None]:
    """Let threads of this process use objects that are already open; other processes have to open them."""
    first = units[0].arguments if units else {"held": False}
    return _HELD.using(_key(first), source) if first["held"] else nullcontext()


def units_of(source: PlaneSource, stored: Stored) -> dict[int, Unit]:
    """Return a mapping from plane indices to units of a run that compute these planes in any process.

    Planes that only this process can compute are omitted (`PlaneSource.reopening`).

    Examples
    --------
    >>> from lfcal.psf import MatrixPlanes, Stored, open_psf, units_of
    >>> with open_psf("H.h5") as H:
    ...     print(sorted(units_of(MatrixPlanes(H.T, title="transpose to"), Stored())))
    [0, 1]
    """
    from lfcal.work import Unit

    found: dict[int, Unit] = {}
    for z in range(source.header.shape[0]):
        reopening = source.reopening(z, stored)
        if reopening is None:
            continue
        shared = {"opener": reopening.opener, "values": reopening.values, "held": reopening.held}
        # plain lists and numbers, as they arrive through a file or a network
        arguments = plain({**shared, "stored": asdict(stored), "z": z})
        task = f"{__name__}:{do_plane.__name__}"
        beside = reopening.concurrent_bytes
        found[z] = Unit(f"plane {z:04d}", task, arguments, inputs=reopening.inputs, concurrent_bytes=beside)
    return found


def _iter_joined(
    parts: tuple[Path, ...], source: PlaneSource, numbers: tuple[int, ...], writer: PSFWriter
) -> Work[None]:
    """Write the file from the planes ``numbers``, which the units wrote to ``parts``, and from planes made here."""
    files, planes = dict(zip(numbers, parts, strict=True)), source.header.shape[0]
    clock = Clock("join planes", planes)
    with writer, closing(source):
        yield clock.at(0)
        for z in range(planes):
            if z in files:
                adopt(writer, z, files[z])
            else:
                writer.write(z, drain(source.iter_plane(z, _Buffer(source.header.shape[1:]), None)))
            yield clock.at(z + 1)
        writer.note(source.late_provenance())


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Make one plane and write it to the separate H file ``out``; this is the task of each unit.

    ``arguments`` are those of a unit of `units_of`.
    """
    z, stored = int(arguments["z"]), Stored(**arguments["stored"])
    with _opened(arguments, workers) as source:
        of = source.header
        depths = None if of.depths is None else of.plane_depths[z : z + 1]
        header = Header((1, *of.shape[1:]), depths, transposed=of.transposed)
        with PSFWriter.of(out, header, stored, workers) as writer:
            writer.write(0, (yield from source.iter_plane(z, _Buffer(of.shape[1:]), workers, alone=True)))


@contextmanager
def _opened(arguments: Mapping[str, Any], workers: int) -> Iterator[PlaneSource]:
    """Yield the source of a unit's plane: the one open in this process, or one opened as the unit states."""

    def opened() -> PlaneSource:
        module, _, name = arguments["opener"].partition(":")
        if not name:
            expected = "threads of the process that has the frames open"
            raise InputError.expected("executor", expected, "an executor of other processes", "use threads")
        found: PlaneSource = getattr(importlib.import_module(module), name)(arguments["values"], workers)
        return found

    if arguments["held"]:
        yield _HELD.get(_key(arguments), opened)
        return
    with closing(opened()) as source:
        yield source


def _key(arguments: Mapping[str, Any]) -> str:
    return json.dumps([arguments["opener"], arguments["values"]], sort_keys=True)
