"""The house plan: who may import whom, and what ``import lfcal`` must not load."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.architecture.sources import FILES, PACKAGES, ROOT, WINDOW, name_of, origin, text_of, tree_of
from tests.architecture.test_house import statements

GROUND = {"base", "_lazy"}
ALLOWED: dict[str, set[str]] = {
    "base": {"_lazy"},
    "_lazy": set(),
    "records": GROUND,
    "camera": GROUND,
    "lattice": GROUND | {"camera"},
    "frames": GROUND | {"camera", "lattice", "records"},
    "work": GROUND,
    "psf": GROUND | {"work", "camera", "frames", "records"},
    "simulate": GROUND | {"work", "camera", "frames", "psf"},
    "fit": GROUND | {"work", "camera", "psf", "simulate"},
    "recalibrate": GROUND | {"camera", "psf", "simulate", "fit"},
    "targets": GROUND | {"camera", "frames", "simulate", "multiplex"},
    "devices": GROUND | {"camera", "frames"},
    "acquire": GROUND | {"devices", "camera", "frames", "psf", "targets"},
    "campaign": GROUND | {"acquire", "devices", "fit", "camera", "frames", "psf", "simulate", "targets"},
    "reconstruct": GROUND | {"work", "camera", "lattice", "frames", "psf", "acquire", "records"},
    "judge": {
        *GROUND,
        *("work", "camera", "lattice", "frames", "psf", "simulate", "fit", "reconstruct", "acquire", "campaign"),
    },
    "multiplex": GROUND | {"camera", "lattice", "frames"},
    "tasks": {
        *GROUND,
        *("records", "work", "camera", "lattice", "frames", "psf", "simulate", "fit", "targets", "devices", "acquire"),
        *("campaign", "reconstruct", "recalibrate", "judge", "multiplex", "accuracy"),
    },
    "napari": GROUND | {"acquire", "psf", "reconstruct"},
    "accuracy": {
        *GROUND,
        *("camera", "frames", "lattice", "psf", "simulate", "fit", "acquire", "reconstruct", "multiplex"),
    },
}
"""Which parts of the library a part may import besides itself; a part stands on those below it."""

TOP = {"cli", "__main__", "_face"}
FRAMES_OF_PSF = ("lfcal.frames.source", "lfcal.frames.orientation", "lfcal.frames.part")
"""All that the matrix knows of frames: the protocol, and the geometry of parts, flips and turns."""


def modules(package: str) -> list[Path]:
    return [path for path in FILES if f"{name_of(path)}.".startswith(f"{package}.")]


@cache
def imported(path: Path) -> set[str]:
    """Absolute names a file imports anywhere in it, function bodies included."""
    found: set[str] = set()
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return found


def modules_used(path: Path) -> set[str]:
    """Return the modules of ours that the names which a file imports come from."""
    return {
        origin(str(node.module), alias.name)
        for node in statements(tree_of(path))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def part_of(path: Path) -> str:
    return path.relative_to(ROOT / "lfcal").parts[0].removesuffix(".py")


def beyond(path: Path) -> set[str]:
    """Return the parts of the library that a file of it imports and must not; the library never imports the window."""
    names = imported(path)
    window = {n for n in names if n.split(".")[0] in ("lfcal_gui", "benchmarks")}
    part = part_of(path)
    if part in TOP or part == "__init__":
        return window
    parts = {n.split(".")[1] for n in names if n.startswith("lfcal.") and n.count(".") >= 1}
    parts -= {"__version__"}
    allowed = ALLOWED[part] | {part}
    if part == "devices" and "simulated" in path.parts:
        allowed |= {"simulate", "targets"}  # the simulated camera alone shows what the simulator makes
    return window | (parts - allowed)


def test_arrows() -> None:
    assert not {str(path.relative_to(ROOT)): sorted(found) for path in modules("lfcal") if (found := beyond(path))}


def test_psf_knows_frames_by_their_protocol_only() -> None:
    for path in modules("lfcal.psf"):
        for name in modules_used(path):
            if name.startswith("lfcal.frames"):
                assert name.startswith(FRAMES_OF_PSF), f"{path.name} imports {name}"


def test_the_arrow_test_can_fail(tmp_path: Path) -> None:
    bad = tmp_path / "x.py"
    bad.write_text("def f():\n    from lfcal.simulate import ladder\n")
    assert "lfcal.simulate.ladder" in imported(bad)
    assert not {"simulate"} <= ALLOWED["psf"]


def test_pages_do_not_import_each_other() -> None:
    pages = WINDOW / "pages"
    for path in sorted(pages.glob("*/*.py")):
        others = {n.split(".")[2] for n in imported(path) if n.startswith("lfcal_gui.pages.")}
        assert others <= {path.parent.name}, path


@pytest.mark.parametrize(
    "module", ["lfcal", "lfcal.camera", "lfcal.psf", "lfcal.frames", "lfcal.reconstruct", "lfcal.cli._console"]
)
def test_importing_the_library_loads_no_window_and_no_plotting(module: str) -> None:
    code = (
        f"import sys, {module}; print([m for m in ('PySide6', 'pyqtgraph', 'matplotlib', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_module_says_what_it_is() -> None:
    for path in FILES:
        if text_of(path).strip():
            assert ast.get_docstring(tree_of(path)), f"{path} has no docstring"


PLATFORM_CALLS = re.compile(
    r"\bos\.(fsync|fdatasync|posix_fallocate|pwrite|pread|kill|replace|rename|cpu_count|sched_getaffinity|sync)\b"
    r"|\bimport (fcntl|msvcrt)\b|\bO_(BINARY|CLOEXEC|DIRECTORY)\b|\bflock\("
)


def test_calls_that_differ_between_systems_have_one_home() -> None:
    files = [path for path in FILES if path != ROOT / "lfcal" / "base" / "system.py"]
    calls = {str(p.relative_to(ROOT)): PLATFORM_CALLS.search(text_of(p)) for p in files}
    assert not {name: found[0] for name, found in calls.items() if found}, "use lfcal.base.system"


PART_OF = {"cv2": "opencv-python-headless", "dask": "distributed", "shiboken6": "pyside6-essentials"}
"""Modules that several distributions contain, or that a declared one pins to its own version exactly."""

AS_MAKERS_SAY = {"torch", "cupy"}
"""Installed as their makers say for the driver at hand; see the extra ``gpu``."""


def test_every_import_is_of_a_declared_dependency() -> None:
    """A module that another dependency happens to bring may be gone with that one's next version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {name: set(map(canonical, lines)) for name, lines in project["optional-dependencies"].items()}
    always = set(map(canonical, project["dependencies"]))
    brought_by = packages_distributions()
    wrong = []
    for path in FILES:
        top = always | (extras["gui"] if path.is_relative_to(ROOT / "gui") else set())
        tree = tree_of(path)
        at_once = set(map(id, tree.body))
        for node in statements(tree):
            if not isinstance(node, ast.Import | ast.ImportFrom):
                continue
            declared = top if id(node) in at_once else always.union(*extras.values())
            for name in packages_of(node) - sys.stdlib_module_names - AS_MAKERS_SAY - set(PACKAGES):
                found = {PART_OF.get(name, ""), *map(canonical, brought_by.get(name, [name]))}
                if not found & declared:
                    wrong.append(f"{path.relative_to(ROOT)}: {name}")
    assert not wrong


def packages_of(node: ast.stmt) -> set[str]:
    """Return the top-level packages that a statement imports."""
    names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
    if isinstance(node, ast.ImportFrom) and node.module:
        names = [node.module]
    return {name.partition(".")[0] for name in names}


def canonical(requirement: str) -> str:
    """Return the name of a distribution as it is compared, of a requirement."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s<>=!~;\[]", requirement, maxsplit=1)[0]).lower()
