"""Device backends by name, the reasons why some are unavailable, and their options as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from lfcal.base import InputError, LfcalError, Registry
from lfcal.camera import ScanPlan
from lfcal.devices.errors import DeviceError, DeviceMissing, driver_errors
from lfcal.devices.protocols import Limits
from lfcal.devices.rig import Rig

__all__ = [
    "BACKENDS",
    "GROUP",
    "Backend",
    "BackendStatus",
    "backend_registry",
    "check_options",
    "find_backends",
    "get_backend",
    "limits_option",
    "number_option",
    "open_rig",
]

GROUP = "lfcal.devices"


@runtime_checkable
class Backend(Protocol):
    """Protocol for a backend, which provides access to devices, such as through a driver library.

    Attributes
    ----------
    name, title
        Name used in commands, and display name.
    options
        Mapping from the name of each option of `open` to its one-line meaning.
    has_stage
        Whether the backend includes a stage; if not, `open_rig` needs the name of another backend for the stage.
    """

    name: str
    title: str
    options: Mapping[str, str]
    has_stage: bool

    def probe(self) -> str:
        """Return the version of the driver library; raise `DeviceMissing` with reason and remedy if it is missing."""
        ...

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Open the devices with ``options`` (texts by name), and return them ready to record ``plan``."""
        ...


@dataclass(frozen=True, slots=True)
class BackendStatus:
    """Availability of a backend.

    ``name`` is its name in commands, and ``title`` its display name. ``version`` is the version of its driver library,
    or ``reason`` states why it is unavailable; the other one is empty.
    """

    name: str
    title: str
    version: str
    reason: str

    @property
    def available(self) -> bool:
        """Whether the backend is available."""
        return not self.reason


def _made(found: Any) -> Backend:
    """Return the backend that an entry point loads; if it is a class, return an instance."""
    backend = found() if isinstance(found, type) else found
    if not isinstance(backend, Backend):
        wanted = "a backend with name, title, has_stage, options, probe and open"
        raise TypeError(f"expected {wanted}, got {type(backend).__name__}")
    return backend


def backend_registry() -> Registry[Backend]:
    """Return a new registry of backends: the simulator, lfcal's other backends, and backends of other packages."""
    return Registry(
        "device backend",
        "lfcal.devices.backends",
        "BACKEND",
        GROUP,
        order=lambda backend: (backend.name != "sim", backend.name),
        make=_made,
    )


BACKENDS = backend_registry()
"""All available backends."""


def get_backend(name: str) -> Backend:
    """Return the backend ``name``; raise `InputError` if there is none, `DeviceMissing` if it cannot be loaded.

    Examples
    --------
    >>> from lfcal.devices import get_backend
    >>> print(get_backend("sim").title)
    simulated camera and stage
    """
    reason = BACKENDS.failures().get(name)
    if reason is not None and name not in BACKENDS:
        raise DeviceMissing(f"{reason}; update or remove the package that provides it")
    return BACKENDS.get(name)


def find_backends() -> list[BackendStatus]:
    """Return the status of every backend, including those that cannot be loaded.

    Examples
    --------
    >>> from lfcal.devices import BackendStatus, find_backends
    >>> found: list[BackendStatus] = find_backends()
    >>> print([one.title for one in found if one.name == "sim" and one.available])
    ['simulated camera and stage']
    """
    findings = [_probed(backend) for backend in BACKENDS]
    known = {finding.name for finding in findings}
    failures = BACKENDS.failures().items()
    return findings + [BackendStatus(name, name, "", reason) for name, reason in failures if name not in known]


def _probed(backend: Backend) -> BackendStatus:
    try:
        return BackendStatus(backend.name, backend.title, backend.probe(), "")
    except LfcalError as error:
        return BackendStatus(backend.name, backend.title, "", str(error))
    except (Exception, SystemExit) as error:  # a foreign package may fail in any way
        return BackendStatus(backend.name, backend.title, "", f"{type(error).__name__}: {error}")


def open_rig(
    plan: ScanPlan, backend: str | Backend, options: Mapping[str, str] | None = None, *, stage: str = ""
) -> Rig:
    """Open the devices of ``backend`` for ``plan``; if ``stage`` names another backend, use the stage of that one.

    ``options`` maps option names to texts. Options for the backend of the stage are prefixed with its name, such as
    ``micromanager.config``.

    Raises
    ------
    InputError
        If a backend or an option is unknown, or the backend that should provide the stage has none.
    DeviceError
        If a driver or a device is missing, or the devices cannot be opened.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import open_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> with open_rig(plan, "sim") as rig:
    ...     print(rig.camera.name, tuple(rig.camera.sensor_shape))
    simulated camera (320, 320)
    """
    if isinstance(backend, str):
        backend = get_backend(backend)
    if stage and stage != backend.name:
        own, other = _split(options or {}, stage)
        mover = get_backend(stage)
        if stage == "sim":
            other.setdefault("time", "real")  # the camera's frames come in real time
            other.setdefault("optics", "pattern")  # only its stage is used, so no light needs to be computed
        if not mover.has_stage:
            raise InputError.expected("stage", "a backend with a stage", stage, "choose sim or micromanager")
        rig = _open(backend, plan, own)
        try:
            carrier = _open(mover, plan, other)
        except BaseException:
            rig.close()
            raise
        # opened together with the devices in use, and closed with them
        others = (rig.stage, carrier.camera)
        return Rig(rig.camera, carrier.stage, rig.light or carrier.light, rig.time, others)
    if not backend.has_stage:
        raise InputError.expected(
            "stage", f"one for the camera of {backend.name}", "none", "choose a backend for the stage, such as sim"
        )
    return _open(backend, plan, dict(options or {}))


def check_options(backend: Backend, options: Mapping[str, str]) -> None:
    """Raise `InputError` if ``options`` contains a name that is not an option of ``backend``."""
    for key in options:
        if key not in backend.options:
            known = ", ".join(sorted(backend.options)) or "none"
            raise InputError.expected(f"option of {backend.name}", known, repr(key), "choose one of these")


def _open(backend: Backend, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
    check_options(backend, options)
    # a foreign package may fail in any way
    with driver_errors(f"backend {backend.name}"):
        backend.probe()
        found: object = backend.open(plan, options)
    if not isinstance(found, Rig):
        remedy = "update or remove the package that provides it"
        raise DeviceError.expected(f"devices of {backend.name}", "a Rig", type(found).__name__, remedy)
    return found


def _split(options: Mapping[str, str], stage: str) -> tuple[dict[str, str], dict[str, str]]:
    prefix = f"{stage}."
    own = {key: value for key, value in options.items() if not key.startswith(prefix)}
    other = {key.removeprefix(prefix): value for key, value in options.items() if key.startswith(prefix)}
    return own, other


def number_option(
    options: Mapping[str, str], key: str, default: float, *, low: float = -math.inf, high: float = math.inf
) -> float:
    """Return ``options[key]`` as a number; ``default`` if it is missing.

    Raise `InputError` if the text is not a number from ``low`` to ``high``, inclusive.

    Examples
    --------
    >>> from lfcal.devices import number_option
    >>> number_option({"speed": "250"}, "speed", 100.0, low=0.0), number_option({}, "speed", 100.0)
    (250.0, 100.0)
    """
    text = options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise InputError.expected(
            f"option {key}", f"a number from {low:g} to {high:g}", repr(text), "give a number in this range"
        )
    return value


def limits_option(options: Mapping[str, str], key: str = "limits") -> Limits | None:
    """Return the stage's limits (µm) from the text ``x0:x1,y0:y1,z0:z1`` in ``options[key]``; None if it is missing.

    Raise `InputError` if the text has another form, or an upper limit is not above the lower one.

    Examples
    --------
    >>> from lfcal.devices import limits_option
    >>> limits_option({"limits": "0:50000,0:50000,-1000:1000"})  # of each axis (um)
    ((0.0, 50000.0), (0.0, 50000.0), (-1000.0, 1000.0))
    """
    text = options.get(key)
    if text is None:
        return None
    try:
        pairs = [tuple(float(v) for v in part.split(":")) for part in text.split(",")]
        (x0, x1), (y0, y1), (z0, z1) = pairs
    except ValueError:
        x0, x1, y0, y1, z0, z1 = 1.0, 0.0, 1.0, 0.0, 1.0, 0.0
    if not (x0 < x1 and y0 < y1 and z0 < z1):
        raise InputError.expected(
            f"option {key}", "x0:x1,y0:y1,z0:z1 in µm, low before high", repr(text), "give two numbers for each axis"
        )
    return (x0, x1), (y0, y1), (z0, z1)
