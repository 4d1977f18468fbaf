"""Which devices can be had here, found by name, and why others cannot.

Backends come with lfcal, or from other packages through the entry point group ``lfcal.devices``: a name and
an object (or a class without arguments) that is a `Backend`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import Any, Protocol, runtime_checkable

from lfcal.camera import ScanPlan
from lfcal.devices.errors import DeviceMissing
from lfcal.devices.protocols import Rig
from lfcal.errors import InputError, LfcalError

__all__ = ["GROUP", "Backend", "Finding", "check_options", "find_backends", "get_backend", "open_rig"]

GROUP = "lfcal.devices"

OWN = {
    "sim": "lfcal.devices.simulated.backend:SimBackend",
    "micromanager": "lfcal.devices.backends.micromanager:MicroManagerBackend",
    "aravis": "lfcal.devices.backends.aravis:AravisBackend",
    "gentl": "lfcal.devices.backends.gentl:GenTLBackend",
    "folder": "lfcal.devices.backends.folder:FolderBackend",
}
"""Backends that come with lfcal."""


@runtime_checkable
class Backend(Protocol):
    """A way to reach devices.

    Attributes
    ----------
    name, title
        For commands, and for people.
    options
        Name and one-line meaning of each option of `open`.
    has_stage
        Whether it brings a stage; others are given one of another backend.
    """

    name: str
    title: str
    options: Mapping[str, str]
    has_stage: bool

    def probe(self) -> str:
        """Return the version of what drives the devices; raise `DeviceMissing` with the reason and remedy."""
        ...

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return the devices, ready to record ``plan``."""
        ...


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of a backend: its version, or the reason why it is absent."""

    name: str
    title: str
    version: str
    reason: str

    @property
    def available(self) -> bool:
        """Whether it can be used."""
        return not self.reason


def get_backend(name: str) -> Backend:
    """Return backend ``name``; raises `InputError` if nobody knows it, `DeviceMissing` if it does not load."""
    places = _places()
    if name not in places:
        raise InputError.expected("device backend", " or ".join(sorted(places)), repr(name), "choose one of these")
    try:
        found = places[name]()
    except LfcalError:
        raise
    except Exception as error:  # a package of someone else may fail in any way
        raise DeviceMissing(
            f"device backend {name}: does not load ({type(error).__name__}: {error}); mend it"
        ) from error
    if not isinstance(found, Backend):
        raise DeviceMissing(f"device backend {name}: is not a backend; it needs name, title, options, probe and open")
    return found


def find_backends() -> list[Finding]:
    """Return what is found of every backend, with the reason where it cannot be used."""
    findings = []
    for name in _places():
        try:
            backend = get_backend(name)
            findings.append(Finding(name, backend.title, backend.probe(), ""))
        except LfcalError as error:
            findings.append(Finding(name, name, "", str(error)))
        except Exception as error:
            findings.append(Finding(name, name, "", f"{type(error).__name__}: {error}"))
    return findings


def open_rig(
    plan: ScanPlan, backend: str | Backend, options: Mapping[str, str] | None = None, *, stage: str = ""
) -> Rig:
    """Return the devices of ``backend`` (or its name), with the stage of backend ``stage`` where that is given.

    Options of the stage's backend are given with its name in front: ``micromanager.config=…``.

    Raises
    ------
    InputError
        If an option is unknown, or no stage is named and the backend has none.
    DeviceError
        If a device is not there.
    """
    if isinstance(backend, str):
        backend = get_backend(backend)
    if stage and stage != backend.name:
        own, other = _split(options or {}, stage)
        mover = get_backend(stage)
        if stage == "sim":
            other.setdefault("time", "real")  # the camera's frames come in real time
        if not mover.has_stage:
            raise InputError.expected("stage", "a backend with a stage", stage, "choose sim or micromanager")
        rig = _open(backend, plan, own)
        try:
            carrier = _open(mover, plan, other)
        except BaseException:
            rig.close()
            raise
        others = (rig.stage, carrier.camera)
        return Rig(rig.camera, carrier.stage, rig.light or carrier.light, rig.time, others)
    if not backend.has_stage:
        raise InputError.expected(
            "stage", f"one for the camera of {backend.name}", "none", "name its backend, e.g. sim"
        )
    return _open(backend, plan, dict(options or {}))


def check_options(backend: Backend, options: Mapping[str, str]) -> None:
    """Raise `InputError` if an option is not one of the backend's."""
    for key in options:
        if key not in backend.options:
            known = ", ".join(sorted(backend.options)) or "none"
            raise InputError.expected(f"option of {backend.name}", known, repr(key), "correct it")


def _open(backend: Backend, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
    check_options(backend, options)
    backend.probe()
    return backend.open(plan, options)


def _split(options: Mapping[str, str], stage: str) -> tuple[dict[str, str], dict[str, str]]:
    prefix = f"{stage}."
    own = {key: value for key, value in options.items() if not key.startswith(prefix)}
    other = {key.removeprefix(prefix): value for key, value in options.items() if key.startswith(prefix)}
    return own, other


def _places() -> dict[str, Callable[[], Any]]:
    """Return name and loader of every backend; those of other packages cannot hide lfcal's own."""
    places: dict[str, Callable[[], Any]] = {name: _own(target) for name, target in OWN.items()}
    for point in metadata.entry_points(group=GROUP):
        places.setdefault(point.name, _foreign(point))
    return places


def _own(target: str) -> Callable[[], Any]:
    def load() -> Any:
        module, _, attribute = target.partition(":")
        return getattr(importlib.import_module(module), attribute)()

    return load


def _foreign(point: metadata.EntryPoint) -> Callable[[], Any]:
    def load() -> Any:
        found = point.load()
        return found() if isinstance(found, type) else found

    return load
