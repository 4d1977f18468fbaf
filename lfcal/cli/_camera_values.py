"""Camera values on the command line: options with units, and ``--set PATH=VALUE``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer

from lfcal.camera import read_camera_value, read_length, read_pitch, read_sensor, read_values
from lfcal.cli._docstrings import docstring

__all__ = ["with_values"]


def with_values(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command: replace its parameter ``values`` by options that state camera values."""
    own, options = inspect.signature(command, eval_str=True), inspect.signature(stated, eval_str=True).parameters

    def with_options(**given: Any) -> None:
        values = stated(**{name: given.pop(name) for name in options})
        command(**given, values=values)

    parameters = [
        one for name, old in own.parameters.items() for one in (options.values() if name == "values" else (old,))
    ]
    with_options.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {one.name: one.annotation for one in parameters}
    with_options.__doc__ = docstring(command)
    return with_options


def stated(
    *,
    sensor: str = typer.Option("", help="Sensor: ROWSxCOLUMNS,PIXEL (µm), for example 4384x6576,5.5."),
    lens: str = typer.Option(
        "", help="Main lens: FOCAL,F_NUMBER,DISTANCE, such as 200,4,1000; focal length and working distance in mm."
    ),
    objective: str = typer.Option("", help="Objective: MAGNIFICATION,NA,INDEX of the medium, for example 20,0.5,1."),
    array: str = typer.Option("", help="Lattice of the lenslets: hexagonal or square."),
    pitch: str = typer.Option("", help="Pitch of the micro-images in µm, or in pixels, such as 31.7px."),
    gap: str = typer.Option("", help="Distance from lenslets to sensor (µm)."),
    focus: str = typer.Option(
        "", help="Virtual depths in focus, one per lens type, such as 2,3,5; inf: the focal length equals the gap."
    ),
    wavelength: str = typer.Option("", help="Wavelength (nm)."),
    others: list[str] | None = typer.Option(
        None, "--set", help="Any other value as PATH=VALUE, such as sensor.full_well_e=20000; may be repeated."
    ),
) -> dict[str, Any]:
    """Return the values of the options by path; empty options are left out.

    Raises
    ------
    InputError
        If an option cannot be parsed; the message shows the expected form.
    """
    found: dict[str, Any] = {}
    if sensor:
        found |= read_sensor(sensor)
    if lens:
        names = ("optics.focal_length_um", "optics.f_number", "optics.working_distance_um")
        found |= read_values(lens, names, ("mm", "", "mm"), "--lens FOCAL,F_NUMBER,DISTANCE", "200,4,1000")
    if objective:
        names = ("optics.magnification", "optics.numerical_aperture", "optics.medium_index")
        found |= read_values(objective, names, ("", "", ""), "--objective MAGNIFICATION,NA,INDEX", "20,0.5,1")
    for path, text in (("lattice.kind", array), ("lattice.gap_um", gap), ("lattice.focus", focus)):
        if text:
            found[path] = read_camera_value(path, text)
    if wavelength:
        found["wavelength_um"] = read_length(wavelength, "nm", "--wavelength")
    for entry in others or []:
        path, _, text = entry.partition("=")
        found[path.strip()] = read_camera_value(path.strip(), text)
    if pitch:
        found["lattice.pitch_um"] = read_pitch(pitch, found.get("sensor.pixel_um"))
    return found
