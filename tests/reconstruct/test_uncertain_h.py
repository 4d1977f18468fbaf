"""The uncertainty of H, in frames that are drawn from it, and in sums over regions."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import drain
from lfcal.base.errors import InputError
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import BootstrapSettings, Projector, RegionSum, SolverChoice, VoxelGrid, error_bars
from lfcal.reconstruct._uncertain_h import UncertainH
from lfcal.reconstruct.bar_run import iter_bars
from lfcal.reconstruct.frame_run import FrameRun
from lfcal.reconstruct.optics import SharedOptics
from lfcal.records import LightFieldSettings, ProjectionSettings
from lfcal.work import RunChoice
from tests.reconstruct.oracles import dense

SHAPE = (16, 18)
AT = (2, 1)


def matrices(tmp_path: Path) -> tuple[PSFMatrix, np.ndarray, Path]:
    """Return H of two planes, its changes along three axes per unit of light, and their file."""
    rng = np.random.default_rng(1)
    H = rng.random((2, 3, 4, 5, 7))
    changes = rng.standard_normal((3, *H.shape))
    save(PSFMatrix(changes.reshape(-1, *H.shape[1:]), anchor=AT), tmp_path / "changes.h5")
    return PSFMatrix(H, anchor=AT), changes, tmp_path / "changes.h5"


def test_drawn_frames_are_those_of_a_drawn_h(tmp_path: Path) -> None:
    """The image is that of a dense matrix, in which the changes of each plane are multiplied by its light."""
    H, changes, file = matrices(tmp_path)
    volume = np.random.default_rng(2).random((2, *SHAPE))
    values, light = np.asarray(H[:]), np.asarray(H[:]).sum((1, 2, 3, 4))
    with ExitStack() as stack:
        P = Projector(H, SHAPE, workers=1)
        uncertain = UncertainH.of(P, H, file, stack, 1)
        steps = np.random.default_rng(3).standard_normal(3)
        drawn = values + np.einsum("k,kz...,z->z...", steps, changes, light)
        expected = (dense(drawn, SHAPE, AT) @ volume.ravel()).reshape(SHAPE)
        found = uncertain(np.random.default_rng(3)).forward(volume)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
        modes = uncertain.modes(volume)
        np.testing.assert_allclose(P.forward(volume) + np.tensordot(steps, modes, 1), found, rtol=1e-3)
        other = PSFMatrix(np.ones((2, 3, 4, 5, 5)))
        with pytest.raises(InputError, match="changes of all planes of this H"):
            UncertainH.of(P, other, file, stack, 1)


def test_changes_are_opened_before_the_volume_is_reconstructed(tmp_path: Path) -> None:
    """Changes of another H, or too little memory for them, were reported after the volume was reconstructed."""
    H, _, _ = matrices(tmp_path)
    save(H, tmp_path / "H.h5")
    save(PSFMatrix(np.ones((3, 3, 4, 5, 7)), anchor=AT), tmp_path / "other.h5")
    np.save(tmp_path / "frame.npy", np.random.default_rng(1).poisson(50, SHAPE))
    before = sorted(tmp_path.iterdir())
    optics = SharedOptics(tmp_path / "H.h5", (), "", LightFieldSettings(), ProjectionSettings())
    choice, settings = SolverChoice("rl", iterations=2, gain=1), BootstrapSettings(replicates=3)
    with ExitStack() as stack:
        run = FrameRun.of(tmp_path / "frame.npy", optics.open(stack), optics, choice, VoxelGrid(margin=0))
        how = RunChoice("threads", 1)
        work = iter_bars(run, tmp_path / "v.npy", settings, None, how, {}, changes=tmp_path / "other.h5")
        with pytest.raises(InputError, match="changes of all planes of this H"):
            drain(work)
    assert sorted(tmp_path.iterdir()) == before


def region(imaging: object, *, noisy: bool = True) -> RegionSum:
    """Return the sum over a bright square of one plane."""
    H = np.einsum("i,j->ij", [1, 2, 1], [1, 2, 1])[None, None, None] / 16
    P = Projector(H, (40, 40), workers=1)
    truth = np.full((1, 40, 40), 50.0)
    truth[:, 12:28, 12:28] = 2000
    rng = np.random.default_rng(4)
    frame = rng.poisson(P.forward(truth)) if noisy else P.forward(truth)
    choice = SolverChoice("rl", iterations=8, gain=1.0 if noisy else 1e-6)
    settings = BootstrapSettings(replicates=30)
    (found,) = error_bars(P, frame, choice, settings, labels=truth[0] > 1000, imaging=imaging).regions
    return found


def test_sums_state_the_parts_of_noise_h_and_object() -> None:
    """If the scale of H is uncertain by 5 %, so is each sum; without noise, its part is zero."""
    H = np.einsum("i,j->ij", [1, 2, 1], [1, 2, 1])[None, None, None] / 16

    def imaging(rng: np.random.Generator) -> Projector:
        return Projector(H * (1 + 0.05 * rng.standard_normal()), (40, 40), workers=1)

    exact, uncertain, silent = region(None), region(imaging), region(imaging, noisy=False)
    assert exact.h == 0 < exact.noise < exact.sigma
    assert uncertain.h == pytest.approx(0.05 * uncertain.total, rel=0.6)
    assert uncertain.sigma == pytest.approx(np.hypot(0.05 * uncertain.total, exact.sigma), rel=0.4)
    assert silent.noise < 1e-3 * silent.sigma < silent.h
    for one in (exact, uncertain, silent):
        assert np.hypot(np.hypot(one.noise, one.h), one.object) == pytest.approx(one.sigma)
