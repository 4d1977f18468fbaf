"""Optional codecs of HDF5: zstd, blosc, lz4 and bitshuffle, which other programs use; lfcal itself writes gzip."""

from __future__ import annotations

from lfcal.base.errors import InputError

__all__ = ["has_codecs", "require_codecs"]


def has_codecs() -> bool:
    """Return whether hdf5plugin is installed; it is then registered with HDF5."""
    try:
        import hdf5plugin  # noqa: F401
    except ImportError:
        return False
    return True


def require_codecs(what: str) -> None:
    """Raise `InputError` unless hdf5plugin is installed, whose codecs the data named ``what`` require."""
    if not has_codecs():
        raise InputError.expected(
            what,
            "the library hdf5plugin, which contains the codecs zstd, blosc, lz4 and bitshuffle",
            "no such library",
            'run: pip install "lfcal[hdf5]"',
        )
