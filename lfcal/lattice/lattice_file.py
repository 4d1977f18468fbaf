"""Files of a measured lattice: ``lattice.json``, which can be read again, and its residuals as a table and a plot."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import (
    FileFormatError,
    InputError,
    check_choice,
    check_number,
    check_tuple,
    check_type,
    figure,
    parse_json,
    read_text,
    save_figure,
    stated_format,
    write_text,
)
from lfcal.camera import LatticeDistortion
from lfcal.lattice._model import MIN_PITCH, check_row_pitch
from lfcal.lattice.lattice_fit import LatticeFit

__all__ = ["lattice_dict", "lattice_files", "load_lattice", "save_lattice"]

LATTICE_FORMAT, LATTICE_VERSION = "lfcal-lattice", 1
NAMES = (
    *("kind", "shape", "pitch_px", "row_pitch_px", "rotation_rad", "shear_rad", "origin_px", "pitch_error_px"),
    *("residual_rms_px", "form", "reason", "notes"),
)
"""Attributes of a fit that are written under the same names."""

REMEDY = "write it with lfcal white"
MAX_SIDE_PX = 20_000
MAX_ANGLE_RAD = 4.0


def lattice_files(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the paths of the files that `save_lattice` writes: lattice, residuals, and a map of the residuals."""
    return [Path(folder) / name for name in ("lattice.json", "residuals.csv", "residuals.png")]


def save_lattice(fit: LatticeFit, folder: str | os.PathLike[str]) -> list[Path]:
    """Write the lattice (JSON), the residual of every lenslet (CSV) and a residual map (PNG); return their paths.

    The files are written to ``folder``. Residuals of dead lenslets are left empty.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import fit_lattice, save_lattice
    >>> files = save_lattice(fit_lattice(read_image("session/white/white_0.png"), dark=64.0), "lattice")
    >>> print([path.name for path in files])
    ['lattice.json', 'residuals.csv', 'residuals.png']
    """
    check_row_pitch(fit.row_pitch_px)
    facts = {"format": LATTICE_FORMAT, "version": LATTICE_VERSION, **lattice_dict(fit)}
    files = lattice_files(folder)
    for path, text in zip(files, (json.dumps(facts, indent=2, allow_nan=False), _table(fit)), strict=False):
        write_text(path, text)
    _draw(fit, files[2])
    return files


def lattice_dict(fit: LatticeFit) -> dict[str, Any]:
    """Return the parameters of the lattice, their errors, the distortion and the dead lenslets as plain JSON types."""
    bend, errors = fit.distortion, {} if fit.errors is None else asdict(fit.errors)
    errors.pop("covariance", None)
    own = {name: getattr(fit, name) for name in NAMES}
    own["distortion"] = None
    if bend is not None:
        own["distortion"] = {
            "model": bend.model,
            "centre_px": bend.centre,
            "scale_px": bend.scale,
            "terms_px": bend.terms,
        }
    own["outline_px"] = None if fit.outline_px is None else np.round(fit.outline_px, 2).tolist()
    own["errors"] = None
    if errors:
        centre, terms = errors.pop("centre"), errors.pop("terms")
        own["errors"] = errors | {"distortion_centre_px": centre, "distortion_terms_px": terms}
    return own | {"lenslets": len(fit.index), "dead": fit.dead_lenslets}


def _table(fit: LatticeFit) -> str:
    """Return a line for each lenslet: indices, best estimate of the position, and residual (empty for dead ones)."""
    lattice = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    places = lattice if fit.places_px is None else fit.places_px
    residual = fit.measured_px - lattice
    lines = ["q,r,row_px,column_px,residual_row_px,residual_column_px,light,dead"]
    for k, (q, r) in enumerate(fit.index):
        left = ("", "") if fit.dead[k] else tuple(f"{v:.5f}" for v in residual[k])
        at = ",".join(f"{v:.5f}" for v in places[k])
        lines.append(f"{q},{r},{at},{left[0]},{left[1]},{fit.light[k]:.6g},{int(fit.dead[k])}")
    return "\n".join(lines) + "\n"


def _draw(fit: LatticeFit, path: Path) -> None:
    left = fit.residual_map()
    limit = max(float(np.nanpercentile(np.abs(left), 99)), 1e-3)
    rows, columns = fit.shape
    with figure(9.0, 3.6) as fig:
        panels = fig.subplots(1, 2)
        for panel, values, name in zip(panels, left, ("down", "to the right"), strict=True):
            shown = panel.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(0, columns, rows, 0))
            panel.set_title(f"residual {name} (px)")
            panel.set_xlabel("column (px)")
            panel.set_ylabel("row (px)")
            fig.colorbar(shown, ax=panel, shrink=0.8)
        save_figure(fig, path)


def load_lattice(path: str | os.PathLike[str]) -> LatticeFit:
    """Read a lattice, with all lenslets of its frame including dead ones, from a ``lattice.json`` file.

    The file does not contain the located centres and the light of the lenslets; they are NaN.

    Raises
    ------
    FileFormatError
        If the file does not contain a lattice, or contains an invalid number.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import fit_lattice, load_lattice, save_lattice
    >>> path, *_ = save_lattice(fit_lattice(read_image("session/white/white_0.png"), dark=64.0), "lattice")
    >>> lattice = load_lattice(path)
    >>> print(lattice.kind, lattice.centres_px(0, 0).round(1))
    hexagonal [39.5 47.5]
    """
    data = parse_json(read_text(path), str(path), remedy=REMEDY)
    if not isinstance(data, dict) or (data.get("format"), data.get("version")) != (LATTICE_FORMAT, LATTICE_VERSION):
        raise FileFormatError.expected(
            str(path), f"{LATTICE_FORMAT} of version {LATTICE_VERSION}", stated_format(data), REMEDY
        )
    try:
        return _fit(data)
    except KeyError as error:
        raise FileFormatError.expected(str(path), f"an entry {error}", "none", REMEDY) from None
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _fit(data: dict[str, Any]) -> LatticeFit:
    check_choice("lattice", data["kind"], ("square", "hexagonal"))
    rows, columns = check_tuple("shape", data["shape"], 2, integer=True, at_least=1, at_most=MAX_SIDE_PX)
    numbers = {name: data[name] for name in ("pitch_px", "row_pitch_px", "rotation_rad", "shear_rad")}
    for name, value in numbers.items():
        low, high = (MIN_PITCH, MAX_SIDE_PX) if "pitch" in name else (-MAX_ANGLE_RAD, MAX_ANGLE_RAD)
        if name != "row_pitch_px":
            check_number(name, value, at_least=low, at_most=high)
    check_row_pitch(numbers["row_pitch_px"])
    for name in ("pitch_error_px", "residual_rms_px"):
        check_number(name, data[name], at_least=0)
    origin = check_tuple("origin_px", data["origin_px"], 2)
    check_type("dead", data["dead"], list)
    dead = [check_tuple("dead lenslet (q, r)", place, 2, integer=True) for place in data["dead"]]
    empty = np.zeros((0, 2))
    bare = LatticeFit(
        kind=data["kind"],
        shape=(rows, columns),
        origin_px=origin,
        pitch_error_px=data["pitch_error_px"],
        residual_rms_px=data["residual_rms_px"],
        index=empty.astype(np.intp),
        measured_px=empty,
        light=empty[:, 0],
        dead=np.zeros(0, bool),
        distortion=_distortion(data["distortion"]),
        form=str(data["form"]),
        reason=str(data["reason"]),
        outline_px=_outline(data.get("outline_px")),
        **numbers,
    )
    return _with_lenslets(bare, dead)


def _outline(corners: Any) -> Any:
    if corners is None:
        return None
    check_type("outline_px", corners, list)
    return np.array([check_tuple("corner of the outline (row, column)", corner, 2) for corner in corners])


def _distortion(data: Any) -> Any:
    if data is None:
        return None
    check_type("distortion", data, dict)
    return LatticeDistortion(data["model"], data["centre_px"], data["scale_px"], data["terms_px"])


def _with_lenslets(bare: LatticeFit, dead: list[tuple[Any, ...]]) -> LatticeFit:
    """Return the fit with all lenslets of its frame, without measurements, and with the dead ones marked."""
    index = bare.model.whole(bare.shape)
    gone = set(dead)
    nothing = np.full(index.shape, np.nan)
    marked = np.array([(int(q), int(r)) in gone for q, r in index], bool)
    return replace(bare, index=index, measured_px=nothing, light=nothing[:, 0], dead=marked)
