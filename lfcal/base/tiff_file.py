"""TIFF files that appear whole or not at all."""

from __future__ import annotations

import io
import os
from typing import TYPE_CHECKING, Any

from lfcal.base.files import replace_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["write_tiff"]


class _Counted(io.BufferedRandom):
    """A file that arrays are written to through Python alone.

    numpy writes to a file with a descriptor by the C library's buffers, and does not ask whether their last
    kilobytes arrived on the disk.
    """

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")


def write_tiff(path: str | os.PathLike[str], data: NDArray[Any], **options: Any) -> None:
    """Write an array as TIFF; ``options`` are those of `tifffile.imwrite`.

    Raises
    ------
    StorageError
        If the disk does not take all of it; what was there stays.
    """
    import tifffile

    with replace_whole(path) as part, _Counted(io.FileIO(part, "w+b")) as file:
        tifffile.imwrite(file, data, photometric="minisblack", **options)
