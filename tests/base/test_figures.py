"""Figures as files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.base.figures import LINES, figure, save_figure
from tests.pictures import laid_out, not_laid_out


@pytest.mark.long
def test_few_colours_make_a_smaller_file_of_the_same_picture(tmp_path: Path) -> None:
    x = np.linspace(0, 6, 200)
    with figure(6, 4) as fig:
        axes = fig.subplots()
        for k, colour in enumerate(LINES):
            axes.plot(x, np.sin(x + k), color=colour)
        save_figure(fig, tmp_path / "all.png")
        save_figure(fig, tmp_path / "few.png", colours=64)
    whole, few = (cv2.imread(str(tmp_path / name)).astype(float) for name in ("all.png", "few.png"))
    assert len(np.unique(few.reshape(-1, 3), axis=0)) <= 64 < len(np.unique(whole.reshape(-1, 3), axis=0))
    assert np.abs(few - whole).mean() < 1 and np.abs(few - whole).max() < 80
    assert (tmp_path / "few.png").stat().st_size < 0.5 * (tmp_path / "all.png").stat().st_size


def test_what_is_drawn_fits_into_the_figure(tmp_path: Path) -> None:
    """Long labels are inside: without a layout the sheet's border cuts them."""
    borders = []
    for how in (laid_out, not_laid_out):
        with how(), figure(3, 2) as fig:
            axes = fig.subplots()
            axes.set_ylabel("light of the pattern\nin thousands of electrons\nbeyond the background")
            save_figure(fig, tmp_path / "a.png")
        picture = cv2.imread(str(tmp_path / "a.png"))
        borders.append(float((picture[:, :2] < 250).mean()))
    assert borders[0] == 0 < borders[1]
