"""The default plot of an H file, found by the rules of NeXus alone, as a viewer finds it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.psf import PSFMatrix, open_psf, save, save_regions

SHAPE = (2, 3, 4, 5, 7)


class Axis(NamedTuple):
    name: str
    values: NDArray[Any]
    units: str
    label: str


class Plot(NamedTuple):
    signal: NDArray[Any]
    label: str
    title: str
    axes: list[Axis]


def default_plot(path: Path) -> Plot:
    """Read a NeXus file: https://manual.nexusformat.org/datarules.html, version 3 of associating axes with data."""
    with h5py.File(path) as file:
        group: Any = file
        classes = []
        while True:
            classes.append(group.attrs["NX_class"])
            if "default" not in group.attrs:
                break
            name = group.attrs["default"]
            assert "/" not in name and isinstance(group[name], h5py.Group)
            group = group[name]
        assert classes == ["NXroot", "NXentry", "NXdata"]
        return read_data(group)


def read_data(group: Any) -> Plot:
    signal = group[group.attrs["signal"]]
    names = [name.decode() if isinstance(name, bytes) else name for name in group.attrs["axes"]]
    assert len(names) == signal.ndim
    axes = []
    for k, name in enumerate(names):
        scale = group[name]
        assert scale.shape == (signal.shape[k],) and int(group.attrs[f"{name}_indices"]) == k
        assert scale.dtype.kind in "iuf"
        axes.append(Axis(name, scale[()], scale.attrs["units"], scale.attrs["long_name"]))
    return Plot(signal[()], signal.attrs["long_name"], group["title"][()].decode(), axes)


@pytest.mark.parametrize("name", ["H", "HT"])
def test_viewers_open_the_depth_sums_with_their_axes(tmp_path: Path, name: str) -> None:
    values = np.random.default_rng(0).random(SHAPE).astype("f4")
    H = PSFMatrix(values, depths=[-20.0, 35.0])
    save(H if name == "H" else H.T, tmp_path / "H.h5")
    plot = default_plot(tmp_path / "H.h5")
    whole = np.asarray(H if name == "H" else H.T)
    np.testing.assert_allclose(plot.signal, whole.sum((1, 2), dtype=float))
    assert plot.title.startswith(f"{name}: ") and plot.label == f"{name} summed over all positions"
    depth, row, column = plot.axes
    assert depth.values.tolist() == [-20.0, 35.0] and depth.units == "um" and "depth" in depth.label
    assert row.values.tolist() == [-2, -1, 0, 1, 2] and column.values.tolist() == [-3, -2, -1, 0, 1, 2, 3]
    assert row.units == column.units == "px" and "row" in row.label and "column" in column.label


def test_h_itself_is_a_plot_beside_them(tmp_path: Path) -> None:
    save(PSFMatrix(np.ones(SHAPE, "f4")), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        plot = read_data(file["entry/H"])
    assert plot.signal.shape == SHAPE and [axis.name for axis in plot.axes] == ["depths", "y", "x", "t", "s"]


def test_every_link_is_hard_and_the_file_opens(tmp_path: Path) -> None:
    matrix = PSFMatrix(np.ones(SHAPE, "f4"))
    save_regions({"middle": matrix, "corner": matrix}, tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        kinds: list[type] = []
        file.visit(lambda name: kinds.append(type(file.get(name, getlink=True))))
        assert set(kinds) == {h5py.HardLink}
        assert file["entry/depth_sum/depth_sum"] == file["depth_sum"], "a link, not a copy"
    assert default_plot(tmp_path / "H.h5").signal.shape == (2, 5, 7)
    with open_psf(tmp_path / "H.h5", region="corner", check=True) as H:
        assert H.shape == SHAPE
