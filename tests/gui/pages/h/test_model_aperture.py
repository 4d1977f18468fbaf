"""What is said of an aperture."""

from __future__ import annotations

import numpy as np

from lfcal.psf.aperture import Aperture, fit_aperture
from lfcal_gui.pages.h.model import aperture_tip, aperture_words


def fitted(**changes: object) -> Aperture:
    known = {
        "kind": "polygon",
        "curvature": 0.12,
        "curvature_sigma": 0.03,
        "blur_px": 2.1,
        "confidence": 1.0,
        "confident": True,
    }
    return Aperture(7, (27.0, 26.5), 0.2, 15.27, 786.0, **(known | changes))  # type: ignore[arg-type]


def test_the_expected_numbers_stand_beside_the_fitted_ones() -> None:
    words = aperture_words(fitted(), Aperture(7, (27, 27), 0.2, 15.63, 823.0, confident=True, kind="polygon"), ())
    assert "expected" in words and "<b>15.27 px</b></td><td>15.63</td>" in words
    assert "<b>0.12 ± 0.03</b></td><td>0.00</td>" in words and "<b>2.10 px</b></td><td>—</td>" in words
    assert "expected" not in aperture_words(fitted())


def test_a_plane_in_a_few_lines() -> None:
    refused = fitted(confident=False, refusal="cut off", kind="")
    assert aperture_tip(1, -26_020.0, 2, refused, None) == (
        f"Plane 1 (0 to 1): z = -26.02 mm\nfitted: {refused.describe()}"
    )
    assert "reaches the edge" in refused.describe()


def test_of_what_is_not_seen_nothing_is_measured() -> None:
    dark = fit_aperture(np.zeros((31, 31)))
    words = aperture_words(dark, Aperture(7, (27, 27), 0.2, 15.63, 823.0, confident=True, kind="polygon"), ())
    assert "nan" not in words and "0.00 px" not in words and "0.0 %" not in words
    assert words.count("<b>—</b>") >= 6
