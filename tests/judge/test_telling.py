"""Pictures of faults, drawn."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest

from lfcal.base.figures import figure
from lfcal.judge.fault import FaultPicture
from lfcal.judge.telling import draw_picture, drawn


def test_a_map_is_numbered_from_its_origin() -> None:
    values = np.zeros((5, 7))
    picture = FaultPicture(values, "%", "what is left", ("down (px)", "across (px)"), origin=(-2, -3))
    with figure(3, 2) as fig:
        axes = fig.add_subplot()
        draw_picture(axes, picture)
        left, right, bottom, top = axes.images[0].get_extent()
        assert (top, bottom, left, right) == (-2.5, 2.5, -3.5, 3.5)
        assert (axes.get_title(), axes.get_ylabel(), axes.get_xlabel()) == ("what is left", "down (px)", "across (px)")


@pytest.mark.parametrize("across", [None, np.array([10.0, 20.0, 40.0])])
def test_a_curve_has_its_abscissa_and_units(across: np.ndarray | None) -> None:
    values = np.array([1.0, 3.0, 2.0])
    with figure(3, 2) as fig:
        axes = fig.add_subplot()
        draw_picture(axes, FaultPicture(values, "counts", "mean value", ("light (counts)",), across))
        line = axes.lines[0]
        np.testing.assert_array_equal(line.get_xdata(), range(3) if across is None else across)
        np.testing.assert_array_equal(line.get_ydata(), values)
        assert (axes.get_title(), axes.get_ylabel(), axes.get_xlabel()) == ("mean value", "counts", "light (counts)")


def test_what_is_drawn_is_a_png() -> None:
    png = drawn(FaultPicture(np.eye(4), "%", "light", ("row (px)", "column (px)")))
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.std() > 0 and io.BytesIO(png).read(4) == b"\x89PNG"
