"""``lfcal doctor``: list what lfcal can use on this machine, and the reason for each fault."""

from __future__ import annotations

import importlib
import platform
import shutil
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import typer

from lfcal.base import WORKERS, Registry, format_bytes, kernel_folder, processors, total_memory, worker_count
from lfcal.cli._console import print_json, print_result, print_table, report
from lfcal.cli._options import JsonOption

WINDOW = ("PySide6-Essentials", "pyqtgraph")
"""Libraries of the extra ``gui``."""

LIBRARIES = (
    *("numpy", "scipy", "numba", "h5py", "hdf5plugin", "opencv-python-headless", "rawpy", "tifffile"),
    *("imagecodecs", "matplotlib", "typer", "rich", *WINDOW),
)


def command(
    *,
    gui: bool = typer.Option(
        False, "--gui", help="Check only what the window needs; exit code 1 if something is missing."
    ),
    json: JsonOption = False,
) -> None:
    """List versions, processors, memory, disk, caches, devices and broken plug-ins, with the reason for each fault.

    Example: `lfcal doctor`, or, if the window does not open: `lfcal doctor --gui`
    """
    from rich.markup import escape

    if gui:
        _show_window(json)
        return
    found = examine()
    if json:
        print_json(found)
        return
    print_table(["machine", "value"], [[key, escape(str(value))] for key, value in found["machine"].items()])
    libraries = [[k, v or escape(f"absent: {_remedy(k)}")] for k, v in found["libraries"].items()]
    print_table(["library", "version"], libraries)
    devices = [[d["name"], d["title"], d["version"] or escape(f"absent: {d['reason']}")] for d in found["devices"]]
    print_table(["devices", "what", "found"], devices)
    if found["plugins"]:
        print_table(["plug-in not loaded", "why"], [[p["name"], escape(p["reason"])] for p in found["plugins"]])


def _show_window(json: bool) -> None:
    """Print whether each library of the window is installed."""
    from lfcal.base import NEEDED, ON_X11, missing_libraries, without

    packages = {name: _version(name) for name in WINDOW}
    libraries = {**NEEDED, **ON_X11}
    missing = missing_libraries(libraries)
    rows = [[name, version or "absent"] for name, version in packages.items()]
    print_result({"libraries": packages, "missing": missing}, ["library", "version"], rows, json=json)
    if not json:
        rows = [[name, libraries[name], "missing" if name in missing else "there"] for name in libraries]
        print_table(["system library", "package of Debian, Ubuntu", ""], rows)
    absent = [name for name, version in packages.items() if version is None]
    if absent:
        report(f"{', '.join(absent)}: not installed; run: {_remedy(absent[0])}")
    if missing:
        report(without(missing))
    if absent or missing:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Return a report on this installation: plain values under ``machine``, ``libraries``, ``devices`` and ``plugins``.

    The version of a library is None if it is absent.
    """
    from dataclasses import asdict

    from lfcal import __version__
    from lfcal.devices import find_backends

    bound = WORKERS if worker_count() != processors() else "every processor this process may use"
    machine: dict[str, Any] = {
        "lfcal": __version__,
        "Python": platform.python_version(),
        "platform": platform.platform(),
        "processors": processors(),
        "threads used": f"{worker_count()} ({bound})",
        "memory": format_bytes(total_memory()),
        "disk free here": format_bytes(shutil.disk_usage(Path.cwd()).free),
        "disk free for temporary files": format_bytes(shutil.disk_usage(tempfile.gettempdir()).free),
        "HDF5": importlib.import_module("h5py").version.hdf5_version,
        "numba cache": _numba_cache(),
        "speed for forecasts": _speed(),
    }
    libraries = {name: _version(name) for name in LIBRARIES}
    devices = [asdict(found) for found in find_backends()]
    return {"machine": machine, "libraries": libraries, "devices": devices, "plugins": broken_plugins()}


def broken_plugins() -> list[dict[str, str]]:
    """Return ``kind``, ``name`` (of the entry point) and ``reason`` of each plug-in that could not be loaded."""
    from lfcal.devices import BACKENDS
    from lfcal.frames import SOURCES
    from lfcal.frames.formats import FORMATS
    from lfcal.judge import FAULTS, FINDING_SOURCES
    from lfcal.judge.quality import METRICS
    from lfcal.reconstruct import SOLVERS
    from lfcal.simulate.effects import CATALOGUE

    # in the order of the data, like the commands
    registries: list[Registry[Any]] = [FORMATS, SOURCES, CATALOGUE, SOLVERS, METRICS, FAULTS, FINDING_SOURCES, BACKENDS]
    return [
        {"kind": registry.what, "name": name, "reason": reason}
        for registry in registries
        for name, reason in registry.failures().items()
    ]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _remedy(name: str) -> str:
    extra = "gui" if name in WINDOW else "hdf5" if name == "hdf5plugin" else ""
    return f'pip install "lfcal[{extra}]"' if extra else f"pip install {name}"


def _numba_cache() -> str:
    """Return a folder of compiled kernels as text, or that none is writable."""
    return kernel_folder() or "no folder is writable; set NUMBA_CACHE_DIR, or kernels are compiled at every start"


def _speed() -> str:
    """Return the stored speed of this machine as text, and how simulations have corrected it."""
    from lfcal.simulate.accuracy import machine_speed

    speed = machine_speed()
    place = f"; stored in {speed.file}" if speed.file else "; not stored, because LFCAL_CACHE is empty"
    if not speed.measured:
        return f"not measured yet; the first forecast measures it{place}"
    words = [f"{speed.rate():.2g} complex multiply-adds per second and thread"]
    words += [f"{name}: {speed.ratio(name):.2f} times the forecast ({speed.planes(name)})" for name in speed.engines]
    return ", ".join(words) + place
