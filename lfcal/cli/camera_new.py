"""``lfcal camera new``: make a camera file by questions and answers, or by options."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from lfcal.base import InputError, any_of
from lfcal.camera import PRESETS, Draft, Marks, preset, quantities_of, read_camera_value, read_pitch, value_at
from lfcal.cli._camera_values import with_values
from lfcal.cli._console import report
from lfcal.cli._options import ForceOption, JsonOption
from lfcal.tasks import check_output

KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "multifocus": ("MainLens", {"lattice.kind": "hexagonal", "lattice.focus": (2.0, 3.0, 5.0)}),
    "focused": ("MainLens", {"lattice.kind": "hexagonal", "lattice.focus": (3.0,)}),
    "microscope": ("Microscope", {"lattice.kind": "square", "lattice.focus": (float("inf"),)}),
    "fourier": ("FourierMicroscope", {}),
}
"""Kinds of cameras with their optics and assumed lenslet values."""

UNASKED = ("lattice.row_pitch_um", "lattice.rotation_rad", "lattice.offset_um", "lattice.type_step", "lattice.clear_um")
"""Values that are not asked for, because a white image measures them more accurately."""


@with_values
def command(
    out: Path = typer.Option(..., "-o", "--out", help="Camera file to write."),
    *,
    kind: str = typer.Option(
        "",
        "--type",
        help="Kind of camera: multifocus (three lens types), focused (one lens type), microscope, or fourier (Fourier "
        "light-field microscope).",
    ),
    start: str = typer.Option("", "--preset", help="Preset to start from."),
    name: str = typer.Option("", help="Name of the camera; default: the name of the file."),
    values: dict[str, Any],
    yes: bool = typer.Option(False, "--yes", "-y", help="Do not ask; assume the values that no option states."),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Describe a camera by answering questions (Enter keeps a value and marks it as assumed), or by options.

    Example: `lfcal camera new --type multifocus --sensor 4384x6576,5.5 --lens 200,4,1000 --pitch 31.7px -o camera.json`
    """
    from lfcal.cli.camera import save_camera

    check_output(out, force=force)
    if not yes and not sys.stdin.isatty():
        raise InputError(
            "camera new: there is no terminal for questions; add --yes to assume values that no option states"
        )
    draft = _begin(kind, start, values, ask=not yes)
    title = name or out.stem
    if not yes:
        draft = _ask(draft, title, set(values))
    save_camera(draft.camera(title), out, force=force, json=json)


def _begin(kind: str, start: str, values: dict[str, Any], *, ask: bool) -> Draft:
    """Return a draft with the values of the options, completed by a preset or a kind of camera."""
    if start:
        if kind:
            raise InputError("camera new: give --type or --preset, not both")
        camera = preset(start)
        # a preset is another camera: none of its values is known for this one
        paths = {quantity.path: "assumed" for quantity in quantities_of(camera)}
        return Draft.of(replace(camera, marks=Marks.of(paths)), values)
    if not kind and ask:
        kind = typer.prompt(f"Kind of camera ({', '.join(KINDS)})", default="multifocus")
    if kind not in KINDS:
        names = f"--type {any_of(KINDS)}, or --preset {any_of(PRESETS)}"
        raise InputError.expected("camera new", names, repr(kind), "choose the kind of your camera")
    optics, assumed = KINDS[kind]
    draft = Draft(optics, values)
    for path, value in assumed.items():
        draft.put(path, value, "assumed")
    return draft


def _ask(draft: Draft, title: str, given: set[str]) -> Draft:
    """Ask for each geometric value that no option states; an answer is marked as stated, Enter leaves it assumed."""
    typer.echo(
        "Press Enter to keep the value in brackets; it is then marked as assumed. "
        "Lengths may have a unit: nm, um or mm."
    )
    # the sensor first: a pitch in pixels needs its pixel size
    order = sorted(quantities_of(draft.camera(title)), key=lambda quantity: not quantity.path.startswith("sensor."))
    for quantity in order:
        path = "lattice.focus" if quantity.path == "lattice.types" else quantity.path
        if quantity.light or path in UNASKED or path in given:
            continue
        while (answer := _answer(draft, title, quantity.path)) is not None:
            try:
                draft = _with(draft, title, path, answer)
                break
            except InputError as error:
                report(str(error))
    return draft


def _with(draft: Draft, title: str, path: str, answer: str) -> Draft:
    """Return the draft with an answer; raise an error if the answer is invalid, alone or with other values."""
    pixel = draft.get("sensor.pixel_um")
    value = read_pitch(answer, pixel) if path == "lattice.pitch_um" else read_camera_value(path, answer)
    changed = draft.copy()
    changed.state(path, value)
    changed.camera(title)
    return changed


def _answer(draft: Draft, title: str, path: str) -> str | None:
    """Return the text typed for ``path``; None for Enter."""
    camera = draft.camera(title)
    quantity = next(q for q in quantities_of(camera) if q.path == path)
    label, shown = quantity.label, quantity.text(value_at(camera, path))
    if path == "lattice.types":
        label = "virtual depths in focus, one per lens type"
        shown = ", ".join(f"{kind.focus_depth(camera.lattice.gap_um):.4g}" for kind in camera.lattice.types)
    unit = {1e3: "mm", 1e-3: "nm"}.get(quantity.scale, quantity.unit)
    answer: str = typer.prompt(f"{label} [{shown}]", default="", show_default=False).strip()
    if not answer:
        return None
    bare = answer[-1].isdigit() or answer[-1] == "."
    return f"{answer}{unit}" if bare and unit in ("mm", "nm") else answer
