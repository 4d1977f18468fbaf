"""The structure of the code: no import cycle, no private name across packages, functions of a reasonable size."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

from tests.architecture.sources import (
    FILES,
    MODULES,
    PACKAGES,
    ROOT,
    WINDOW,
    face_of,
    is_package,
    name_of,
    origin,
    text_of,
    tree_of,
)

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
    """Return (module, name) of every import anywhere in a file; the name is empty where a module is imported.

    A public name of a package stands for the module that it comes from.
    """
    found: set[tuple[str, str]] = set()
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                home = origin(node.module, alias.name)
                found.add((home, "") if home == f"{node.module}.{alias.name}" else (home, alias.name))
    return found


def ancestors(module: str) -> set[str]:
    parts = module.split(".")
    return {".".join(parts[:k]) for k in range(1, len(parts))} & MODULES.keys()


def runtime_imports(name: str) -> set[str]:
    """Return the modules that importing a module waits for: what it imports at its top level, and their packages.

    A public name of a package stands for the package and the module that it comes from; no face is run.
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
            found |= {node.module, *(origin(node.module, alias.name) for alias in node.names)}
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
        for other in graph.get(node, ()):
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
    graph = {
        name: {m for m, _ in imports(path) if m in MODULES} - {name}
        for name, path in MODULES.items()
        if not name.endswith(("._face", "._shared"))  # they are read, not run
    }
    assert circles(graph) == []


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": set()}) == []


def written(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of every import of ours in a file, as it is written; no name where a module is imported."""
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.split(".")[0] in PACKAGES)
        elif isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in PACKAGES:
            yield from ((str(node.module), alias.name) for alias in node.names)


def package_of(path: Path) -> str:
    """Return the package that a file is in."""
    return name_of(path) if path.name == "__init__.py" else name_of(path).rpartition(".")[0]


def sees(here: str, package: str) -> bool:
    """Return whether a file in package ``here`` may import modules of a package: its own, and those around it."""
    return f"{here}.".startswith(f"{package}.")


def past_the_face(path: Path) -> list[str]:
    """Return what a file takes from other packages but their public names; parts of packages by attribute, too."""
    found, here = [], package_of(path)
    for module, name in written(path):
        inner = f"{module}.{name}"
        if not name and module not in PACKAGES and not sees(here, module.rpartition(".")[0]):
            found.append(f"import {module}")
        elif not is_package(module):
            found += [] if not name or sees(here, module.rpartition(".")[0]) else [inner]
        elif inner in MODULES and name not in face_of(module) and not is_package(inner) and not sees(here, module):
            found.append(inner)
    return found + [part for part in attributes(path) if not sees(here, part.rpartition(".")[0])]


def attributes(path: Path) -> Iterator[str]:
    """Yield the modules that a file reaches as attributes of a package: ``p.store`` after ``import lfcal.psf as p``."""
    bound = {"lfcal": "lfcal"} if "import lfcal\n" in text_of(path) else {}
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            bound |= {alias.asname: alias.name for alias in node.names if alias.asname and is_package(alias.name)}
        elif isinstance(node, ast.ImportFrom):
            inner = {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            bound |= {name: whole for name, whole in inner.items() if is_package(whole)}
    if not bound:
        return
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute):
            whole = ast.unparse(node)
            first, _, rest = whole.partition(".")
            inner = f"{bound.get(first, '')}.{rest}"
            package, _, name = inner.rpartition(".")
            if inner in MODULES and not is_package(inner) and name not in face_of(package):
                yield inner


def test_other_packages_are_used_by_their_faces() -> None:
    assert not {str(path.relative_to(ROOT)): found for path in FILES if (found := past_the_face(path))}


def test_ways_past_a_face_are_found(tmp_path: Path) -> None:
    bad = WINDOW / "bad.py"
    lines = {
        "from lfcal.psf.store import save": ["lfcal.psf.store.save"],
        "from lfcal.psf import store": ["lfcal.psf.store"],
        "import lfcal.psf.store": ["import lfcal.psf.store"],
        "import lfcal\nlfcal.psf.store.save": ["lfcal.psf.store"],
        "from lfcal import psf\npsf.store.save": ["lfcal.psf.store"],
        "from lfcal.psf import save\nfrom lfcal.frames import formats\nimport lfcal\nlfcal.psf.save": [],
    }
    for code, found in lines.items():
        with spoken(bad, code):
            assert past_the_face(bad) == found, code


@contextmanager
def spoken(path: Path, text: str) -> Iterator[None]:
    """Let a file that is not there have this text."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.architecture.test_house.text_of", lambda _: text)
        patch.setattr("tests.architecture.test_house.tree_of", lambda _: ast.parse(text))
        yield


FOUND_BY_NAME = {
    "lfcal.__main__": "run by Python",
    "lfcal_gui.__main__": "run by Python",
    "lfcal.napari.reader": "named in the manifest of the plug-in",
}
"""Modules that give their package no public name, and who asks for them."""


def registered(module: str) -> bool:
    """Return whether a module is found by a registry, or is a command, which its package looks for."""
    package = module.rpartition(".")[0]
    names = REGISTRIES.get(package, ("register", "command", "show") if package == "lfcal.cli" else ())
    tops = {node.name for node in tree_of(MODULES[module]).body if isinstance(node, ast.FunctionDef)}
    for node in tree_of(MODULES[module]).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        tops |= {target.id for target in targets if isinstance(target, ast.Name)}
    return not tops.isdisjoint(names)


def _registries() -> dict[str, tuple[str, ...]]:
    """Return the packages whose modules a registry finds, and the name that it looks for in each."""
    found = {}
    for path in FILES:
        for node in ast.walk(tree_of(path)) if "Registry(" in text_of(path) else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "Registry":
                words = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
                if len(words) > 2:
                    found[words[1]] = (words[2],)
    return found


REGISTRIES = _registries()


def homes() -> set[str]:
    """Return the modules that public names of packages come from."""
    return {origin(package, name) for package in MODULES if is_package(package) for name in face_of(package)}


def closed() -> list[str]:
    """Return the public modules that no other package has a use for: they are private, or parts of another module."""
    used = homes()
    return [
        module
        for module in MODULES
        if not is_package(module)
        and not module.rpartition(".")[2].startswith("_")
        and module not in used
        and module not in FOUND_BY_NAME
        and not registered(module)
        # pages and scenes of the window are found by name
        and not module.startswith(("lfcal_gui.pages.", "lfcal_gui.scenes."))
        and not (module.count(".") == 1 and module.startswith("lfcal_gui."))
    ]


def test_modules_that_give_no_public_name_are_private() -> None:
    assert len(REGISTRIES) > 8 and closed() == []


def without_client() -> list[str]:
    """Return the names that packages give to other packages alone, and that none of these takes."""
    taken = {(module, name) for path in FILES for module, name in written(path) if not path.stem.startswith("_shared")}
    shared = (path for path in FILES if path.stem == "_shared")
    names = ((package_of(path), alias.name) for path in shared for alias in imported_names(path))
    return [f"{package}.{name}" for package, name in names if (package, name) not in taken]


def imported_names(path: Path) -> Iterator[ast.alias]:
    """Yield the names that a face imports."""
    for node in tree_of(path).body:
        if isinstance(node, ast.ImportFrom) and node.module != "__future__":
            yield from node.names


def test_names_for_other_packages_are_used_by_one() -> None:
    assert without_client() == []


def test_no_module_is_hidden_by_a_name_of_its_package() -> None:
    assert not [
        f"{package}.{name}"
        for package in MODULES
        if is_package(package)
        for name, (module, _) in face_of(package).items()
        if f"{package}.{name}" in MODULES and f"{package}.{name}" != module
    ]


def private(path: Path) -> list[str]:
    """Return the private modules and names of other packages that a file imports."""
    here = package_of(path)
    found = []
    for module, name in written(path):
        home, _, last = module.rpartition(".")
        if last.startswith("_") and not last.startswith("__") and not sees(here, home):
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


@cache
def functions() -> list[tuple[str, int, int]]:
    """Return name, lines without the docstring, and positional parameters (self left out) of every function."""
    found = []
    for path in FILES:
        for node in statements(tree_of(path)):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            first = node.body[0]
            if ast.get_docstring(node, clean=False) is not None:
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


def names_in(node: ast.AST) -> set[str]:
    """Return the names that a part of a file uses or sets."""
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def late_constants(path: Path) -> Iterator[str]:
    """Yield names that functions or classes use and that are set after them, though nothing defined here is in them."""
    used: set[str] = set()
    local: set[str] = set()
    waiting: list[ast.stmt] = []  # functions and classes whose names no constant has needed yet
    for node in tree_of(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            waiting.append(node)
            local.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found = {name for target in targets for name in names_in(target)}
            if names_in(node) & local:
                local |= found
            else:
                used.update(*map(names_in, waiting))
                waiting.clear()
                yield from sorted(found & used)


def test_constants_stand_before_the_functions_that_use_them() -> None:
    wrong = [f"{path.relative_to(ROOT)}: {name}" for path in FILES for name in late_constants(path)]
    assert not wrong


PAGES = "the page of its folder, which its specification finds by this name"
SAME_NAME = {"Page": PAGES}
"""Class names that stand in several files, and why."""


def test_no_public_class_name_stands_in_two_files() -> None:
    """A name that means two things has to be looked up at every place."""
    files: dict[str, list[str]] = {}
    for path in FILES:
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                files.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: where for name, where in files.items() if len(where) > 1 and name not in SAME_NAME} == {}
    assert all(len(files[name]) > 1 for name in SAME_NAME), "an exception that is needed no longer"


def test_tests_lie_in_folders_of_the_packages_that_they_test() -> None:
    pages = [folder for folder in (WINDOW / "pages").iterdir() if (folder / "__init__.py").is_file()]
    packages = [folder for folder in (ROOT / "lfcal").iterdir() if (folder / "__init__.py").is_file()]
    assert len(packages) > 15 and len(pages) > 8
    for folder in (*packages, *pages):
        place = folder.relative_to(ROOT / "lfcal") if folder in packages else Path("gui") / folder.relative_to(WINDOW)
        assert list((ROOT / "tests" / place).rglob("test_*.py")), place


def test_comments_begin_with_a_small_letter() -> None:
    """Names keep theirs; words that are none at the beginning of a comment show that it is written otherwise."""
    words = "A|An|All|As|At|Each|For|Here|If|In|It|No|Not|On|One|Only|The|There|This|What|When|Where|With|Without"
    # the first line of a comment, and none of a script that is written out
    start = re.compile(rf'^(?! *#|.*""")[^\n]*\n *# (?:{words}) [a-z]{{2,}}', re.MULTILINE)
    wrong = [f"{path.relative_to(ROOT)}: {found[0]}" for path in FILES for found in start.finditer(text_of(path))]
    assert not wrong


def stale_overviews() -> dict[str, list[str]]:
    """Return names of modules in the overviews of packages that there are not, by package."""
    found: dict[str, list[str]] = {}
    for path in FILES:
        if path.name != "__init__.py" or path.parent.name in ("lfcal", "lfcal_gui", "pages"):
            continue
        lines = re.findall(r"^- (.*?): ", ast.get_docstring(tree_of(path)) or "", re.MULTILINE)
        for name in (name for line in lines for name in re.findall(r"``(\w+)``", line)):
            if not (path.parent / f"{name}.py").exists() and not (path.parent / name).is_dir():
                found.setdefault(name_of(path), []).append(name)
    return found


def test_overviews_of_packages_name_modules_that_exist() -> None:
    assert stale_overviews() == {}


def headers_that_are_classes() -> list[str]:
    """Return column heads of the window that are spelt like its classes of several words."""
    classes = {n.name for path in FILES for n in statements(tree_of(path)) if isinstance(n, ast.ClassDef)}
    several = {name for name in classes if re.fullmatch(r"[A-Z][a-z]+([A-Z][a-z]+)+", name)}
    return [
        f"{name_of(path)}: {one.value}"
        for path in FILES
        for node in tree_of(path).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple) and name_of(path).startswith("lfcal_gui")
        for one in node.value.elts
        if isinstance(one, ast.Constant) and one.value in several
    ]


def test_heads_of_columns_are_words() -> None:
    assert headers_that_are_classes() == []
