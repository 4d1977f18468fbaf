"""Compare every plane of an H file with its checksum, and locate damage as closely as possible."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, FileFormatError, InputError, StorageError, Work, drained, format_count
from lfcal.base.h5 import H5Data, H5File
from lfcal.frames import Position
from lfcal.psf._chunk_codec import parallel_read
from lfcal.psf._specification import deviations_of
from lfcal.psf._steps import plane_of_steps
from lfcal.psf._transpose import depth_sum
from lfcal.psf.opening import FOREIGN, open_psf, regions_of, scaling_of, steps_in
from lfcal.psf.store import CHECKED_VERSION, REGIONS, facts_of, plane_checksum

__all__ = ["DamagedPlane", "MatrixCheck", "iter_verify", "verify"]


@dataclass(frozen=True, slots=True)
class DamagedPlane:
    """A plane that differs from the plane that was written.

    Attributes
    ----------
    region
        Region of the field; empty if there is only one.
    z
        Index of the depth plane.
    what
        ``"damaged"``: patterns cannot be decoded. ``"changed"``: all patterns can be decoded, but their checksum
        differs. ``"not finite"``: there are NaN or infinite values. ``"depth sum changed"``: the stored depth-plane sum
        is not the sum of the patterns. ``"uncertainty damaged"``: stored standard deviations cannot be decoded.
    positions
        Positions (z, y, x) of the affected patterns; empty if only the plane is known.
    """

    region: str
    z: int
    what: str
    positions: tuple[Position, ...] = ()


@dataclass(frozen=True, slots=True)
class MatrixCheck:
    """Result of a full check of an H file.

    Attributes
    ----------
    path
        Path of the file.
    planes
        Number of planes read, in all regions of the file.
    compared
        Whether planes were compared with checksums, which files of format version 1 do not contain.
    damaged
        Planes whose contents differ from those that were written.
    missing
        Number of positions that were never recorded.
    deviations
        Deviations from the specification of the format, one line each; empty for version 1, which has no specification.

    Examples
    --------
    >>> from lfcal.psf import MatrixCheck, verify
    >>> check: MatrixCheck = verify("H.h5")
    >>> print(check.path.name, check.planes, "planes,", len(check.damaged), "damaged,", check.missing, "missing")
    H.h5 2 planes, 0 damaged, 0 missing
    """

    data: ClassVar[str] = "H file"

    path: Path
    planes: int
    compared: bool
    damaged: tuple[DamagedPlane, ...]
    missing: int
    deviations: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether no plane is damaged and the file conforms to its format, as far as this can be checked."""
        return not self.damaged and not self.deviations

    def lines(self, most: int = 20) -> Iterator[str]:
        """Yield a line of text for each damaged plane, with up to ``most`` positions, and for each format deviation."""
        for found in self.damaged:
            name = f"{found.region}, plane {found.z}" if found.region else f"plane {found.z}"
            listed = ", ".join(str(tuple(p)) for p in found.positions[:most])
            more = f" and {len(found.positions) - most} more" if len(found.positions) > most else ""
            yield f"{name}: {found.what}" + (f" at (z, y, x) = {listed}{more}" if listed else "")
        for line in self.deviations:
            yield f"deviation from the format: {line}"

    @property
    def known(self) -> str:
        """Clause that states the number of intact planes, for use in a quality verdict."""
        bad = len({(one.region, one.z) for one in self.damaged})
        how = "compared with their checksums" if self.compared else "read; a file of version 1 has no checksums"
        return f"intact in {self.planes - bad:,} of {format_count(self.planes, 'plane', 'planes')} ({how})"


def iter_verify(path: str | os.PathLike[str], *, workers: int | None = None) -> Work[MatrixCheck]:
    """Check an H file: compare it with the specification of its format, and every plane with its checksum.

    Parameters
    ----------
    path
        H file (``.h5``).
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    StorageError, FileFormatError, UnsafeFileError
        If the file cannot be read, is not an H file, or is too damaged to be opened.

    Examples
    --------
    >>> from lfcal.psf import iter_verify
    >>> for step in iter_verify("H.h5"):
    ...     print(step.stage, step.count)
    check planes 0 of 2
    check planes 1 of 2
    check planes 2 of 2
    """
    source = Path(path)
    if not source.exists():
        raise StorageError(f"{source}: no such file or folder; check the path")
    if source.suffix.lower() in FOREIGN:
        got = f"a {source.suffix.lower()} file, which has no checksums"
        raise FileFormatError.expected(str(source), "an lfcal H file (.h5)", got, "check this file with lfcal inspect")
    regions = regions_of(source)
    with H5File(source) as file:
        strays = deviations_of(file) if (file.attributes().integer("version") or 0) >= CHECKED_VERSION else []
    found: list[DamagedPlane] = []
    planes = missing = 0
    compared = True
    for number, region in enumerate(regions):
        try:
            with open_psf(source, region=region) as matrix:
                recorded = facts_of(matrix).recorded
                missing += 0 if recorded is None else int((recorded == 0).sum())
        except InputError as error:
            if not strays:
                raise
            # the deviations above already say what is wrong with it
            strays.append(f"{f'region {region}' if region else 'H'} cannot be opened: {error}")
            continue
        with H5File(source) as file:
            prefix = f"{REGIONS}/{region}/" if number else ""
            data = file.dataset(f"{prefix}H")
            stored = _Stored.of(file, prefix, data) if f"{prefix}checksum" in file else None
            compared &= stored is not None
            sure = file.dataset(f"{prefix}uncertainty") if f"{prefix}uncertainty" in file else None
            clock = Clock(f"check planes {region}".rstrip(), data.shape[0])
            for z in range(data.shape[0]):
                yield clock.at(z)
                found += _look(data, z, stored, region, workers)
                if sure is not None and (bad := _unreadable(sure, z, workers)):
                    found.append(DamagedPlane(region, z, "uncertainty damaged", bad))
            planes += data.shape[0]
            yield clock.at(data.shape[0])
    return MatrixCheck(source, planes, compared, tuple(found), missing, tuple(strays))


verify = drained(
    iter_verify,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, save, verify
    >>> path = save(PSFMatrix(np.ones((3, 2, 2, 5, 5)), recorded=[[[1, 0], [0, 1]]] * 3), "new.h5")
    >>> check = verify(path)
    >>> print("as written:", check.ok, "-", check.missing, "of 12 positions were never recorded")
    as written: True - 6 of 12 positions were never recorded
    """,
)


class _Stored(NamedTuple):
    """Data on planes in files since version 2: checksums, sums over all positions, and scaling of the stored values."""

    checksum: NDArray[np.uint32]
    depth_sum: NDArray[np.float64]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    steps: tuple[NDArray[np.float32], NDArray[np.uint16]] | None

    @classmethod
    def of(cls, file: H5File, prefix: str, data: H5Data) -> _Stored:
        """Read the data on the planes of the dataset ``data``, whose group has the path ``prefix``."""
        planes = data.shape[0]
        checksum = file.values(f"{prefix}checksum", (planes,), kinds="u")
        sums = file.values(f"{prefix}depth_sum", (planes, *data.shape[3:]))
        scale, offset = (np.broadcast_to(found, planes) for found in scaling_of(file, data))
        return cls(checksum, sums, scale, offset, steps_in(file, prefix, data))

    def sums_agree(self, z: int, plane: NDArray[Any], workers: int | None) -> bool:
        """Return whether the stored sum of plane ``z`` equals the sum of its patterns, up to rounding."""
        count = plane.shape[0] * plane.shape[1]
        if self.steps is not None:
            plane = plane_of_steps(plane, self.steps[0][z], self.steps[1][z], workers)
        found = depth_sum(plane, workers) * self.scale[z] + count * self.offset[z]
        return bool(np.allclose(found, self.depth_sum[z], rtol=0, atol=1e-5 * float(np.abs(found).max()) + 1e-300))


def _look(data: H5Data, z: int, stored: _Stored | None, region: str, workers: int | None) -> Iterator[DamagedPlane]:
    """Yield the damage of plane ``z``."""
    try:
        plane = parallel_read(data, z, workers=workers)
    except (FileFormatError, StorageError):  # a bad sector is damage too
        yield DamagedPlane(region, z, "damaged", _undecodable(data, z))
        return
    if stored is not None and plane_checksum(plane, workers) != int(stored.checksum[z]):
        yield DamagedPlane(region, z, "changed")
    finite = np.array([[bool(np.isfinite(pattern).all()) for pattern in row] for row in plane])
    if not finite.all():
        yield DamagedPlane(region, z, "not finite", _at(z, ~finite))
    elif stored is not None and not stored.sums_agree(z, plane, workers):
        yield DamagedPlane(region, z, "depth sum changed")


def _unreadable(data: H5Data, z: int, workers: int | None) -> tuple[Position, ...]:
    """Return the positions of plane ``z`` that cannot be decoded; each chunk has a separate checksum."""
    try:
        parallel_read(data, z, workers=workers)
    except (FileFormatError, StorageError):
        return _undecodable(data, z)
    return ()


def _undecodable(data: H5Data, z: int) -> tuple[Position, ...]:
    """Return the positions of plane ``z`` whose patterns HDF5 cannot decode."""
    bad = np.zeros(data.shape[1:3], np.bool_)
    for y, x in np.ndindex(*bad.shape):
        try:
            data.read((z, y, x))
        except (FileFormatError, StorageError):  # a bad sector is damage too
            bad[y, x] = True
    return _at(z, bad)


def _at(z: int, mask: NDArray[np.bool_]) -> tuple[Position, ...]:
    return tuple(Position(z, y, x) for y, x in np.argwhere(mask).tolist())
