"""The aperture of a plane in words: as it is fitted, beside what the camera lets expect. No Qt."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from lfcal.base import format_length
from lfcal.psf import PSFMatrix
from lfcal_gui.models import plane_words

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture

__all__ = ["aperture_tip", "aperture_words", "expected_in"]

UNKNOWN = "—"
SMALL = "style='font-size:9pt'"
GAP = "style='padding-right:6px'"


def expected_in(matrix: PSFMatrix, z: int) -> Aperture | None:
    """Return the aperture that the camera lets expect in plane ``z``, None where no camera is known."""
    from lfcal.psf.aperture import expected_aperture

    if matrix.camera is None:
        return None
    return expected_aperture(matrix.camera, float(matrix.depths[z]), matrix.cutout, matrix.pixel_scale)


MAIN = ("Shape", "Blades", "Rotation", "Apothem", "Confidence")
"""Numbers that matter most."""


def aperture_words(aperture: Aperture, expected: Aperture | None = None, names: Collection[str] = MAIN) -> str:
    """Return numbers of a fitted aperture as rich text, next to those that are expected; all for no ``names``.

    What the fit refuses to say comes first.
    """
    from lfcal.psf.aperture import REFUSALS

    refused = f"<p><b>{aperture.refusal}</b>: {REFUSALS[aperture.refusal]}</p>" if aperture.refusal else ""
    if aperture.confident and aperture.fault:
        refused = f"<p><b>{aperture.fault}</b></p>"
    found = {name: value for name, value in _numbers(aperture).items() if not names or name in names}
    if expected is None:
        cells = "".join(f"<tr><td {GAP}>{name}</td>{_value(value)}</tr>" for name, value in found.items())
        return f"{refused}<table cellspacing='0' cellpadding='0' {SMALL}>{cells}</table>"
    there = {name: _bare(text) for name, text in _numbers(expected).items()}
    there |= dict.fromkeys(("Edge blur", "Ellipticity", "Confidence"), UNKNOWN)
    head = f"<tr><td></td><td {GAP}>fitted</td><td>expected</td></tr>"
    rows = "".join(
        f"<tr><td {GAP}>{name}</td>{_value(value)}<td>{there[name]}</td></tr>" for name, value in found.items()
    )
    return f"{refused}<table cellspacing='0' cellpadding='0' {SMALL}>{head}{rows}</table>"


def _bare(text: str) -> str:
    """Return a number without the unit that its neighbour has as well."""
    return text.removesuffix(" px").removesuffix(" px²")


def _value(text: str) -> str:
    # a number stays in one line, words need not
    wrap = "normal" if text[0].isalpha() else "nowrap"
    return f"<td style='white-space:{wrap}; padding-right:6px'><b>{text}</b></td>"


def _numbers(aperture: Aperture) -> dict[str, str]:
    from lfcal.psf.aperture import KINDS, with_error

    row, column = aperture.centre
    # a count that is refused is none to be named
    told = aperture.confident and aperture.blades > 0
    sigma = aperture.curvature_sigma
    error = f" ± {sigma:.2f}" if np.isfinite(sigma) and sigma > 0 else ""

    def seen(text: str) -> str:  # where no outline is to be seen, nothing of it was measured
        return text if aperture.seen else UNKNOWN

    return {
        "Shape": KINDS[aperture.kind],
        "Blades": f"{aperture.blades}" if told else UNKNOWN,
        "Rotation": f"{np.degrees(aperture.rotation_rad):.1f}°" if told else UNKNOWN,
        "Centre t": seen(f"{row:.2f} px"),
        "Centre s": seen(f"{column:.2f} px"),
        "Apothem": seen(f"{with_error(aperture.apothem_px, aperture.apothem_sigma_px, 2)} px"),
        "Area": seen(f"{with_error(aperture.area_px2, aperture.area_sigma_px2, 0)} px²"),
        "Curvature": f"{aperture.curvature:.2f}{error}" if told else UNKNOWN,
        "Edge blur": seen(f"{aperture.blur_px:.2f} px"),
        "Ellipticity": seen(f"{100 * aperture.ellipticity:.1f} %"),
        "Confidence": f"{100 * aperture.confidence:.0f} %" if aperture.confident else UNKNOWN,
    }


def aperture_tip(z: int, depth_um: float, count: int, fitted: Aperture | None, expected: Aperture | None) -> str:
    """Return what is known of the aperture of plane ``z`` of ``count`` planes, in lines."""
    told = [plane_words(z, count) + (f": z = {format_length(depth_um)}" if math.isfinite(depth_um) else "")]
    told += [f"{what}: {one.describe()}" for what, one in (("fitted", fitted), ("expected", expected)) if one]
    return "\n".join(told)
