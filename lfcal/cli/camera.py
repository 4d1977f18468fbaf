"""``lfcal camera``: describe a camera, show which of its values are known, and check it against a white image."""

from __future__ import annotations

import pkgutil
from pathlib import Path
from typing import Any

import typer

import lfcal.cli
from lfcal.base import write_text
from lfcal.camera import Camera, derived_of, doubts, quantities_of, value_at
from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._lazy import add_command
from lfcal.tasks import assumed_in_words, check_output

__all__ = ["as_json", "print_camera", "register", "save_camera"]


def register(app: typer.Typer) -> None:
    """Add ``camera`` and its subcommands, which are in the modules ``camera_*``, to ``app``."""
    camera_app = typer.Typer(
        help="Describe a camera, show which of its values are known, and check it against a white image.",
        epilog="Example: `lfcal camera show r29_calibration.xml`",
        no_args_is_help=True,
    )
    for name in sorted(module.name for module in pkgutil.iter_modules(lfcal.cli.__path__)):
        if name.startswith("camera_"):
            add_command(camera_app, f"lfcal.cli.{name}", name.removeprefix("camera_"))
    app.add_typer(camera_app, name="camera")


def print_camera(camera: Camera) -> None:
    """Print the values of ``camera`` with their sources, the derived quantities, and any doubts."""
    rows = [
        [quantity.label, quantity.text(value_at(camera, quantity.path)), camera.marks[quantity.path]]
        for quantity in quantities_of(camera)
    ]
    if camera.distortion is not None:
        shown = ", ".join(f"{k:g}" for k in camera.distortion.coefficients)
        rows.append(["manufacturer's distortion (Brown)", f"{shown}: kept, not applied", "stated"])
    if camera.has_lattice and (found := camera.lattice.distortion) is not None:
        shown = f"{found.model} of degree {found.degree}, up to {found.largest / camera.sensor.pixel_um:.2f} px"
        rows.append(["distortion of the lattice", shown, camera.marks["lattice.distortion"]])
    print_table(["value", "", "from"], rows, title=f"camera {camera.name}")
    follows = [[one.label, one.text, "from assumed values" if one.assumed else ""] for one in derived_of(camera)]
    print_table(["derived quantity", "", ""], follows)
    for doubt in doubts(camera):
        report(f"warning: {doubt}")


def as_json(camera: Camera) -> dict[str, Any]:
    """Return ``camera``, the paths of its assumed values, doubts and derived quantities as plain values for JSON."""
    return {
        "camera": camera.to_dict(),
        "assumed": camera.marks.paths("assumed"),
        "doubts": doubts(camera),
        "derived": {
            item.label.strip(): {"value": item.value, "unit": item.unit, "assumed": item.assumed}
            for item in derived_of(camera)
        },
    }


def save_camera(camera: Camera, out: Path | None, *inputs: Path | str | None, force: bool, json: bool) -> None:
    """Write ``camera`` to ``out``, unless that is None, and print its values and which of them are assumed.

    An existing file is replaced only with ``force``, and never one of ``inputs``. With ``json``, the values are printed
    as JSON.
    """
    derived_of(camera)  # a camera that allows no calculation is refused before it is written
    if out is not None:
        check_output(out, *inputs, force=force)
        write_text(out, camera.to_json())
    if json:
        print_json({**as_json(camera), "written": out})
        return
    print_camera(camera)
    if assumed := assumed_in_words(camera):
        report(f"note: assumed: {assumed}")
    typer.echo("nothing written; add -o camera.json" if out is None else f"written: {out}")
