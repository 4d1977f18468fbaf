"""Reference pages of all public names, from the docstrings: one page per package, one section per module."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

__all__ = ["Module", "Package", "packages", "page_of"]


@dataclass(frozen=True)
class Module:
    """A module with its public names, in the order of the source."""

    name: str
    summary: str
    public: tuple[str, ...]


@dataclass(frozen=True)
class Package:
    """A package with its modules; ``exported`` are the names of its face."""

    name: str
    summary: str
    modules: tuple[Module, ...]
    exported: tuple[str, ...]

    @property
    def page(self) -> str:
        """Path of its page in the site."""
        return f"reference/{self.name}.md"


def packages(root: Path, name: str = "lfcal") -> tuple[Package, ...]:
    """Return ``name`` and all packages in it that have public names; ``root`` is the folder that contains ``name``."""
    folders = [path.parent for path in sorted((root / name).rglob("__init__.py"))]
    found = (_package(folder, root) for folder in folders if not _private(folder, root))
    return tuple(one for one in found if one.modules or one.exported)


def _private(path: Path, root: Path) -> bool:
    return any(part.startswith("_") and part != "__init__.py" for part in path.relative_to(root).parts)


def _package(folder: Path, root: Path) -> Package:
    name = ".".join(folder.relative_to(root).parts)
    summary = _first_line(_tree(folder / "__init__.py"))
    given = _given(name, root)
    places: dict[str, list[str]] = {}
    for public in given:
        if not _is_elsewhere(name, public, root):
            module, there = _home(name, public, root)
            places.setdefault(module, []).append(there)
    modules = (_module(module, names, root) for module, names in sorted(places.items()))
    return Package(name, summary, tuple(one for one in modules if one.public), tuple(given))


def _module(name: str, given: list[str], root: Path) -> Module:
    tree = _tree(_file(name, root))
    return Module(name, _first_line(tree), tuple(one for one in _defined(tree) if one in given))


def _given(package: str, root: Path, face: str = "_face") -> dict[str, tuple[str, str]]:
    """Return the public names of a package, each with its module and its name there, as its face imports it."""
    path = root.joinpath(*package.split("."), f"{face}.py")
    return {
        alias.asname or alias.name: (str(node.module), alias.name)
        for node in (_tree(path).body if path.is_file() else ())
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    }


def _is_elsewhere(package: str, name: str, root: Path) -> bool:
    """Return whether another package on the way to the defining module also makes a name public."""
    passed = package
    package, name = _given(package, root)[name]
    while True:
        public, shared = _given(package, root), _given(package, root, "_shared")
        if name in public and package != passed:
            return True
        if name not in public | shared:
            owner = package.rpartition(".")[0]
            return owner != passed and name in _given(owner, root)
        package, name = (public | shared)[name]


def _home(package: str, name: str, root: Path) -> tuple[str, str]:
    """Return the module that defines a name of a package, and its name there."""
    while name in (given := _given(package, root) | _given(package, root, "_shared")):
        package, name = given[name]
    return package, name


def _file(module: str, root: Path) -> Path:
    path = root.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _first_line(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").split("\n")[0]


def _defined(tree: ast.Module) -> list[str]:
    """Return the public classes, functions (also derived ones) and documented values that a module defines."""
    found = []
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            found.append(node.name)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)) and (_is_text(after) or _is_drained(node.value)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [t.id for t in targets if isinstance(t, ast.Name) and not t.id.startswith("_")]
    return list(dict.fromkeys(found))


def _is_drained(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "drained"


def _is_text(node: ast.stmt | None) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def page_of(package: Package) -> str:
    """Return the page of a package, in Markdown with the blocks of mkdocstrings."""
    out = [
        f"# {package.name}\n",
        f"::: {package.name}\n    options:\n      members: false\n      show_root_heading: false\n",
    ]
    if package.exported:
        names = ", ".join(f"`{name}`" for name in sorted(package.exported))
        out.append(f"`from {package.name} import …`: {names}.\n")
    for module in package.modules:
        listed = ", ".join(f'"{name}"' for name in module.public)
        out.append(f"::: {module.name}\n    options:\n      members: [{listed}]\n")
    return "\n".join(out)
