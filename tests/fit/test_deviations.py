"""Changes of H along the axes of a fit's covariance have the covariance that the parameters imply."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.fit import Setup, iter_write_deviations, measured_of
from lfcal.fit.files import iter_write_fit
from lfcal.fit.model import Fineness, predict
from lfcal.psf import PSFMatrix, open_psf
from lfcal.work import RunChoice
from tests.fit.commands import undrawn
from tests.fit.common import few_fit, few_patterns


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a fit of gap, rotation and offset, with its H."""
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch)
        out = tmp_path_factory.mktemp("fit")
        drain(iter_write_fit(few_fit(), measured_of(few_patterns()), out, {}))
    return out


def light_of(setup: Setup) -> np.ndarray:
    """Return H of a setup as fractions of its light."""
    plan = few_fit().planned
    index = np.argwhere(np.ones(plan.shape[:3], bool))
    values = predict(setup, plan, index, np.zeros((len(index), 2)), Fineness.coarse).astype(np.float64)
    return (values / values.sum()).reshape(plan.shape)


def changed(name: str, by: float) -> Setup:
    """Return the fitted setup with one parameter changed."""
    fit = few_fit()
    lattice = fit.camera.lattice
    x, y = lattice.offset_um
    if name == "gap_um":
        moved = replace(lattice, gap_um=lattice.gap_um + by)
    elif name == "rotation_rad":
        # the array is rotated about the middle of the region
        (u, v), c, s = fit.middle_um, np.cos(by), np.sin(by)
        about = (u + c * (x - u) - s * (y - v), v + s * (x - u) + c * (y - v))
        moved = replace(lattice, rotation_rad=lattice.rotation_rad + by, offset_um=about)
    else:
        dy, dx = (by, 0.0) if name == "offset_y_um" else (0.0, by)
        moved = replace(lattice, offset_um=(x + dx, y + dy))
    return replace(fit.ideal_places, camera=replace(fit.camera, lattice=moved))


def test_their_squares_add_up_to_the_variance_of_every_entry(folder: Path) -> None:
    fit = few_fit()
    with open_psf(folder / "H.h5") as H, open_psf(drain(iter_write_deviations(folder, H, workers=1))) as found:
        axes = np.asarray(found[:], np.float64).reshape(-1, *H.shape)
    names, sigmas = list(fit.parameters), [one.sigma_held for one in fit.parameters.values()]
    assert names == ["gap_um", "rotation_rad", "offset_y_um", "offset_x_um"]
    slopes = [
        (light_of(changed(name, sigma)) - light_of(changed(name, -sigma))) / 2
        for name, sigma in zip(names, sigmas, strict=True)
    ]
    variance = np.einsum("ab,a...,b...->...", fit.correlations, slopes, slopes)
    np.testing.assert_allclose(np.square(axes).sum(0), variance, rtol=0.02, atol=1e-3 * variance.max())
    assert abs(axes.sum((1, 2, 3, 4, 5))).max() < 1e-6 * np.abs(axes).sum()


def test_they_are_computed_once_and_alike_in_units(folder: Path) -> None:
    with open_psf(folder / "H.h5") as H:
        path = drain(iter_write_deviations(folder, H, workers=1))
        made = path.stat().st_mtime_ns
        assert drain(iter_write_deviations(folder, H, workers=1)) == path and path.stat().st_mtime_ns == made
        with open_psf(path) as file:
            here = file[:]
        path.unlink()
        drain(iter_write_deviations(folder, H, run=RunChoice("threads", workers=1)))
        with open_psf(path) as file:
            np.testing.assert_array_equal(file[:], here)
        # a damaged file, then another fit in the same folder
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        drain(iter_write_deviations(folder, H, workers=1))
        with open_psf(path) as file:
            np.testing.assert_array_equal(file[:], here)
        made = path.stat().st_mtime_ns
        numbers = json.loads((folder / "fit.json").read_text())
        (folder / "fit.json").write_text(json.dumps(numbers | {"fitted": "later"}))
        drain(iter_write_deviations(folder, H, workers=1))
        assert path.stat().st_mtime_ns != made


def test_an_h_of_another_scan_is_refused(folder: Path) -> None:
    own = few_patterns()
    other = PSFMatrix(np.ones(own.shape), depths=[d + 100 for d in own.depths], anchor=own.anchor)
    with pytest.raises(InputError, match="give the folder of the fit of this scan"):
        drain(iter_write_deviations(folder, other))
