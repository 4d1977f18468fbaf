"""The benchmarks run, and what they report holds together."""

from __future__ import annotations

import numpy as np

from benchmarks import project, reconstruct
from lfcal.psf import PSFMatrix
from tests.reconstruct.oracles import lenslet_psf


def test_projections_side_by_side(capsys):
    rows = project.measure(60, 5, 21, 1, 1, 1)
    assert [r.name for r in rows[:4]] == [
        "polyphase, float64",
        "polyphase, float32",
        "direct, float32",
        "per-position FFT, scipy",
    ]
    assert rows[0].mismatch < 1e-12
    assert all(r.error < 1e-5 and r.pair_s > 0 for r in rows)
    project.show(rows, "small")
    assert "times lfcal's best" in capsys.readouterr().out


def test_error_against_seconds(tmp_path, capsys):
    H = PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32))
    truth, frame = reconstruct.scene(H, 40, 500.0, "points", 1)
    settings = [
        s
        for s in reconstruct.SETTINGS
        if s.name in ("Richardson-Lucy", "threshold 5e-2", "Biggs-Andrews", "float64", "Tikhonov 0.1")
    ]
    curves = [reconstruct.measure(s, H, truth, frame, 4, 1) for s in settings]
    plain = curves[0]
    assert plain.iterations == (1, 2, 3, 4)
    assert plain.errors[-1] < plain.errors[0]
    assert np.isclose(plain.errors[-1], curves[1].errors[-1], rtol=1e-3)  # single against double precision
    reference = reconstruct.against_reference(H, 40, 1)
    assert reference["ratio"] > 0
    reconstruct.draw(curves, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    reconstruct.show(curves, reference, "small")
    assert "least NRMSE" in capsys.readouterr().out
