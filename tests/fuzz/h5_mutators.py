"""Ways to spoil an HDF5 file that keep it one: types, shapes, values, attributes, links and foreign storage."""

from __future__ import annotations

import io
from collections.abc import Callable
from random import Random
from typing import Any

import h5py
import numpy as np

from tests.fuzz.mutators import mutate

__all__ = ["restructure"]

Change = Callable[[h5py.File, str, Random], None]

FOREIGN = (
    "/dev/zero",
    "/dev/stdin",
    "/etc/hostname",
    "nowhere.h5",
    "H.h5",
    "../H.h5",
    ".",
    "//host.invalid/share/x.h5",
)
"""Files that a link, or the storage of a dataset, may lead to."""

NUMBERS = (0, 1, -1, 2, 255, 65535, 1 << 31, (1 << 63) - 1, 1e-300, 1e308, np.nan, np.inf, -np.inf, 0.5, -0.0)

TEXTS = ("", "x", "\u202e", "a\nb", "1", "long " * 12000, "../../x", "NaN", "[1, 2]", "{}", "[" * 60000, "\x1b[2J")

COMPOUND = np.dtype([("a", "<f4"), ("b", "<i8", (2,))])


def _kinds() -> tuple[Any, ...]:
    numbers = ("<f2", "<f4", ">f8", "<i1", "<i4", ">i8", "u1", "<u2", "<u8", "?", "<c8", "S3", "V5")
    made = (h5py.string_dtype(), h5py.vlen_dtype(np.int32), h5py.ref_dtype, h5py.enum_dtype({"a": 0, "b": 1}), COMPOUND)
    return numbers + made


def _shapes(shape: tuple[int, ...], rng: Random) -> tuple[int, ...]:
    axis = rng.randrange(len(shape)) if shape else 0
    one = shape[:axis] + shape[axis + 1 :]
    sizes = (0, 1, 2, 3, max(shape, default=1) + 1, 1 << 20, 1 << 40, (1 << 62))
    return rng.choice((one, (*shape, 1), (1, *shape), shape[::-1], (), (*one, rng.choice(sizes)), (0,) * len(shape)))


def _values(kind: Any, shape: tuple[int, ...], rng: Random) -> Any:
    """Return an array of few elements, all the same or with one extreme."""
    dtype = np.dtype(kind)
    if dtype.kind in "biufc":
        with np.errstate(all="ignore"):
            made = np.full(shape, np.float64(rng.choice(NUMBERS)).astype(dtype))
            if made.size:
                made.flat[rng.randrange(made.size)] = np.float64(rng.choice(NUMBERS)).astype(dtype)
        return made
    return np.zeros(shape, dtype) if dtype.kind in "SV" else None


def _make(file: h5py.File, name: str, kind: Any, shape: tuple[int, ...], rng: Random) -> None:
    """Put a dataset in place of what has that name; a large one takes no room."""
    del file[name]
    few = int(np.prod([float(n) for n in shape])) < 1 << 16
    data = _values(kind, shape, rng) if few else None
    more: dict[str, Any] = {}
    if shape and all(shape):
        more["chunks"] = tuple(min(n, rng.choice((1, 4, 64))) for n in shape)
        more |= rng.choice(
            ({}, {"compression": "gzip"}, {"compression": "lzf"}, {"fletcher32": True}, {"shuffle": True})
        )
        if rng.random() < 0.2:
            more["maxshape"] = (None,) * len(shape)
    if few and rng.random() < 0.3:
        more = {}
    file.create_dataset(name, shape, kind, data, **more)


def _dtype(file: h5py.File, name: str, rng: Random) -> None:
    kind, old = rng.choice(_kinds()), file[name]
    values = old[()] if rng.random() < 0.5 and old.size < 1 << 16 and not (old.external or old.is_virtual) else None
    shape, attributes = old.shape, dict(old.attrs)
    if values is not None and np.dtype(kind).kind in "biuf" and np.asarray(values).dtype.kind in "biuf":
        del file[name]
        with np.errstate(all="ignore"):
            file[name] = np.asarray(values).astype(kind)
    else:
        _make(file, name, kind, shape, rng)
    for key, value in attributes.items():
        file[name].attrs[key] = value


def _shape(file: h5py.File, name: str, rng: Random) -> None:
    old = file[name]
    _make(file, name, old.dtype, _shapes(old.shape, rng), rng)


def _value(file: h5py.File, name: str, rng: Random) -> None:
    """Write extremes into some elements, or random bytes into all."""
    found = file[name]
    if found.external or found.is_virtual:  # written would be the other file
        return
    if found.dtype.kind not in "biuf" or not found.size:
        if h5py.check_string_dtype(found.dtype) and found.shape == ():
            _text(file, name, rng)
        return
    values = np.array(found[()])
    if rng.random() < 0.2:
        raw = bytearray(values.tobytes())
        for _ in range(rng.choice((1, 8, 64))):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
        values = np.frombuffer(bytes(raw), values.dtype).reshape(values.shape)
    else:
        with np.errstate(all="ignore"):
            for _ in range(rng.choice((1, 1, 3, 20))):
                values.flat[rng.randrange(values.size)] = np.float64(rng.choice(NUMBERS)).astype(values.dtype)
    found[...] = values


def _text(file: h5py.File, name: str, rng: Random) -> None:
    """Spoil a text: cut it, or put something else in place of a part of it."""
    old = file[name][()]
    old = old if isinstance(old, bytes) else str(old).encode()
    at = rng.randrange(len(old) + 1)
    word = rng.choice((*TEXTS, "null", "-1", "1e999", "true"))
    new = rng.choice(
        (old[:at], old[:at] + word.encode() + old[at + rng.choice((0, 1, 8)) :], word.encode(), b"\xff" + old)
    )
    del file[name]
    file.create_dataset(name, (), h5py.string_dtype(rng.choice(("utf-8", "ascii"))), new.replace(b"\0", b""))


def _content(file: h5py.File, name: str, rng: Random) -> None:
    """Spoil the bytes of a file that lies in a dataset."""
    found = file[name]
    if found.dtype != np.uint8 or found.ndim != 1 or not found.size or found.external or found.is_virtual:
        return
    content = mutate(found[()].tobytes(), "pickle", rng)
    del file[name]
    file[name] = np.frombuffer(content, np.uint8)


def _empty(file: h5py.File, name: str, rng: Random) -> None:
    kind = file[name].dtype
    del file[name]
    file[name] = h5py.Empty("<f4" if kind.kind == "O" else kind)


def _swap(file: h5py.File, name: str, rng: Random) -> None:
    """Exchange two objects."""
    other = rng.choice(_names(file))
    if other.startswith(name) or name.startswith(other):
        return
    file.move(name, "aside")
    file.move(other, name)
    file.move("aside", other)


def _drop(file: h5py.File, name: str, rng: Random) -> None:
    del file[name]


def _rename(file: h5py.File, name: str, rng: Random) -> None:
    file.move(name, rng.choice((name.upper() + "_", name + "2", "x" * 5000, "a/b/c", name + " ")))


def _group(file: h5py.File, name: str, rng: Random) -> None:
    del file[name]
    if rng.random() < 0.7:
        file.create_group(name)
    else:
        file[name] = np.dtype("<f4")  # a named type


def _link(file: h5py.File, name: str, rng: Random) -> None:
    """Put a link in place of an object: to itself, to nothing, to what contains it, to another file."""
    target = rng.choice(("/", "/" + name, "/nothing", "/" + rng.choice(_names(file)), "."))
    kind = rng.choice(("soft", "external", "external", "hard"))
    del file[name]
    if kind == "soft":
        file[name] = h5py.SoftLink(target)
    elif kind == "external":
        file[name] = h5py.ExternalLink(rng.choice(FOREIGN), target)
    else:
        file[name] = file["/"]


def _storage(file: h5py.File, name: str, rng: Random) -> None:
    """Let the samples of a dataset lie in another file."""
    kind, shape = file[name].dtype, file[name].shape
    if kind.kind not in "biuf" or not shape:
        return
    del file[name]
    place = rng.choice(FOREIGN)
    if rng.random() < 0.5:
        file.create_dataset(name, shape, kind, external=[(place, 0, h5py.h5f.UNLIMITED)])
        return
    layout = h5py.VirtualLayout(shape, kind)
    layout[...] = h5py.VirtualSource(rng.choice((".", place)), rng.choice((name, "x", "/")), shape)
    file.create_virtual_dataset(name, layout, fillvalue=rng.choice((None, 0, 1)))


def _attribute(file: h5py.File, name: str, rng: Random) -> None:
    """Drop, rename, or replace an attribute of the file or of an object."""
    holders = [one for one in (file, *(file[n] for n in _names(file))) if len(one.attrs)]
    if not holders:
        return
    attributes = rng.choice(holders).attrs
    key = rng.choice(sorted(attributes))
    old, deed = attributes[key], rng.choice(("drop", "rename", "kind", "kind", "value", "value", "empty"))
    del attributes[key]
    if deed == "rename":
        attributes[key + "_"] = old
    elif deed == "empty":
        attributes[key] = h5py.Empty("<f4")
    elif deed == "kind":
        made = _values(rng.choice(_kinds()[:12]), rng.choice(((), (1,), (2, 2), (0,), np.shape(old))), rng)
        attributes[key] = rng.choice((made, rng.choice(TEXTS), np.bytes_(b"\xff\xfe"))) if made is not None else "x"
    elif deed == "value":
        number = isinstance(old, np.generic | np.ndarray) and old.dtype.kind in "biuf"
        attributes[key] = _values(old.dtype, np.shape(old), rng) if number else rng.choice(TEXTS)


CHANGES: tuple[Change, ...] = (
    *((_dtype,) * 3),
    *((_shape,) * 3),
    *((_value,) * 4),
    *((_attribute,) * 4),
    *((_content,) * 4),
    *(_empty, _swap, _drop, _rename, _group, _link, _link, _storage, _storage),
)
DATASETS = (_dtype, _shape, _value, _content, _empty, _storage)
"""What only a dataset can be spoilt by."""


def _names(file: h5py.File) -> list[str]:
    """Return the paths of all that is in a file; what a link leads to has one path."""
    found: list[str] = []
    file.visit(found.append)
    return found


def restructure(data: bytes, rng: Random) -> bytes:
    """Return a whole HDF5 file, changed in one or several ways.

    Raises
    ------
    Exception
        Whatever h5py raises for a change that cannot be made.
    """
    held = io.BytesIO(data)
    with h5py.File(held, "r+") as file:
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            change = rng.choice(CHANGES)
            names = [n for n in _names(file) if change not in DATASETS or isinstance(file[n], h5py.Dataset)]
            if names:
                change(file, rng.choice(names), rng)
    return held.getvalue()
