"""An HDF5 file of unknown origin, opened for reading."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, StorageError, UnsafeFileError
from lfcal.base.files import check_regular, storage_errors
from lfcal.base.h5._errors import damage
from lfcal.base.h5.attributes import Attributes
from lfcal.base.h5.dataset import MAX_BYTES, H5Data
from lfcal.base.h5.probe import probe

__all__ = ["H5File"]


def _opened(path: Path) -> Any:
    import h5py

    # without HDF5's lock a file can be read while another program writes it, and on network disks. In one program it is
    # opened a second time only by whoever asks for the same lock: a notebook's file has h5py's default, or any.
    for options in ({"locking": False}, {}, {"locking": True}):
        try:
            return h5py.File(path, "r", **options)
        except OSError as error:
            if "flag values don't match" not in str(error):
                raise
            refused = error
    raise refused


class H5File:
    """An HDF5 file opened for reading; everything asked of it is checked and answers with one-line errors.

    Names are paths within the file: ``H``, ``regions/corner/H``, empty for the root. Soft and external links are never
    followed. Used as a context manager, or closed with `close`.

    Raises
    ------
    StorageError
        If there is no such file or it may not be read.
    FileFormatError
        If it is no HDF5 file, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise StorageError(f"{path}: no such file; check the path")
        check_regular(path)
        with storage_errors(path):
            # a plain open first: h5py's own error does not tell a missing permission from damaged data
            path.open("rb").close()
        probe(path)
        import hdf5plugin  # noqa: F401  registers zstd, blosc and lz4 with HDF5

        self.path = path
        self._given: WeakSet[H5Data] = WeakSet()
        try:
            self._file = _opened(path)
        except (OSError, RuntimeError, ValueError) as error:
            raise FileFormatError.expected(
                str(path), "an intact HDF5 file", "a damaged or other file", "record or copy it again"
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
        """Return whether there is an entry ``name``, whatever it is."""
        group, _, last = name.rpartition("/")
        return last in self.names(group)

    def names(self, group: str = "") -> tuple[str, ...]:
        """Return the names of the entries of a group, none where there is no such group."""
        import h5py

        found = self._object(group) if not group or group in self else None
        with damage(self.path, group):
            return tuple(str(name) for name in found) if isinstance(found, h5py.Group) else ()

    def attributes(self, name: str = "") -> Attributes:
        """Return the attributes of an entry."""
        return Attributes(self.path, self._object(name), name)

    def dataset_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an entry of the root, empty where it is no dataset, or a link to one elsewhere."""
        import h5py

        with damage(self.path, name):
            if name not in self.names() or self._file.get(name, getclass=True, getlink=True) is not h5py.HardLink:
                return ()
            entry = self._file[name]
            return tuple(entry.shape or ()) if isinstance(entry, h5py.Dataset) else ()

    def dataset(
        self, name: str, *, max_bytes: int = MAX_BYTES, dtype: np.dtype[Any] | None = None, holes: bool = False
    ) -> H5Data:
        """Return a dataset; see `H5Data` for what is refused."""
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
        """Return all of a small dataset (4 GB at most).

        Parameters
        ----------
        name
            The dataset.
        shape
            The shape it must have; None takes any.
        kinds
            Kinds of numbers accepted, as numpy's ``dtype.kind``.
        finite
            Refuse NaN and infinity.
        at_most
            Largest magnitude accepted; refuses NaN, too.
        """
        data = self.dataset(name, max_bytes=1 << 32)
        if data.dtype.kind not in kinds or (shape is not None and data.shape != shape):
            wanted = f"{'whole numbers' if 'f' not in kinds else 'numbers'}, shape {shape if shape else 'any'}"
            raise self._wrong(name, wanted, f"{data.dtype}, shape {data.shape}")
        values = data.read()
        if finite and not np.isfinite(values).all():
            raise self._wrong(name, "finite numbers", "NaN or infinity")
        if at_most is not None and values.size:
            most = float(np.abs(values.astype(np.float64, copy=False)).max())
            if not most <= at_most:
                raise self._wrong(name, f"numbers up to {at_most:g}", f"{most:g}")
        return values

    def _wrong(self, name: str, wanted: str, got: str) -> FileFormatError:
        return FileFormatError.expected(f"{self.path}:/{name}", wanted, got, "take the file from its source again")

    def _object(self, name: str) -> Any:
        """Return the entry ``name``, reached by hard links alone."""
        import h5py

        entry: Any = self._file
        with damage(self.path, name):
            for part in (p for p in name.split("/") if p):
                # by the list: see `Attributes`
                names = [str(key) for key in entry] if isinstance(entry, h5py.Group) else []
                if part not in names:
                    only = ", ".join(sorted(names)[:8]) or "nothing"
                    raise FileFormatError.expected(
                        f"{self.path}:/{name}", "a dataset of this name", f"only {only}", "check the file"
                    )
                link = entry.get(part, getlink=True)
                # a link may lead to any file of this machine
                if not isinstance(link, h5py.HardLink):
                    raise UnsafeFileError.expected(
                        f"{self.path}:/{name}",
                        "data stored in the file itself",
                        type(link).__name__,
                        "copy the data in",
                    )
                entry = entry[part]
        return entry
