"""The structure of the code: no import cycle, no private name across packages, functions of a reasonable size."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.architecture.sources import FILES, MODULES, PACKAGES, ROOT, WINDOW, name_of, text_of, tree_of

LONG_BODY = 40
MOST_POSITIONAL = 6


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """Yield all statements; expressions, which most of a tree consists of, are not looked into."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.stmt):
            yield node
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, None)
            waiting += inner if isinstance(inner, list) else []


@cache
def imports(path: Path) -> set[tuple[str, str]]:
    """Return (module, name) of every import anywhere in a file; the name is empty where a module is imported."""
    found: set[tuple[str, str]] = set()
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add((whole, "") if whole in MODULES else (node.module, alias.name))
    return found


def ancestors(module: str) -> set[str]:
    parts = module.split(".")
    return {".".join(parts[:k]) for k in range(1, len(parts))} & MODULES.keys()


def runtime_imports(name: str) -> set[str]:
    """Return the modules that importing a module waits for: what it imports at its top level, and their packages.

    A public name of a package with a lazy face stands for the package's module ``_face``.
    """
    found = ancestors(name)
    waiting: list[ast.stmt] = list(tree_of(MODULES[name]).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            face = f"{node.module}._face"
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            found |= {face for alias in node.names if not alias.name.startswith("_")}
        parts = ("orelse",) if is_for_types_only(node) else ("body", "orelse", "finalbody", "handlers")
        for part in parts:
            waiting += getattr(node, part, [])
    known = found & MODULES.keys()
    return known.union(*map(ancestors, known)) - {name}


def is_for_types_only(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected parts of more than one node (Tarjan's algorithm)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        for other in graph[node]:
            if other not in number:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], number[other])
        if low[node] == number[node]:
            part = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(part) > 1:
                found.append(sorted(part))

    for node in graph:
        if node not in number:
            visit(node)
    return found


def test_no_circle_of_files() -> None:
    """Also not through functions or type checking: a reader must be able to begin somewhere."""
    graph = {name: {m for m, _ in imports(path) if m in MODULES} - {name} for name, path in MODULES.items()}
    assert circles(graph) == []


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": set()}) == []


def private(path: Path) -> list[str]:
    """Return the private modules and names of other packages that a file imports."""
    here = name_of(path) if path.name == "__init__.py" else name_of(path).rpartition(".")[0]
    found = []
    for module, name in imports(path):
        if module.split(".")[0] not in PACKAGES:
            continue
        home, _, last = module.rpartition(".")
        inside = f"{here}.".startswith(f"{home}.")
        if last.startswith("_") and not last.startswith("__") and not inside:
            found.append(module)
        if name.startswith("_") and not name.startswith("__") and here not in (home, module):
            found.append(f"{module}.{name}")
    return found


def test_no_private_name_crosses_a_package() -> None:
    assert not {str(path.relative_to(ROOT)): found for path in FILES if (found := private(path))}


def test_no_qt_where_the_window_keeps_its_models() -> None:
    for path in (p for p in FILES if p.is_relative_to(WINDOW)):
        if "models" in path.parts or path.stem.startswith("model"):
            assert not {m for m, _ in imports(path) if m.split(".")[0] in ("PySide6", "pyqtgraph")}, path


def left_out_of_bundles() -> set[str]:
    """Return the parts of other packages that the folder for machines without Python lacks."""
    (found,) = (
        node.value
        for node in ast.parse((ROOT / "packaging" / "lfcal.spec").read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "LEFT_OUT"
    )
    # whole packages are those of extras, which are asked for before they are used
    return {name for name in ast.literal_eval(found) if "." in name}


def test_nothing_is_needed_that_bundles_lack() -> None:
    lacked = left_out_of_bundles()
    assert {"scipy.signal", "scipy.stats"} <= lacked
    for path in FILES:
        asked = {module for module, _ in imports(path)} | {f"{module}.{name}" for module, name in imports(path)}
        assert not {m for m in asked if any(f"{m}.".startswith(f"{one}.") for one in lacked)}, path


def functions() -> list[tuple[str, int, int]]:
    """Return name, lines without the docstring, and positional parameters (self left out) of every function."""
    found = []
    for path in FILES:
        for node in statements(tree_of(path)):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            first = node.body[0]
            if ast.get_docstring(node) is not None:
                lines -= (first.end_lineno or first.lineno) - first.lineno + 1
            given = [*node.args.posonlyargs, *node.args.args]
            # numba passes the typing context and all arguments of an intrinsic by position
            given = [] if given and given[0].arg == "_" else given
            bound = bool(given) and given[0].arg in ("self", "cls")
            found.append((f"{path.relative_to(ROOT)}:{node.name}", lines, len(given) - bound))
    return found


def test_functions_have_a_reasonable_size() -> None:
    found = functions()
    long = [name for name, lines, _ in found if lines > LONG_BODY]
    assert len(long) <= 0.01 * len(found), long


def test_no_function_has_many_positional_parameters() -> None:
    """The reader of a call would have to count them."""
    assert not [name for name, _, given in functions() if given > MOST_POSITIONAL]


def test_the_formatter_is_never_told_to_look_away() -> None:
    for path in FILES:
        assert "# fmt:" not in text_of(path), path


def late_constants(path: Path) -> Iterator[str]:
    """Yield names that functions or classes use and that are set after them, though nothing defined here is in them."""
    used: set[str] = set()
    local: set[str] = set()
    for node in tree_of(path).body:
        names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            used |= names
            local.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found = {part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)}
            if names & local:
                local |= found
            else:
                yield from sorted(found & used)


def test_constants_stand_before_the_functions_that_use_them() -> None:
    wrong = [f"{path.relative_to(ROOT)}: {name}" for path in FILES for name in late_constants(path)]
    assert not wrong


PAGES = "the page of its folder, which its specification finds by this name"
SAME_NAME = {"Page": PAGES}
"""Class names that stand in several files, and why."""


def test_no_public_class_name_stands_in_two_files() -> None:
    """A name that means two things has to be looked up at every place. Benchmarks are no part of the product."""
    files: dict[str, list[str]] = {}
    for path in FILES:
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and "bench" not in path.parts:
                files.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: where for name, where in files.items() if len(where) > 1 and name not in SAME_NAME} == {}
    assert all(len(files[name]) > 1 for name in SAME_NAME), "an exception that is needed no longer"


def test_tests_lie_in_folders_of_the_packages_that_they_test() -> None:
    pages = [folder for folder in (ROOT / "gui" / "pages").iterdir() if (folder / "__init__.py").is_file()]
    packages = [folder for folder in (ROOT / "lfcal").iterdir() if (folder / "__init__.py").is_file()]
    assert len(packages) > 15 and len(pages) > 8
    for folder in (*packages, *pages):
        place = folder.relative_to(ROOT / "lfcal" if folder in packages else ROOT)
        assert list((ROOT / "tests" / place).rglob("test_*.py")), place


def test_comments_begin_with_a_small_letter() -> None:
    """Names keep theirs; words that are none at the beginning of a comment show that it is written otherwise."""
    words = "A|An|All|As|At|Each|For|Here|If|In|It|No|Not|On|One|Only|The|There|This|What|When|Where|With|Without"
    # the first line of a comment, and none of a script that is written out
    start = re.compile(rf'^(?! *#|.*""")[^\n]*\n *# (?:{words}) [a-z]{{2,}}', re.MULTILINE)
    wrong = [f"{path.relative_to(ROOT)}: {found[0]}" for path in FILES for found in start.finditer(text_of(path))]
    assert not wrong
