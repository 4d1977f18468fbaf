"""Pictures that share a view are measured one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.pages.simulate._influence_view import InfluenceView
from lfcal_gui.pages.simulate.model_influence import InfluencePictures
from lfcal_gui.widgets.measured_part import entries_at


def test_slices_of_a_volume_are_measured(qtbot: QtBot, tmp_path: Path) -> None:
    """A right click offered copying and saving of the whole view only."""
    view = VolumeView()
    qtbot.addWidget(view)
    view.resize(600, 500)
    view.show()
    volume = np.random.default_rng(0).random((3, 20, 30)).astype(np.float32)
    parts = tuple(view.parts.values())
    assert not view.parts["xy"].entries(), "there is nothing to measure yet"
    view.set_volume(volume)
    view.set_cross(z=1, y=5, x=7)
    QApplication.processEvents()
    for name, wanted in (("xy", volume[1]), ("xz", volume[:, 5]), ("yz", volume[:, :, 7].T)):
        part = view.parts[name]
        np.testing.assert_array_equal(part.measured(), wanted)
        point = view.graphics.mapFromScene(part.plot.sceneBoundingRect().center())
        offered = dict(entries_at(view.graphics, parts, point))
        assert list(offered) == ["Contrast, profile, region …", "Copy values", "Save data …"]
        offered["Copy values"]()
        assert len(QApplication.clipboard().text().splitlines()) == wanted.shape[0]
    part = view.parts["xy"]
    part.save_data(str(tmp_path / "slice.npy"))
    np.testing.assert_array_equal(np.load(tmp_path / "slice.npy"), volume[1])
    window = part.measure()
    assert "FWHM" in window.profile_words.text() and window.region_words.text()
    window.handles.setRegion((0.25, 0.5))
    assert part.shown_levels() == (0.25, 0.5) == view.bar.levels()
    view.set_cross(z=2)
    assert part.shown_levels() == (0.25, 0.5), "contrast stays with the next slice"
    part.set_contrast(None)
    assert view.bar.levels() != (0.25, 0.5)
    window.close()
    view.set_volume(None)
    assert part.measured() is None


def test_pictures_of_an_effect_are_measured_with_one_contrast(qtbot: QtBot) -> None:
    view = InfluenceView()
    qtbot.addWidget(view)
    rng = np.random.default_rng(1)
    first, second = (rng.random((9, 11)).astype(np.float32) for _ in range(2))
    view.show_influence(
        InfluencePictures(first, second, (-4, -5), ("column s", "row t"), "share of the light", "computed")
    )
    without, with_it, difference = view.parts
    np.testing.assert_array_equal(with_it.measured(), second)
    assert with_it.placed() == ((-4.0, -5.0), 1.0)
    without.set_contrast((0.1, 0.2))
    assert with_it.shown_levels() == (0.1, 0.2) == view.bars[0].levels()
    assert difference.shown_levels()[1] == pytest.approx(-difference.shown_levels()[0])
    view.show_influence(None, "nothing")
    assert not difference.entries()
