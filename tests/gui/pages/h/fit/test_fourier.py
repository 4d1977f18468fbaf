"""The fit of a Fourier light-field microscope in the window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan
from lfcal.psf import Facts, PSFMatrix, save
from lfcal.simulate import simulate_psf
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.h.model_fit import FitSettings
from lfcal_gui.pages.h.page import Page
from tests.cli._building import CENTRES, DEPTHS
from tests.cli._building import fourier_camera as camera_of
from tests.gui.waiting import idle


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    """Return a project with H of two lenslets, of which the first is 6 µm off in the described camera."""
    plan = ScanPlan.for_camera(camera_of(), depths_um=DEPTHS, cutout=(121, 131))
    light = np.asarray(simulate_psf(plan, (), tolerance=0.02))
    clean = 4e3 * light / light.max()
    values = np.random.default_rng(0).poisson(clean).astype(np.float32)
    noise = np.broadcast_to([1.0, 1.0], (*plan.shape[:3], 2)).astype(np.float32)
    facts = Facts.of(plan.shape[:3], plan.cutout, noise=noise)
    described = camera_of(((-216.0, 20.0), CENTRES[1]))
    save(PSFMatrix(values, depths=DEPTHS, camera=described, anchor=plan.anchor, facts=facts), tmp_path / "H.h5")
    made = replace(ProjectState(), psf=str(tmp_path / "H.h5"))
    settings = FitSettings(auto=False, groups=("geometry", "lens_centres"))
    return replace(made, settings=settings.into(made))


def test_the_lenslets_of_an_h_are_fitted(page: Page, qtbot: QtBot) -> None:
    view = page.fitting.view
    assert view.choices.source.text() == "H.h5: all 3 positions recorded, 3 planes"
    view.fit_button.click()
    idle(page.context.jobs, qtbot)
    found = page.fitting.found
    assert found is not None, page.context.jobs.jobs()[0].error
    fit = found.fit
    # the group that needs a lattice is not asked for
    assert fit.groups == ("lens_centres",)
    first = fit.parameters["lenslet_0_x_um"]
    assert first.value == pytest.approx(CENTRES[0][0], abs=4.5 * first.sigma) and first.sigma < 1.0
    assert "explains the patterns" in view.verdict.text()
    page.set_intent(z=1, y=0, x=0)
    readout = page.panel.readout.text()
    assert "χ²" in readout and "v =" not in readout, "there is no virtual depth"
    np.testing.assert_array_equal(page.panel.fitted.residual.values, fit.residual(1, 0, 0))
