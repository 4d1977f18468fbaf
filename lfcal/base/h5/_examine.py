"""Read an HDF5 file to its end, in a process that may crash. Run as a script by `lfcal.base.h5.probe`.

Requests are lines of JSON ``[path, seconds, only]`` on standard input. Each is answered by one line of JSON: a text
that describes the fault, or "". With a list ``only`` of datasets, the others are described without reading their data.
Large datasets in the list are read only in the middle chunk. With null, all are read. The script imports nothing from
lfcal, so that it starts fast.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from typing import Any

import h5py

with suppress(ImportError):
    import hdf5plugin  # noqa: F401  registers zstd, blosc and lz4 with HDF5

OBJECTS = 20_000  # largest number of groups and datasets that are examined
SMALL = 1 << 25  # datasets of up to this number of bytes are read completely
FEW = 1 << 20  # limit for chunks if only the middle one of large data is read
MEMORY = 1 << 33  # bytes of address space that reading may take
HARMLESS_FILTERS = {1, 2, 3}  # deflate, shuffle, fletcher32: safe with damaged bytes


class Examination:
    """Access to everything in a file that a reader might need; errors that Python raises are left to the reader."""

    def __init__(self, only: list[str] | None = None) -> None:
        self.only = only
        self.finding = ""
        self.remaining = OBJECTS

    def ask(self, question: Any) -> Any:
        """Return the result of ``question``; None if h5py raises an error."""
        try:
            return question()
        except Exception as error:
            # the memory limit stops this here; elsewhere it would exhaust the memory
            if isinstance(error, MemoryError) or "alloc" in str(error).lower():
                self.finding = "data that need more memory than available"
            return None

    def group(self, group: Any, above: frozenset[Any]) -> None:
        """Examine a group and everything below it; ``above`` are its parent groups."""
        self.attributes(group)
        names = self.ask(lambda: list(group)) or []
        for name in names:
            if not isinstance(self.ask(lambda name=name: group.get(name, getlink=True)), h5py.HardLink):
                continue
            entry = self.ask(lambda name=name: group[name])
            self.remaining -= 1
            if self.remaining < 0:
                self.finding = f"more than {OBJECTS} entries"
                return
            if isinstance(entry, h5py.Dataset):
                self.attributes(entry)
                self.dataset(entry)
            elif isinstance(entry, h5py.Group):
                mark = self.ask(lambda entry=entry: h5py.h5o.get_info(entry.id).addr)
                if mark not in above and len(above) < 50:  # a group may contain itself
                    self.group(entry, above | {mark})

    def attributes(self, owner: Any) -> None:
        """Read all attributes."""
        for name in self.ask(lambda: list(owner.attrs)) or []:
            self.ask(lambda name=name: owner.attrs[name])

    def dataset(self, data: Any) -> None:
        """Read the index of chunks, and decode some or all chunks.

        All are decoded if the data are small or have third-party filters, otherwise the first and the last one. With
        ``only``, just the middle one of large data is decoded.
        """
        plist = self.ask(data.id.get_create_plist)
        if plist is None or self.ask(plist.get_external_count) or self.ask(plist.get_layout) == h5py.h5d.VIRTUAL:
            return
        for question in (lambda: data.fillvalue, data.id.get_storage_size, data.id.get_offset):
            self.ask(question)
        nbytes = self.ask(lambda: int(data.size or 0) * data.dtype.itemsize)
        if nbytes is None or nbytes > 1 << 44:
            return
        wanted = self.only is None or data.name.lstrip("/") in self.only
        if data.chunks is None:
            # stored without filters: nothing to decode
            if nbytes <= SMALL and wanted:
                self.ask(lambda: data[()])
            return
        chunks: list[tuple[int, ...]] = []
        self.ask(lambda: data.id.chunk_iter(lambda chunk: chunks.append(chunk.chunk_offset)))
        if not wanted:
            return
        if nbytes <= (SMALL if self.only is None else FEW):
            self.ask(lambda: data[()])
            return
        filters = {self.ask(lambda k=k: plist.get_filter(k)[0]) for k in range(self.ask(plist.get_nfilters) or 0)}
        if self.only is not None:
            chunks = sorted(chunks)[len(chunks) // 2 :][:1]
        elif filters <= HARMLESS_FILTERS:
            chunks = chunks[:1] + chunks[-1:]
        for start in chunks:
            where = tuple(slice(a, a + n) for a, n in zip(start, data.chunks, strict=True))
            self.ask(lambda where=where: data[where])


def examine(path: str, only: list[str] | None = None) -> str:
    """Return the reason why a file is unreadable, apart from errors of h5py; empty if there is none."""
    found = Examination(only)
    file = found.ask(lambda: h5py.File(path, "r", locking=False))
    if file is not None:
        found.group(file, frozenset())
        found.ask(file.close)
    return found.finding


def limit(seconds: int) -> None:
    """Ask the system to end this process if one file needs too much processor time or memory."""
    try:
        import resource
    except ImportError:  # Windows: the parent checks the time
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    wanted = {
        resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime) + 1 + seconds,
        resource.RLIMIT_AS: MEMORY,
        resource.RLIMIT_CORE: 0,
    }
    for what, most in wanted.items():
        # macOS refuses any limit on the address space; a refused limit says nothing about the file
        with suppress(ValueError, OSError):
            _, hard = resource.getrlimit(what)
            # a limit set from outside may be even lower
            resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def main() -> None:
    """Serve requests until the parent closes the pipe."""
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        path, seconds, only = json.loads(line)
        limit(seconds)
        print(json.dumps(examine(path, only)), flush=True)


if __name__ == "__main__":
    main()
