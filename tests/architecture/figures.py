"""The structure of the code in figures: ``python -m tests.architecture.figures``."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict

from tests.architecture.sources import FILES, MODULES, PACKAGES, face_of, is_package, name_of, text_of, tree_of
from tests.architecture.test_frame_way import files_entered, units_of_planes, values_carried
from tests.architecture.test_house import package_of, past_the_face, sees, written

__all__ = ["figures"]


def figures() -> dict[str, str]:
    """Return what is counted, in words."""
    faces = {package: face_of(package) for package in MODULES if is_package(package)}
    across = [
        (path, module, name)
        for path in FILES
        if path.stem not in ("_face", "_shared")
        for module, name in written(path)
        if name
        and module in MODULES
        and not sees(package_of(path), module if is_package(module) else module.rpartition(".")[0])
    ]
    public = sum(len(names_in(path.parent / "_face.py")) for path in FILES if path.stem == "_face")
    alone = single_clients()
    return {
        "files": ", ".join(f"{package} {count}" for package, count in files().items()),
        "lines": ", ".join(f"{package} {count / 1e3:.1f} k" for package, count in lines().items()),
        "names imported across packages": str(len(across)),
        "past the face": str(sum(len(past_the_face(path)) for path in FILES)),
        "names on faces": f"{public} public, {sum(map(len, faces.values())) - public} for other packages alone",
        "modules with one client, not private": f"{len(alone)}: {dict(Counter(alone.values()).most_common())}",
        "units of planes of H": str(units_of_planes()),
        "files entered by a frame on its way to H": counted(files_entered()),
        "values carried along": counted(values_carried()),
        "private modules": f"{sum(private(module) for module in MODULES)} of {len(MODULES)}",
    }


def counted(names: list[str]) -> str:
    """Return how many they are, and their names."""
    return f"{len(names)}: {', '.join(names)}"


def names_in(path: object) -> list[str]:
    """Return the names that a face imports."""
    return [
        alias.asname or alias.name
        for node in tree_of(path).body  # type: ignore[arg-type]
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    ]


def private(module: str) -> bool:
    """Return whether a module is private."""
    return module.rpartition(".")[2].startswith("_")


def files() -> dict[str, int]:
    """Return the number of files of each package."""
    return dict(Counter(name_of(path).partition(".")[0] for path in FILES))


def lines() -> dict[str, int]:
    """Return the number of lines of each package."""
    found = dict.fromkeys(PACKAGES, 0)
    for path in FILES:
        found[name_of(path).partition(".")[0]] += text_of(path).count("\n")
    return found


def single_clients() -> dict[str, str]:
    """Return the public modules that one module of the same package imports and nobody else, with their package."""
    clients: dict[str, set[str]] = defaultdict(set)
    for path in FILES:
        for module, name in written(path):
            inner = f"{module}.{name}"
            clients[inner if inner in MODULES else module].add(name_of(path))
    given = {module for package in MODULES if is_package(package) for module, _ in face_of(package).values()}
    return {
        module: module.rpartition(".")[0]
        for module, found in clients.items()
        if module in MODULES
        and not is_package(module)
        and not private(module)
        and module not in given
        and len(found) == 1
        and package_of(MODULES[next(iter(found))]) == module.rpartition(".")[0]
    }


if __name__ == "__main__":
    for what, said in figures().items():
        print(f"{what}: {said}")
