"""Ways to spoil a file, each a function of its bytes and a seeded generator."""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

__all__ = ["FAMILIES", "Mutator", "mutate"]

Mutator = Callable[[bytes, Random], bytes]

EXTREMES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, (1 << 63) - 1, (1 << 64) - 1)
HEAD = 4096
"""Half of the damage goes here: what is written in the first bytes decides how the others are read."""


def _place(data: bytes, rng: Random) -> int:
    return rng.randrange(min(len(data), HEAD) if rng.random() < 0.5 else len(data))


def _flip(data: bytes, rng: Random) -> bytes:
    spoilt = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        spoilt[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(spoilt)


def _run(data: bytes, rng: Random) -> bytes:
    at, length = _place(data, rng), rng.choice((1, 2, 4, 8, 64, 512))
    fill = rng.choice((b"\0" * length, b"\xff" * length, rng.randbytes(length)))
    return data[:at] + fill + data[at + length :]


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.choice((0, 1, 8, _place(data, rng), len(data) - 1, len(data) // 2))]


def _insert(data: bytes, rng: Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.randbytes(rng.choice((1, 4, 64, 1000))) + data[at:]


def _repeat(data: bytes, rng: Random) -> bytes:
    at, length = _place(data, rng), rng.choice((4, 64, 1024))
    return data[: at + length] + data[at:]


def _swap(data: bytes, rng: Random) -> bytes:
    size = rng.choice((8, 64, 512))
    a, b = sorted((_place(data, rng), _place(data, rng)))
    if b - a < size:
        return _flip(data, rng)
    return data[:a] + data[b : b + size] + data[a + size : b] + data[a : a + size] + data[b + size :]


def _extreme(data: bytes, rng: Random) -> bytes:
    form = rng.choice(("<H", "<I", "<Q", ">H", ">I", "B"))
    size = struct.calcsize(form)
    at = _place(data, rng)
    at -= at % rng.choice((1, size))
    value = rng.choice(EXTREMES) & ((1 << 8 * size) - 1)
    return data[:at] + struct.pack(form, value) + data[at + size :]


BYTES: tuple[Mutator, ...] = (_flip, _flip, _run, _run, _cut, _insert, _repeat, _swap, _extreme, _extreme)


# -- text of any kind ----------------------------------------------------------------------------------
WORDS = ("", "NaN", "inf", "-1", "0", "1e999", "9" * 30, "9" * 5000, "1.5", "ä\u202e\u0007", "\x00", "../../x", "null")
"""What may stand where a number or a name is expected."""


def _word(data: bytes, rng: Random) -> bytes:
    """Replace a number or a word."""
    found = list(re.finditer(rb"[\w.+-]+", data))
    if not found:
        return data
    part = rng.choice(found)
    return data[: part.start()] + rng.choice(WORDS).encode() + data[part.end() :]


def _line(data: bytes, rng: Random) -> bytes:
    """Drop, double or move a line."""
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    changed = rng.choice(([], [lines[k], lines[k]], [lines[k][::-1]], [b""], [lines[k] + b"," + lines[k]]))
    return b"\n".join([*lines[:k], *changed, *lines[k + 1 :]])


def _other_encoding(data: bytes, rng: Random) -> bytes:
    text = data.decode("utf-8", "replace")
    return rng.choice((text.encode("utf-16"), b"\xef\xbb\xbf" + data, b"\xff\xfe" + data, text.encode("utf-32")))


TEXT: tuple[Mutator, ...] = (_word, _word, _word, _line, _line, _other_encoding)


# -- JSON ----------------------------------------------------------------------------------------------
RAW = (
    *("NaN", "Infinity", "-Infinity", "1e999", "-1", "0", "1.5", "true", "null", "[]", "{}", '""', '"x"', "1e308"),
    *("9" * 25, "9" * 5000, '"\\u0000"', '"\\ud800"', '"' + "long " * 20000 + '"', '"a\\nb"', "[1, [2]]", '{"a": 1}'),
    *("[" * 100_000 + "]" * 100_000, "[" * 50_000, '{"a":' * 60_000 + "1" + "}" * 60_000, "[null, null, null]"),
    "[" + "1," * 20000 + "1]",
)
"""JSON text put in place of a value: every type, extremes of every size, and nesting that ends recursive readers."""

MARK = "@@here@@"


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) below ``value``."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found: list[tuple[Any, Any]] = []
    for key, part in inner:
        found += [(value, key), *_places(part)]
    return found


def _json_value(data: bytes, rng: Random) -> bytes:
    """Replace any value of the document."""
    body = json.loads(data)
    places = _places(body)
    if not places:
        return rng.choice(RAW).encode()
    container, key = rng.choice(places)
    container[key] = MARK
    return json.dumps(body, indent=1).replace(f'"{MARK}"', rng.choice(RAW)).encode()


def _json_key(data: bytes, rng: Random) -> bytes:
    """Delete, rename, add or double an entry."""
    body = json.loads(data)
    places = [(c, k) for c, k in _places(body) if isinstance(c, dict)]
    if not places:
        return _json_value(data, rng)
    container, key = rng.choice(places)
    value = container.pop(key)
    deed = rng.choice(("delete", "delete", "rename", "add", "double"))
    if deed == "delete":
        return json.dumps(body, indent=1).encode()
    if deed == "double":
        container[MARK] = value
        doubled = f"{json.dumps(key)}: {rng.choice(RAW)}, {json.dumps(key)}"
        return json.dumps(body, indent=1).replace(f'"{MARK}"', doubled).encode()
    container.update(
        {rng.choice(("z\n", "", key.upper(), "x" * 5000)): value} | ({key: value} if deed == "add" else {})
    )
    return json.dumps(body, indent=1).encode()


def _json_whole(data: bytes, rng: Random) -> bytes:
    return rng.choice((*RAW, "", " ", "\x00", "{", data.decode() + "x", f"[{data.decode()}]")).encode()


JSON: tuple[Mutator, ...] = (*((_json_value,) * 8), *((_json_key,) * 6), _json_whole, _word, _line, _other_encoding)


def _json_line(data: bytes, rng: Random) -> bytes:
    """Spoil one line of a journal."""
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    lines[k] = rng.choice(JSON)(lines[k], rng).replace(b"\n", b" ")
    return b"\n".join(lines)


# -- YAML ----------------------------------------------------------------------------------------------
YAML_VALUES = (
    *(
        ".nan",
        ".inf",
        "*a",
        "&a [*a]",
        "!!python/name:os.system",
        "!!bool abc",
        "!!set {a}",
        "!!binary AAAA",
        "2024-01-02",
    ),
    *("[" * 3000, "{a: " * 3000, "0x7f", "1_000", "1e400", "190:20:30", "!!float x", "!!timestamp x", "? {a: b}\n: 1"),
    *(
        "<<: *a",
        "|\n  long",
        "~",
        "[1, [2]]",
        "{a: 1}",
        "'",
        '"\\ud800"',
        "\t",
        "%YAML 9",
        "---\n---",
        "[" + "1," * 20000 + "1]",
    ),
)


def _yaml_value(data: bytes, rng: Random) -> bytes:
    """Replace, delete, double or add an entry."""
    lines = data.decode("utf-8", "replace").splitlines()
    k = rng.randrange(len(lines))
    name = lines[k].partition(":")[0]
    value = rng.choice((*YAML_VALUES, *RAW))
    changed = rng.choice(([], [f"{name}: {value}"] * 2, *([[f"{name}: {value}"]] * 8)))
    return "\n".join([*rng.choice(([], ["b: &a [1, 2]"])), *lines[:k], *changed, *lines[k + 1 :]]).encode()


# -- pickles -------------------------------------------------------------------------------------------
OPCODES = (
    *(b"N", b"\x88", b"K\x05", b"J\xff\xff\xff\xff", b"G\x7f\xf8" + bytes(6), b")", b"]", b"}", b"(", b"0", b"1", b"2"),
    *(
        b"t",
        b"\x85",
        b"\x86",
        b"\x87",
        b"e",
        b"a",
        b"u",
        b"s",
        b"R",
        b"b",
        b"\x81",
        b"o",
        b"\x92",
        b"Q",
        b"\x94",
        b"\x93",
    ),
    *(
        b"cos\nsystem\n",
        b"cbuiltins\neval\n",
        b"cnumpy\nload\n",
        b"clfcal.work\nUnit\n",
        b"h\x00",
        b"h\x05",
        b"\x8c\x01x",
    ),
    *(
        b"r\xff\xff\xff\x0f",
        b"j\xff\xff\xff\x0f",
        b"\x8a\x09" + b"\xff" * 8 + b"\x7f",
        b"\x95" + b"\xff" * 8,
        b"P0\n",
        b".",
    ),
    *(
        b"L" + b"9" * 5000 + b"L\n",
        b"B\xff\xff\xff\x7f",
        b"\x8e" + b"\xff" * 8,
        b"\x8d" + b"\xff" * 7 + b"\x7f",
        b"2" * 300,
    ),
)


def _opcode(data: bytes, rng: Random) -> bytes:
    """Put some steps between others, or in their place."""
    at = _place(data, rng)
    steps = b"".join(rng.choice(OPCODES) for _ in range(rng.choice((1, 1, 2, 5))))
    return data[:at] + steps + data[at + rng.choice((0, 0, 1, len(steps))) :]


# -- XML -----------------------------------------------------------------------------------------------
def _xml_element(data: bytes, rng: Random) -> bytes:
    """Drop, double, nest or rename an element."""
    found = list(re.finditer(rb"<(\w+)[^>]*>[^<]*</\1>", data))
    part = rng.choice(found)
    whole = part.group()
    deep = b"<a>" * 20_000 + b"</a>" * 20_000
    changed = rng.choice(
        (b"", whole * 2, deep, whole.replace(b"<", b"<q", 1), whole * 5000, b"<!-- -->", b"<![CDATA[x]]>")
    )
    return data[: part.start()] + changed + data[part.end() :]


def _xml_entities(data: bytes, rng: Random) -> bytes:
    bomb = b'<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'
    outside = b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]>'
    at = data.find(b"?>") + 2
    return data[:at] + rng.choice((bomb, outside, b"<?xml-stylesheet href='x'?>", b"&b;")) + data[at:]


XML: tuple[Mutator, ...] = (*((_xml_element,) * 4), _xml_entities, *TEXT)


# -- images and arrays whose headers are text or tags ----------------------------------------------------
HEADERS = (
    *("(-1, 4)", "(1099511627776, 1099511627776)", "(0, 0)", "()", "(2.5, 3)", "('a',)", "((", "None", "(1,) * 9"),
    *("'<c16'", "'O'", "'<U5'", "'V9'", "'|b1'", "'<f2'", "[('a', '<f4')]", "'<M8[s]'", "'", '"""', "\\", "\x00", "0x"),
)


def _npy_header(data: bytes, rng: Random) -> bytes:
    """Put something else in place of the shape, the type or the order, the length kept."""
    length = struct.unpack_from("<H", data, 8)[0]
    header = data[10 : 10 + length].decode("latin-1").rstrip()
    part = rng.choice(("shape", "descr", "fortran_order", "{", "}", ","))
    parts = {"shape": r"\([^)]*\)", "descr": r"'[<|>][^']*'", "fortran_order": "False"}
    pattern = parts.get(part, re.escape(part))
    spoilt = re.sub(pattern, lambda _: rng.choice(HEADERS), header, count=1)
    raw = spoilt.ljust(length - 1).encode("latin-1") + b"\n"
    return data[:8] + struct.pack("<H", len(raw)) + raw + data[10 + length :]


def _tiff_tag(data: bytes, rng: Random) -> bytes:
    """Overwrite type, count or value of a tag of a page."""
    order, big = ("<" if data[:2] == b"II" else ">"), data[2:4] in (b"+\0", b"\0+")
    offset, count, size = ("Q", "Q", 20) if big else ("I", "H", 12)
    where = struct.unpack_from(order + offset, data, 8 if big else 4)[0]
    for _ in range(rng.choice((0, 0, 1, 5))):  # the page
        tags = struct.unpack_from(order + count, data, where)[0]
        where = struct.unpack_from(order + offset, data, where + struct.calcsize(count) + size * tags)[0] or where
    tags = struct.unpack_from(order + count, data, where)[0]
    at = where + struct.calcsize(count) + size * rng.randrange(tags)
    form, skip = rng.choice((("H", 0), ("H", 2), (offset, 4), (offset, 4 + struct.calcsize(offset)), ("H", size - 4)))
    value = rng.choice((*EXTREMES, rng.randrange(1 << 16))) & ((1 << 8 * struct.calcsize(form)) - 1)
    spoilt = bytearray(data)
    struct.pack_into(order + form, spoilt, at + skip, value)
    return bytes(spoilt)


def _png_chunk(data: bytes, rng: Random) -> bytes:
    """Change a chunk and give it a right checksum; drop it, double it, or rename it."""
    parts, at = [], 8
    while at + 12 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        parts.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    k = rng.randrange(len(parts))
    name, body = parts[k]
    spoilt = rng.choice((_flip, _run, _cut, _extreme))(body, rng) if body else rng.randbytes(9)
    others = ([], [parts[k]] * 2, [(name, spoilt)], [(name, spoilt)], [(rng.choice((b"PLTE", b"IDAT", b"tRNS")), body)])
    parts[k : k + 1] = rng.choice(others)
    chunks = (struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(n + b)) for n, b in parts)
    return data[:8] + b"".join(chunks)


def _pgm_header(data: bytes, rng: Random) -> bytes:
    return _word(data[:20], rng) + data[20:]


FAMILIES: dict[str, tuple[Mutator, ...]] = {
    "bytes": BYTES,
    "npy": (*((_npy_header,) * 6), *BYTES),
    "tiff": (*((_tiff_tag,) * 8), *BYTES),
    "png": (*((_png_chunk,) * 8), *BYTES),
    "pgm": (*((_pgm_header,) * 8), *BYTES),
    "json": (*JSON, *JSON, *BYTES),
    "csv": (*TEXT, *TEXT, *BYTES),
    "xml": (*XML, *BYTES),
    "lines": (*((_json_line,) * 16), *TEXT, *BYTES),
    "yaml": (*((_yaml_value,) * 12), *TEXT, *BYTES),
    "pickle": (*((_opcode,) * 8), *BYTES),
    "h5": BYTES,
}
"""Mutators of a kind of file; one named several times is taken as often."""


def mutate(data: bytes, family: str, rng: Random) -> bytes:
    """Return ``data`` spoilt in one or (rarely) several ways."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        try:
            data = rng.choice(FAMILIES[family])(data, rng)
        except (ValueError, struct.error, IndexError, RecursionError):  # an earlier mutation left nothing to parse
            data = rng.choice(BYTES)(data, rng) if data else data
    return data
