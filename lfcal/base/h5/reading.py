"""HDF5 files of unknown origin, opened for reading: every attribute and dataset is checked before it is read."""

from __future__ import annotations

import errno
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar, overload
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, LfcalError, StorageError, UnsafeFileError, any_of
from lfcal.base.files import MAX_EXPANSION, check_regular, storage_errors, system_error
from lfcal.base.h5.chunks import ChunkTable
from lfcal.base.h5.codecs import has_codecs, require_codecs
from lfcal.base.h5.probe import probe
from lfcal.base.units import format_bytes, format_count

__all__ = ["MAX_BYTES", "Attributes", "H5Data", "H5File", "damage"]


MAX_BYTES = 1 << 44
"""Largest declared size of a dataset (17.6 TB)."""

MAX_REFERENCES = 1 << 20
"""Largest number of references in a dataset; each is a separate entry to read."""

MAX_LINKS = 16
"""Largest number of soft links followed to one entry; more of them may form a loop."""


def _opened(path: Path) -> Any:
    import h5py

    # without HDF5's lock, a file can be read while another program writes it, and on network disks. Within one
    # program, a second opening must request the same lock as the first. A file opened in a notebook has h5py's
    # default, or any other.
    for options in ({"locking": False}, {}, {"locking": True}):
        try:
            return h5py.File(path, "r", **options)
        except OSError as error:
            if "flag values don't match" not in str(error):
                raise
            refused = error
    raise refused


class H5File:
    """An HDF5 file opened for reading. All content is checked, and errors have one-line messages.

    Names are paths within the file, such as ``H`` or ``regions/corner/H``; the name of the root is empty. Soft links
    within the file are followed; external links are not. Use the object as a context manager, or close it with `close`.

    Parameters
    ----------
    path
        Path of the file.
    only
        Datasets whose data may be read (large ones only by `H5Data.read_middle`), so that a file of any size is opened
        in milliseconds. None: all data may be read.

    Raises
    ------
    StorageError
        If the file does not exist, or there is no permission to read it.
    FileFormatError
        If the file is not an HDF5 file, or is damaged.
    """

    def __init__(self, path: Path, *, only: tuple[str, ...] | None = None) -> None:
        if not path.exists():
            raise StorageError(f"{path}: no such file; check the path")
        check_regular(path)
        with storage_errors(path):
            # a plain open first: h5py's error does not distinguish a missing permission from damaged data
            path.open("rb").close()
        probe(path, only)
        has_codecs()  # registers them

        self.path = path
        self._given: WeakSet[H5Data] = WeakSet()
        try:
            self._file = _opened(path)
        except (OSError, RuntimeError, ValueError) as error:
            raise FileFormatError.expected(
                str(path), "an intact HDF5 file", "a damaged or different file", "record or copy it again"
            ) from error

    def close(self) -> None:
        """Close the file; may be called twice."""
        for data in self._given:
            data.release()
        with damage(self.path):
            self._file.close()

    def __enter__(self) -> Self:
        """Return the file."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def __contains__(self, name: str) -> bool:
        """Return whether an entry ``name`` exists, of any kind."""
        group, _, last = name.rpartition("/")
        return last in self.names(group)

    def names(self, group: str = "") -> tuple[str, ...]:
        """Return the names of the entries of a group; empty if there is no such group."""
        import h5py

        found = self._object(group) if not group or group in self else None
        with damage(self.path, group):
            return tuple(str(name) for name in found) if isinstance(found, h5py.Group) else ()

    def attributes(self, name: str = "") -> Attributes:
        """Return the attributes of the entry ``name``; raise `FileFormatError` if there is no such entry."""
        return Attributes(self.path, self._object(name), name)

    def dataset_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the dataset ``name`` in the root.

        It is empty if there is no such dataset, or if ``name`` is a soft or external link.
        """
        import h5py

        with damage(self.path, name):
            if name not in self.names() or self._file.get(name, getclass=True, getlink=True) is not h5py.HardLink:
                return ()
            entry = self._file[name]
            return tuple(entry.shape or ()) if isinstance(entry, h5py.Dataset) else ()

    def datasets(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of every dataset of integers or real numbers, by name.

        Soft and external links are not followed. A dataset with several names is included once.
        """
        import h5py

        found: dict[str, tuple[int, ...]] = {}
        seen: set[Any] = set()
        pending = [("", self._file)]
        while pending:
            place, group = pending.pop()
            with damage(self.path, place):
                for key in group:
                    if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                        continue
                    entry, name = group[key], f"{place}/{key}".lstrip("/")
                    mark = h5py.h5o.get_info(entry.id).addr
                    if mark in seen:
                        continue
                    seen.add(mark)
                    if isinstance(entry, h5py.Group):
                        pending.append((name, entry))
                    elif isinstance(entry, h5py.Dataset) and entry.dtype.kind in "iuf":
                        found[name] = tuple(entry.shape or ())
        return found

    def links_out(self) -> list[str]:
        """Return the sorted targets of all external links as ``file::/dataset``; their files are not opened."""
        import h5py

        found: list[str] = []
        seen: set[Any] = set()
        pending = [self._file]
        while pending:
            group = pending.pop()
            with damage(self.path):
                mark = h5py.h5o.get_info(group.id).addr
                if mark in seen:
                    continue
                seen.add(mark)
                for key in group:
                    link = group.get(key, getlink=True)
                    if isinstance(link, h5py.ExternalLink):
                        found.append(f"{link.filename}::/{link.path.lstrip('/')}")
                    elif isinstance(link, h5py.HardLink) and group.get(key, getclass=True) is h5py.Group:
                        pending.append(group[key])
        return sorted(found)

    def dataset(
        self, name: str, *, max_bytes: int = MAX_BYTES, dtype: np.dtype[Any] | None = None, holes: bool = False
    ) -> H5Data:
        """Return a dataset of numbers after checking its type, size and storage; see `H5Data` for the parameters."""
        import h5py

        data = self._object(name)
        if not isinstance(data, h5py.Dataset):
            raise FileFormatError.expected(f"{self.path}:/{name}", "a dataset", type(data).__name__, "check the file")
        found = H5Data(data, max_bytes=max_bytes, dtype=dtype, holes=holes)
        self._given.add(found)
        return found

    def values(
        self,
        name: str,
        shape: tuple[int, ...] | None = None,
        *,
        kinds: str = "iuf",
        finite: bool = False,
        at_most: float | None = None,
    ) -> NDArray[Any]:
        """Return all values of a dataset of at most 4 GiB.

        Parameters
        ----------
        name
            Name of the dataset.
        shape
            Required shape. None: any shape.
        kinds
            Accepted kinds of numbers, as in numpy's ``dtype.kind``.
        finite
            Whether to reject NaN and infinity.
        at_most
            Largest accepted magnitude; NaN is rejected as well. None: no limit.

        Raises
        ------
        FileFormatError
            If there is no such dataset, or it has another shape, kind or range.
        """
        data = self.dataset(name, max_bytes=1 << 32)
        if data.dtype.kind not in kinds or (shape is not None and data.shape != shape):
            wanted = "whole numbers" if "f" not in kinds else "numbers"
            wanted += f" of shape {shape}" if shape is not None else ""
            raise self._wrong(name, wanted, f"{data.dtype} of shape {data.shape}")
        values = data.read()
        if finite and not np.isfinite(values).all():
            raise self._wrong(name, "finite numbers", "NaN or infinity")
        if at_most is not None and values.size:
            most = float(np.abs(values.astype(np.float64, copy=False)).max())
            if not most <= at_most:
                raise self._wrong(name, f"numbers up to {at_most:g}", f"{most:g}")
        return values

    def references(self, name: str) -> NDArray[np.object_]:
        """Return the names of the entries to which a dataset of object references refers, as an array of its shape.

        The names are those of datasets or groups in this file. What these contain is not checked.

        Raises
        ------
        FileFormatError
            If the dataset contains other values or too many references, or a reference leads nowhere.
        """
        import h5py

        data = self._object(name)
        stored = isinstance(data, h5py.Dataset) and h5py.check_ref_dtype(data.dtype) is h5py.Reference
        if not stored or data.size > MAX_REFERENCES:
            got = f"{data.size} values" if stored else "other values"
            raise self._wrong(name, f"up to {MAX_REFERENCES} references to entries of the file", got)
        found = np.empty(data.shape, object)
        with damage(self.path, name):
            values = data[()]
            for at in np.ndindex(data.shape):
                # of an unnamed or removed entry, there is no name
                found[at] = self._file[values[at]].name if values[at] else None
                if not found[at]:
                    raise self._wrong(name, "references to entries of the file", "one without a target")
        return found

    def _wrong(self, name: str, wanted: str, got: str) -> FileFormatError:
        return FileFormatError.expected(f"{self.path}:/{name}", wanted, got, "get the file from its source again")

    def _object(self, name: str) -> Any:
        """Return the entry ``name``, following only links within the file."""
        import h5py

        entry: Any = self._file
        parts, links, followed = name.split("/")[::-1], 0, ""
        with damage(self.path, name):
            while parts:
                part = parts.pop()
                if part in ("", "."):
                    continue
                # only entries in the list: see `Attributes`
                names = [str(key) for key in entry] if isinstance(entry, h5py.Group) else []
                if part not in names:
                    only = f"only {', '.join(sorted(names)[:8]) or 'nothing'}"
                    wanted, got = "a dataset of this name", only
                    if followed:
                        wanted, got = "a dataset", f"a link to {followed}, which does not exist"
                    raise FileFormatError.expected(f"{self.path}:/{name}", wanted, got, "check the file")
                link = entry.get(part, getlink=True)
                if isinstance(link, h5py.SoftLink) and links < MAX_LINKS:
                    parts, links, followed = [*parts, *link.path.split("/")[::-1]], links + 1, link.path
                    entry = self._file if link.path.startswith("/") else entry
                    continue
                # an external link could lead to any file of this machine
                if not isinstance(link, h5py.HardLink):
                    kind = "a chain of soft links" if isinstance(link, h5py.SoftLink) else type(link).__name__
                    raise UnsafeFileError.expected(
                        f"{self.path}:/{name}", "data stored in the file itself", kind, "copy the data in"
                    )
                entry = entry[part]
        return entry


Index = int | slice | tuple[int | slice, ...]

KNOWN_FILTERS = {1, 2, 3, 32000, 32001, 32004, 32008, 32015}
"""HDF5 filters that can be read: deflate, shuffle, fletcher32, lzf, blosc, lz4, bitshuffle, zstd."""


class H5Data:
    """A dataset of numbers in an HDF5 file: its type and shape, and methods that read it.

    Damage is reported as an error of one line.

    Attributes
    ----------
    path, name
        Path of the file, and name of the dataset.
    table
        Locations of the chunks; None if data are contiguous or absent.
    shape, dtype, chunks
        Declared shape, type and shape of chunks; ``chunks`` is None for contiguous data.
    filters
        HDF5 filter IDs, in the order in which they are applied when writing.

    Parameters
    ----------
    dataset
        Open h5py dataset.
    max_bytes
        Largest allowed declared size (bytes).
    dtype
        Required type, for the records of a recording. None: any type of integers, real or complex numbers, or bool.
    holes
        Whether chunks, or the contiguous data, may be missing; these samples then have the fill value.

    Raises
    ------
    UnsafeFileError
        If the dataset has external storage, unknown filters or another type, is virtual, or its size exceeds
        ``max_bytes`` or far exceeds that of the file.
    FileFormatError
        If the file is damaged or unfinished.
    InputError
        If the data require hdf5plugin, which is not installed.
    """

    def __init__(
        self, dataset: Any, *, max_bytes: int = MAX_BYTES, dtype: np.dtype[Any] | None = None, holes: bool = False
    ) -> None:
        self.path = Path(dataset.file.filename)
        self.name = str(dataset.name).lstrip("/")
        self._data = dataset
        with damage(self.path, self.name):
            self._describe(max_bytes, dtype, holes)

    def _describe(self, max_bytes: int, dtype: np.dtype[Any] | None, holes: bool) -> None:
        import h5py

        data = self._data
        plist = data.id.get_create_plist()
        self._check_inside(plist)
        self.dtype: np.dtype[Any] = np.dtype(data.dtype)
        if dtype is not None and self.dtype != dtype:
            raise self._unsafe(
                "the data type of the records of a recording", f"{self.dtype}", "get the file from its source again"
            )
        if dtype is None and self.dtype.kind not in "iufcb":
            raise self._unsafe("plain numbers", f"dtype {self.dtype}", "store the data as numbers")
        if dtype is None:
            self.dtype = np.dtype(self.dtype.str)  # without the names of an enumeration, which NPY files cannot store
        if data.shape is None:
            raise FileFormatError.expected(
                self.where, "numbers", "an empty dataset", "get the file from its source again"
            )
        self.shape = tuple(int(n) for n in data.shape)
        self.chunks = None if data.chunks is None else tuple(int(n) for n in data.chunks)
        self.filters = tuple(int(plist.get_filter(k)[0]) for k in range(plist.get_nfilters()))
        if other := sorted(set(self.filters) - KNOWN_FILTERS):
            raise self._unsafe(
                "gzip, lzf, zstd, blosc or lz4",
                f"HDF5 filter {', '.join(map(str, other))}",
                "repack the file with one of these filters (h5repack)",
            )
        if not all(h5py.h5z.filter_avail(number) for number in self.filters):
            require_codecs(self.where)
        self._check_size(max_bytes)
        self._holes = holes
        self.table: ChunkTable | None = None
        self._check_stored()

    def _check_inside(self, plist: Any) -> None:
        import h5py

        # both could lead to any file of this machine
        if plist.get_external_count():
            raise self._unsafe("data stored in the file itself", "external storage", "copy the data into the file")
        if plist.get_layout() == h5py.h5d.VIRTUAL:
            files = {plist.get_virtual_filename(k) for k in range(min(plist.get_virtual_count(), 100))} - {"."}
            of = f" of {min(files)}" if len(files) == 1 else f" of {len(files)} files" if files else ""
            raise self._unsafe(
                "stored data", f"a virtual dataset{of}", "open the file that contains the data, or copy the data in"
            )

    def _check_size(self, max_bytes: int) -> None:
        stored = self._file_size()
        if self.nbytes > max_bytes:
            raise self._unsafe(f"at most {format_bytes(max_bytes)}", format_bytes(self.nbytes), "check the file")
        if self.nbytes > MAX_EXPANSION * stored + (1 << 20):
            raise self._unsafe(
                f"a size that fits into a file of {format_bytes(stored)}",
                f"{format_bytes(self.nbytes)} according to its header",
                "get the file from its source again",
            )

    def _check_stored(self) -> None:
        """Raise an error unless all data exist and every chunk is within the file."""
        if not self.nbytes:
            return
        if self.chunks is None:
            have = self._data.id.get_storage_size()
            if have < self.nbytes and not self._holes:
                raise self._unfinished(f"{format_bytes(self.nbytes)} of data", format_bytes(have))
            return
        self.table = ChunkTable(self._data, self.path, self.where)
        if self.table.missing and not self._holes:
            raise self._unfinished(
                "all chunks written", format_count(self.table.missing, "missing chunk", "missing chunks")
            )

    def _file_size(self) -> int:
        # while a file is being written, HDF5 may know of more bytes than the system
        return int(self._data.file.id.get_filesize())

    @property
    def where(self) -> str:
        """Name of file and dataset, for messages."""
        return f"{self.path}:/{self.name}"

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(np.prod(self.shape, dtype=object))

    @property
    def nbytes(self) -> int:
        """Declared size of all samples (bytes)."""
        return self.size * self.dtype.itemsize

    @property
    def attributes(self) -> Attributes:
        """Attributes of the dataset."""
        return Attributes(self.path, self._data, self.name)

    @property
    def is_open(self) -> bool:
        """Whether the file is open."""
        return bool(self._data.id.valid)

    @property
    def offset(self) -> int | None:
        """Offset in the file at which contiguous data begin (bytes); None for data that are chunked or absent."""
        with damage(self.path, self.name):
            found = None if self.chunks is not None else self._data.id.get_offset()
        return None if found is None else int(found)

    def read(self, index: Index = ()) -> NDArray[Any]:
        """Return a part of the data as a new array.

        Parameters
        ----------
        index
            An integer or a slice for each axis, in order; axes without one are read completely.

        Raises
        ------
        IndexError
            If an integer is outside the dataset, or there are more indices than axes.
        FileFormatError
            If the data are damaged, or the file is closed.
        """
        if not self.is_open:
            raise FileFormatError(f"{self.where}: its file is closed; open it again")
        box, key = _box(index, self.shape)
        with damage(self.path, self.name):
            if self.table is None or self.table.filters is None:
                values = np.asarray(self._data[box])
            else:
                values = self.table.read(box)
        return np.asarray(values[key], self.dtype)  # numpy converts single values to the native byte order

    def read_middle(self) -> NDArray[Any]:
        """Return the middle chunk; if the data are contiguous, return the middle image (last two axes)."""
        sides = self.chunks or (*(1 for _ in self.shape[:-2]), *self.shape[-2:])
        grid = tuple(-(-n // side) for n, side in zip(self.shape, sides, strict=True))
        at = np.unravel_index(int(np.prod(grid)) // 2, grid)
        box = tuple(slice(int(k) * side, (int(k) + 1) * side) for k, side in zip(at, sides, strict=True))
        with damage(self.path, self.name):  # by HDF5: for one chunk, compiling lfcal's own reader does not pay off
            return np.asarray(self._data[box], self.dtype)

    def close_file(self) -> None:
        """Close the file that contains the dataset; may be called twice."""
        self.release()
        with damage(self.path, self.name):
            if self.is_open:
                self._data.file.close()

    def release(self) -> None:
        """Close the file descriptors that were opened in addition to that of HDF5."""
        if self.table is not None:
            self.table.close()

    def _unsafe(self, wanted: str, got: str, remedy: str) -> UnsafeFileError:
        return UnsafeFileError.expected(self.where, wanted, got, remedy)

    def _unfinished(self, wanted: str, got: str) -> FileFormatError:
        return FileFormatError.expected(self.where, wanted, got, "the file is unfinished; write it again")


def _box(index: Index, shape: tuple[int, ...]) -> tuple[tuple[slice, ...], tuple[int | slice, ...]]:
    """Return the smallest box of samples that contains ``index``, and the index within that box."""
    given = index if isinstance(index, tuple) else (index,)
    if len(given) > len(shape):
        raise IndexError(f"too many indices: {len(given)} for {len(shape)} axes")
    box: list[slice] = []
    within: list[int | slice] = []
    for part, n in zip((*given, *[slice(None)] * (len(shape) - len(given))), shape, strict=True):
        if isinstance(part, slice):
            picked = range(n)[part]
            first, last = (min(picked[0], picked[-1]), max(picked[0], picked[-1]) + 1) if picked else (0, 0)
            box.append(slice(first, last))
            within.append(slice(None, None, part.step) if picked else slice(None))
        else:
            at = range(n)[part]
            box.append(slice(at, at + 1))
            within.append(0)
    return tuple(box), tuple(within)


D = TypeVar("D")


class Attributes:
    """Attributes of one object in a file; its methods raise `FileFormatError` for an attribute of the wrong type.

    Parameters
    ----------
    path
        Path of the file.
    owner
        Open h5py object.
    name
        Name of the object in the file, for messages; empty for the file itself.
    """

    def __init__(self, path: Path, owner: Any, name: str = "") -> None:
        self._path, self._name = path, name
        with damage(path, name):
            self._values = owner.attrs
            # the child that checked the file used this list: attributes outside it must not be read
            self._keys = tuple(str(key) for key in self._values)

    @overload
    def text(self, key: str) -> str | None: ...
    @overload
    def text(self, key: str, default: str) -> str: ...
    def text(self, key: str, default: str | None = None) -> str | None:
        """Return the attribute ``key``, which must be text; ``default`` if it is absent."""
        value = self._get(key)
        if value is None:
            return default
        if isinstance(value, bytes):
            with damage(self._path, self._name):
                return value.decode()
        if not isinstance(value, str):
            raise self._wrong(key, "text", value)
        return value

    def integer(self, key: str) -> int | None:
        """Return the attribute ``key``, which must be one integer; None if it is absent."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, int | np.integer):
            raise self._wrong(key, "a whole number", value)
        return int(value)

    def numbers(self, key: str, lengths: tuple[int, ...]) -> NDArray[np.float64] | None:
        """Return the attribute ``key``, which must be finite numbers, as a 1-D array; None if it is absent.

        The length must be one of ``lengths``. A scalar is an array of length 1.
        """
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, np.ndarray | np.number) or np.asarray(value).dtype.kind not in "iuf":
            raise self._wrong(key, "numbers", value)
        numbers = np.asarray(value, np.float64)
        if numbers.ndim > 1 or numbers.size not in lengths or not np.isfinite(numbers).all():
            wanted = any_of(str(n) for n in sorted(set(lengths)))
            raise self._wrong(key, f"finite numbers, {wanted} of them", value)
        return numbers.ravel()

    def plain(self) -> dict[str, Any]:
        """Return all attributes that are text, numbers or arrays, by name."""
        with damage(self._path, self._name):
            found = {key: self._values[key] for key in self._keys}
        return {key: value for key, value in found.items() if isinstance(value, str | np.ndarray | np.generic)}

    def _get(self, key: str) -> Any:
        with damage(self._path, self._name):
            return self._values[key] if key in self._keys else None

    def _wrong(self, key: str, wanted: str, value: Any) -> FileFormatError:
        place = f"{self._path}:/{self._name}" if self._name else str(self._path)
        shown = " ".join(repr(value).split())
        return FileFormatError.expected(
            f"{place}, attribute {key}",
            wanted,
            shown if len(shown) <= 60 else f"{shown[:60]}…",
            "get the file from its source again",
        )


_OF_THE_DISK = {errno.EIO, errno.EACCES, errno.EPERM, errno.ESTALE, errno.ENODEV, errno.ENOENT}
"""Errors that concern the disk and not its content."""


class damage:
    """Context manager that converts errors of h5py to a `FileFormatError`, or a `StorageError` if the disk fails.

    On damaged data, h5py raises KeyError, RuntimeError, OSError, TypeError, ValueError, OverflowError and UnicodeError.
    Every exception other than `LfcalError` is therefore converted. The message names the file ``path`` and the entry
    ``where``, unless this is empty.
    """

    # a class: it is entered for every pattern, and a generator would cost as much as the read
    __slots__ = ("_path", "_where")

    def __init__(self, path: Path, where: str = "") -> None:
        self._path, self._where = path, where

    def __enter__(self) -> None:
        """Enter the context."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Raise `FileFormatError` or `StorageError` instead of h5py's error."""
        if not isinstance(error, Exception) or isinstance(error, LfcalError):
            return
        if isinstance(error, OSError | RuntimeError) and system_error(error) in _OF_THE_DISK:
            with storage_errors(self._path):
                raise error
        message = " ".join(str(error).split())[:120] or type(error).__name__
        where = f"{self._path}:/{self._where}" if self._where else str(self._path)
        raise FileFormatError.expected(
            where, "intact data", f"damaged data ({message})", "copy the file again from its source"
        ) from error
