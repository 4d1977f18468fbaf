"""Inputs that failed once: kept as differences from good files, which lie beside them in ``corpus/good``."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.targets import TARGETS, Target

__all__ = ["FOLDER", "add", "cases"]

FOLDER = Path(__file__).parent / "corpus"


def _base(target: Target) -> Path:
    return FOLDER / "good" / f"{target.file.replace('/', '@')}.gz"


def cases() -> Iterator[tuple[str, Target, bytes]]:
    """Yield name, target and input of every case."""
    by_name = {target.name: target for target in TARGETS}
    for path in sorted(FOLDER.glob("*.z")):
        target = by_name[path.name.split("__")[0]]
        # deflate with the good file as its dictionary: what is the same costs some bytes
        reader = zlib.decompressobj(zdict=gzip.decompress(_base(target).read_bytes()))
        yield path.name, target, reader.decompress(path.read_bytes())


def add(target: Target, good: bytes, data: bytes) -> Path:
    """Keep the input ``data`` of ``target``, made of the file ``good``; return where."""
    base = _base(target)
    if not base.exists():
        base.parent.mkdir(parents=True, exist_ok=True)
        base.write_bytes(gzip.compress(good, 9, mtime=0))
    writer = zlib.compressobj(9, zdict=gzip.decompress(base.read_bytes()))
    number = 1 + sum(path.name.startswith(f"{target.name}__") for path in FOLDER.glob("*.z"))
    place = FOLDER / f"{target.name}__{number}.z"
    place.write_bytes(writer.compress(data) + writer.flush())
    return place
