"""Values of a camera as they are given on the command line: options with units, and ``--set PATH=VALUE``."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from typing import Any

import typer

from lfcal.base import InputError
from lfcal.camera import QUANTITIES

__all__ = ["parse_pitch", "parse_value", "with_values"]

LENGTHS = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "mm": 1e3, "m": 1e6}
WHOLE = ("optics.blades", "lattice.type_step", "sensor.bit_depth")
TEXT = ("lattice.kind", "sensor.cfa")
SEVERAL = ("lattice.types", "lattice.offset_um", "lattice.focus")
NUMBER = re.compile(r"\s*([-+]?(?:inf|[0-9.]+(?:[eE][-+]?\d+)?))\s*([a-zµ°]*)\s*")


def with_values(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that state values of a camera, in place of its parameter ``values``."""
    own, options = inspect.signature(command, eval_str=True), inspect.signature(stated, eval_str=True).parameters

    def with_options(**given: Any) -> None:
        values = stated(**{name: given.pop(name) for name in options})
        command(**given, values=values)

    parameters = [
        one for name, old in own.parameters.items() for one in (options.values() if name == "values" else (old,))
    ]
    with_options.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {one.name: one.annotation for one in parameters}
    with_options.__doc__ = command.__doc__
    return with_options


def stated(
    *,
    sensor: str = typer.Option("", help="Sensor: ROWSxCOLUMNS,PIXEL (µm), for example 4384x6576,5.5."),
    lens: str = typer.Option(
        "", help="Main lens: FOCAL,F_NUMBER,DISTANCE (mm; to the working plane), e.g. 200,4,1000."
    ),
    objective: str = typer.Option("", help="Objective: MAGNIFICATION,NA,INDEX of the medium, for example 20,0.5,1."),
    array: str = typer.Option("", help="Lenslets: hexagonal or square."),
    pitch: str = typer.Option("", help="Distance of micro-images: µm, or pixels as 31.7px."),
    gap: str = typer.Option("", help="Distance from lenslets to sensor (µm)."),
    focus: str = typer.Option(
        "", help="Virtual depths in focus, one per lens type: 2,3,5; inf is a focal length equal to the gap."
    ),
    wavelength: str = typer.Option("", help="Wavelength (nm)."),
    others: list[str] | None = typer.Option(
        None, "--set", help="Any other value as PATH=VALUE, e.g. sensor.full_well_e=20000; may be repeated."
    ),
) -> dict[str, Any]:
    """Return the values of the options by path; an empty option says nothing.

    Raises
    ------
    InputError
        If an option cannot be read; the message says what it should look like.
    """
    found: dict[str, Any] = {}
    if sensor:
        found |= _sensor(sensor)
    if lens:
        names = ("optics.focal_length_um", "optics.f_number", "optics.working_distance_um")
        found |= _list(lens, names, ("mm", "", "mm"), "--lens FOCAL,F_NUMBER,DISTANCE", "200,4,1000")
    if objective:
        names = ("optics.magnification", "optics.numerical_aperture", "optics.medium_index")
        found |= _list(objective, names, ("", "", ""), "--objective MAGNIFICATION,NA,INDEX", "20,0.5,1")
    for path, text in (("lattice.kind", array), ("lattice.gap_um", gap), ("lattice.focus", focus)):
        if text:
            found[path] = parse_value(path, text)
    if wavelength:
        found["wavelength_um"] = _length(wavelength, "nm", "--wavelength")
    for entry in others or []:
        path, _, text = entry.partition("=")
        found[path.strip()] = parse_value(path.strip(), text)
    if pitch:
        found["lattice.pitch_um"] = parse_pitch(pitch, found.get("sensor.pixel_um"))
    return found


def parse_value(path: str, text: str) -> Any:
    """Return the value that ``text`` means for ``path``: lengths in µm or with nm, mm, m; angles in rad or with deg."""
    known = [quantity.path for quantity in QUANTITIES] + ["lattice.focus"]
    if path not in known:
        raise InputError.expected(
            "value of a camera", "PATH=VALUE, PATH one of " + ", ".join(known), path, "correct it"
        )
    text = text.strip()
    if path in TEXT:
        return text
    if path == "sensor.shape":
        return _sensor(text)["sensor.shape"]
    convert: Callable[[str], Any] = (
        (lambda part: _whole(part, path)) if path in WHOLE else lambda part: _one(part, path)
    )
    if path in SEVERAL:
        return tuple(convert(part) for part in text.split(","))
    return convert(text)


def _one(text: str, path: str) -> float:
    if path.endswith("_um") or path == "lattice.types":
        return _length(text, "µm", path)
    value, unit = _number(text, path)
    if path.endswith("_rad") and unit in ("deg", "°"):
        return math.radians(value)
    if unit:
        raise InputError.expected(path, "a number without a unit", repr(text), "remove the unit")
    return value


def _whole(text: str, path: str) -> int:
    value, unit = _number(text, path)
    if unit or not value.is_integer():
        raise InputError.expected(path, "a whole number", repr(text), "correct it")
    return int(value)


def _number(text: str, what: str) -> tuple[float, str]:
    match = NUMBER.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        return float(match[1]), match[2]
    except ValueError:
        raise InputError.expected(what, "a number", repr(text), "write it like 5.5 or 5.5um") from None


def _length(text: str, usual: str, what: str) -> float:
    """Return a length in µm; a bare number is in ``usual``."""
    value, unit = _number(text, what)
    if (unit or usual) not in LENGTHS:
        raise InputError.expected(what, f"a length in {usual}, or with nm, um, mm, m", repr(text), "correct the unit")
    # 12 digits: 0.55 µm stays 0.55 through nanometres
    return float(f"{value * LENGTHS[unit or usual]:.12g}")


def _sensor(text: str) -> dict[str, Any]:
    match = re.fullmatch(r"\s*(\d{1,6})\s*[x×*]\s*(\d{1,6})\s*(?:,(.+))?", text)
    if match is None:
        raise InputError.expected("--sensor", "ROWSxCOLUMNS,PIXEL", repr(text), "for example 4384x6576,5.5")
    found: dict[str, Any] = {"sensor.shape": (int(match[1]), int(match[2]))}
    if match[3]:
        found["sensor.pixel_um"] = _length(match[3], "µm", "--sensor, pixel pitch")
    return found


def _list(text: str, paths: tuple[str, ...], units: tuple[str, ...], shape: str, example: str) -> dict[str, Any]:
    """Return the values of a list; the last ones may be left out."""
    parts = text.split(",")
    if len(parts) > len(paths) or not all(part.strip() for part in parts):
        raise InputError.expected(shape.split()[0], shape, repr(text), f"for example {example}")
    given = zip(parts, paths, units, strict=False)
    return {path: _length(part, unit, path) if unit else _one(part, path) for part, path, unit in given}


def parse_pitch(text: str, pixel_um: float | None) -> float:
    """Return a pitch in µm, given with a unit of length, bare in µm, or in pixels as ``31.7px``."""
    if not text.strip().endswith("px"):
        return _length(text, "µm", "--pitch")
    if pixel_um is None:
        raise InputError.expected("--pitch", "the pixel pitch beside a pitch in pixels", "none", "add --sensor")
    value, _ = _number(text.strip()[:-2], "--pitch")
    return float(f"{value * pixel_um:.12g}")
