"""What functions and records ask for: no protocol by the name of an attribute, and no argument that another has."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.architecture.sources import ROOT, text_of, tree_of
from tests.architecture.test_house import FILES

MODULE, PART, DRIVER = "attributes of a module", "what another package has registered", "a driver's own answer"
ALLOWED = {
    ("gui/lfcal_gui/log.py", "__version__"): MODULE,
    ("lfcal/base/files.py", "O_NOFOLLOW"): MODULE,
    ("lfcal/base/h5/probe.py", "CREATE_NO_WINDOW"): MODULE,
    ("lfcal/base/h5/probe.py", "frozen"): MODULE,
    ("lfcal/base/system.py", "O_BINARY"): MODULE,
    ("lfcal/base/system.py", "O_CLOEXEC"): MODULE,
    ("lfcal/base/registry.py", "name"): PART,
    ("lfcal/fit/parameters.py", "title"): PART,
    ("lfcal/simulate/effects/registered.py", "title"): PART,
    ("lfcal/simulate/effects/registered.py", "acts_on"): PART,
    ("lfcal/devices/checked.py", "name"): DRIVER,
    ("lfcal/devices/checked.py", "shape"): DRIVER,
    ("lfcal/devices/checked.py", "dtype"): DRIVER,
    ("lfcal/cli/__init__.py", "__notes__"): "Python gives exceptions notes when the first is added",
    ("lfcal/cli/_usage.py", "ctx"): "errors of click",
    ("lfcal/cli/_usage.py", "option_name"): "errors of click",
    ("lfcal/base/compiled.py", "_cache"): "dispatchers of numba",
    ("lfcal/base/compiled.py", "_cache_file"): "dispatchers of numba",
    ("lfcal/base/compiled.py", "args"): "signatures of numba",
    ("lfcal/frames/formats/raw.py", "photometric"): "pages of tifffile",
}
"""File and attribute of what Python or other people's libraries may lack, and why it is asked for."""


def asked(tree: ast.AST) -> Iterator[str]:
    """Yield the names in calls ``getattr(x, "name", default)``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "getattr":
            name = node.args[1] if len(node.args) > 2 else None
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                yield name.value


def test_such_calls_are_found() -> None:
    code = 'getattr(a, "b", 1), getattr(a(x), "c", None), getattr(a, name, 1), getattr(a, "d"), f(getattr, a, "e", 1)'
    assert list(asked(ast.parse(code))) == ["b", "c"]


def test_no_protocol_is_asked_for_by_an_attribute_s_name() -> None:
    asking = [path for path in FILES if "getattr(" in text_of(path)]
    found = {(path.relative_to(ROOT).as_posix(), name) for path in asking for name in asked(tree_of(path))}
    new, gone = sorted(found - ALLOWED.keys()), sorted(ALLOWED.keys() - found)
    assert not new, f"{new}: give the class or protocol this attribute, with a default"
    assert not gone, f"{gone}: take them off the list"


ANOTHER = "the plan is of the camera as it was described, and the camera is another description of it"
BOTH_CAMERAS = {
    ("lfcal/fit/drawing.py", "lens_types"): ANOTHER,
    ("gui/lfcal_gui/pages/setup/model.py", "carried"): ANOTHER,
}
"""File and function that take a camera and a plan, which has a camera, and why the two may differ."""

PLANS = {"ScanPlan", "RegionPlan", "TargetPlan"}


def with_both(tree: ast.AST) -> Iterator[str]:
    """Yield the functions and records that take a camera and a plan; without a plan the camera is needed."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            arguments = node.args
            named = [(a.arg, a.annotation) for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
        elif isinstance(node, ast.ClassDef):
            lines = [line for line in node.body if isinstance(line, ast.AnnAssign)]
            named = [(line.target.id, line.annotation) for line in lines if isinstance(line.target, ast.Name)]
        else:
            continue
        types = [{part.strip() for part in ast.unparse(kind or ast.Constant("")).split("|")} for _, kind in named]
        cameras = any("Camera" in kind for kind in types)
        if cameras and any(kind & PLANS and "None" not in kind for kind in types):
            yield node.name


def test_a_camera_beside_a_plan_is_found() -> None:
    code = """
def a(camera: Camera, plan: ScanPlan): ...
def b(plan: ScanPlan | TargetPlan, *, camera: Camera | None = None): ...
class C:
    camera: Camera
    plan: RegionPlan
def d(plan: ScanPlan, effects: Sequence[Effect]): ...
def e(camera: Camera, plan: ScanPlan | None): ...
"""
    assert list(with_both(ast.parse(code))) == ["a", "b", "C"]


def test_no_camera_is_asked_for_beside_a_plan() -> None:
    """A plan has its camera: a second one could only be the same, or wrong."""
    taking = [path for path in FILES if "Camera" in text_of(path) and "Plan" in text_of(path)]
    found = {(path.relative_to(ROOT).as_posix(), name) for path in taking for name in with_both(tree_of(path))}
    new, gone = sorted(found - BOTH_CAMERAS.keys()), sorted(BOTH_CAMERAS.keys() - found)
    assert not new, f"{new}: take the plan alone"
    assert not gone, f"{gone}: take them off the list"
