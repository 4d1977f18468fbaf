"""Compiled kernels: few arguments, a docstring, and nothing in them that numba's cache on disk cannot see.

A compiled kernel is loaded from the cache as long as its own file is unchanged. What it took from another file - the
order of a record's fields, another kernel, a constant - is compiled into it and stays as it was.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.architecture.sources import FILES, PACKAGES, ROOT, text_of, tree_of

MOST = 6
EXCEPTIONS: dict[str, str] = {}
"""Kernels that take more arguments, and why; two at most."""


def is_kernel(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef):
        return False
    makers = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    return any(isinstance(maker, ast.Name) and maker.id == "njit" for maker in makers)


def kernels(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and is_kernel(node))


def records(tree: ast.Module) -> Iterator[ast.ClassDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and any(isinstance(b, ast.Name) and b.id == "NamedTuple" for b in node.bases):
            yield node


def names_in(node: ast.AST) -> set[str]:
    """Return all names a function or class uses, those in its annotations and in annotations in quotes included."""
    found = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    notes = [n.annotation for n in ast.walk(node) if isinstance(n, ast.arg | ast.AnnAssign) and n.annotation]
    for note in notes:
        if isinstance(note, ast.Constant) and isinstance(note.value, str):
            found |= names_in(ast.parse(note.value))
    return found


def borrowed(tree: ast.Module) -> set[str]:
    """Return names that a file takes from other files of the project."""
    return {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in PACKAGES
        for alias in node.names
    }


def unseen(tree: ast.Module) -> dict[str, set[str]]:
    """Return what kernels and their records take from other files, by the kernel's or record's name."""
    foreign = borrowed(tree) - {"njit"}
    parts = [*kernels(tree), *records(tree)]
    return {part.name: names_in(part) & foreign for part in parts if names_in(part) & foreign}


def too_many(tree: ast.Module) -> list[str]:
    return [k.name for k in kernels(tree) if len(k.args.posonlyargs) + len(k.args.args) > MOST]


@cache
def trees() -> dict[str, ast.Module]:
    """Return the files that hold kernels, by their names."""
    parsed = {str(path.relative_to(ROOT)): tree_of(path) for path in FILES if "njit" in text_of(path)}
    return {name: tree for name, tree in parsed.items() if any(kernels(tree))}


def test_kernels_take_few_arguments() -> None:
    many = {name: set(too_many(tree)) - set(EXCEPTIONS) for name, tree in trees().items()}
    assert not {name: found for name, found in many.items() if found}, "group scalars and arrays into a record"


def test_kernels_use_what_stands_in_their_file() -> None:
    taken = {name: unseen(tree) for name, tree in trees().items()}
    assert not {name: found for name, found in taken.items() if found}, (
        "a record, kernel or constant that a kernel uses stands in the kernel's own file"
    )


def test_kernels_say_what_they_do() -> None:
    assert not [(name, k.name) for name, tree in trees().items() for k in kernels(tree) if not ast.get_docstring(k)]


def test_all_kernels_were_found() -> None:
    found = [kernel.name for tree in trees().values() for kernel in kernels(tree)]
    assert len(found) > 50
    assert {"respond", "select", "draw_spots", "arcs_radius", "transpose_batches"} <= set(found)
    assert len(EXCEPTIONS) <= 2


@pytest.mark.parametrize(
    ("source", "what"),
    [
        ("@njit()\ndef f(r: Record): return r.a", {"f": {"Record"}}),
        ("@njit()\ndef f(r: 'Record'): return r.a", {"f": {"Record"}}),
        ("@njit(fastmath=True)\ndef f(r): return Record(r, r)", {"f": {"Record"}}),
        ("@njit()\ndef f(r): return other(r)", {"f": {"other"}}),
        ("class Own(NamedTuple):\n    inner: Record", {"Own": {"Record"}}),
        ("class Own(NamedTuple):\n    a: int\n@njit()\ndef f(r: Own): return r.a", {}),
        ("def f(r): return other(Record(r, r))", {}),
    ],
)
def test_what_the_cache_does_not_see_is_found(source: str, what: dict[str, set[str]]) -> None:
    assert unseen(ast.parse("from lfcal.x import Record, other\n" + source)) == what


def test_many_arguments_are_found() -> None:
    assert too_many(ast.parse("@njit()\ndef f(a, b, c, d, e, g): pass")) == []
    assert too_many(ast.parse("@njit()\ndef f(a, b, c, d, e, g, h): pass")) == ["f"]


RECORD = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    over: float\n    under: float\n"
KERNEL = "from lfcal.base.compiled import njit\n\n@njit()\ndef ratio(p):\n    return p.over / p.under\n"


def run(folder: Path, code: str) -> str:
    """Return what ``code`` prints with ``folder`` first on the path, in a process of its own; the cache stays there.

    Python's own cache (-B) takes a file that changed within a second, and not in size, for the one it was.
    """
    paths = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT)!r}]; "
    done = subprocess.run(
        [sys.executable, "-B", "-c", paths + code], capture_output=True, text=True, check=True, cwd=folder
    )
    assert list(folder.rglob("*.nbi")), "nothing was cached"
    return done.stdout.strip()


def swap(path: Path, one: str, other: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(one) == text.count(other) == 1
    path.write_text(text.replace(one, "<>").replace(other, one).replace("<>", other), encoding="utf-8")


@pytest.mark.long
def test_a_warm_cache_sees_a_record_in_the_file_of_its_kernel_only(tmp_path: Path) -> None:
    """The second half is why: should it fail one day, numba has learnt to look and the rule may go."""
    (tmp_path / "together.py").write_text(RECORD + KERNEL)
    (tmp_path / "record.py").write_text(RECORD)
    (tmp_path / "apart.py").write_text("from record import Pair\n" + KERNEL)
    found = []
    for _ in range(2):
        values = [run(tmp_path, f"from {m} import *; print(ratio(Pair(6.0, 2.0)))") for m in ("together", "apart")]
        found.append([float(v) for v in values])
        for name in ("together", "record"):
            swap(tmp_path / f"{name}.py", "    over: float\n", "    under: float\n")
    before, after = found
    assert before == [3.0, 3.0]
    assert after[0] == pytest.approx(1 / 3), "the kernel was compiled anew"
    assert after[1] == 3.0, "stale: by the order of fields that no longer is"


WINDOWS = (
    "import numpy as np; from lfcal.reconstruct.projectors._kernels import Tiling, overlap_add; "
    "image = np.zeros((12, 12)); overlap_add(np.ones((4, 2, 2)), image, Tiling(0, 2, 5, 7), 0); "
    "print(np.argwhere(image).tolist())"
)
REGION = (
    "import numpy as np; from lfcal.frames.corrections._kernels import CorrectionTerms, correct_rows; "
    "none, out = np.zeros((0, 0), np.float32), np.zeros((3, 4), np.float32); "
    "terms = CorrectionTerms(none, none, np.float32(1), np.float32(2), 0.5, 10.0, 0.25); "
    "correct_rows(np.full((3, 4), 9, np.uint16), terms, (0, 0), 0, 3, out); print(out.tolist())"
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "fields", "code"),
    [
        ("reconstruct/projectors/_kernels.py", ("    period_y: int", "    period_x: int"), WINDOWS),
        ("frames/corrections/_kernels.py", ("    per_row: float", "    per_column: float"), REGION),
    ],
)
def test_swapped_fields_of_a_record_reach_the_compiled_kernel(
    tmp_path: Path, file: str, fields: tuple[str, str], code: str
) -> None:
    shutil.copytree(ROOT / "lfcal", tmp_path / "lfcal", ignore=shutil.ignore_patterns("__pycache__"))
    first = run(tmp_path, code)
    assert run(tmp_path, code) == first
    swap(tmp_path / "lfcal" / file, *fields)
    assert run(tmp_path, code) != first
