"""Pages of every public name of the library, from the docstrings: one page a package, one section a module."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Module", "Package", "packages", "page_of"]


@dataclass(frozen=True)
class Module:
    """A module with its public names, in the order in which it gives them."""

    name: str
    summary: str
    public: tuple[str, ...]


@dataclass(frozen=True)
class Package:
    """A package with its modules; ``exported`` are the names that it gives itself."""

    name: str
    summary: str
    modules: tuple[Module, ...]
    exported: tuple[str, ...]

    @property
    def page(self) -> str:
        """Where its page lies in the site."""
        return f"reference/{self.name}.md"


def packages(root: Path, name: str = "lfcal") -> tuple[Package, ...]:
    """Return ``name`` and all packages in it that have anything public; ``root`` is the folder of ``name``."""
    folders = [path.parent for path in sorted((root / name).rglob("__init__.py"))]
    found = (_package(folder, root) for folder in folders if not _private(folder, root))
    return tuple(one for one in found if one.modules or one.exported)


def _private(path: Path, root: Path) -> bool:
    return any(part.startswith("_") and part != "__init__.py" for part in path.relative_to(root).parts)


def _package(folder: Path, root: Path) -> Package:
    name = ".".join(folder.relative_to(root).parts)
    tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
    modules = (_module(path, root) for path in sorted(folder.glob("*.py")) if not path.name.startswith("_"))
    face = folder / "_face.py"
    names = _exported(ast.parse(face.read_text(encoding="utf-8")) if face.is_file() else tree)
    return Package(name, _first_line(tree), tuple(one for one in modules if one.public), tuple(names or ()))


def _module(path: Path, root: Path) -> Module:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    name = ".".join(path.relative_to(root).with_suffix("").parts)
    own = _defined(tree)
    exported = _exported(tree)
    public = own if exported is None else [one for one in own if one in exported]
    return Module(name, _first_line(tree), tuple(public))


def _first_line(tree: ast.Module) -> str:
    return (ast.get_docstring(tree) or "").split("\n")[0]


def _exported(tree: ast.Module) -> list[str] | None:
    """Return what ``__all__`` lists, or None without one."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return [str(item.value) for item in ast.walk(node.value) if isinstance(item, ast.Constant)]
    return None


def _defined(tree: ast.Module) -> list[str]:
    """Return the public classes, functions, derived ones too, and documented values that a module defines itself."""
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
