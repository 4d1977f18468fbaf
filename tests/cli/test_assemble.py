from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lfcal.frames import open_frames
from lfcal.psf import open_psf
from tests.cli.conftest import ANCHOR, CUTOUT, SHAPE, Run, true_frame

Lfcal = Callable[..., Run]


def test_the_main_job(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    run = lfcal(
        "assemble",
        session / "frames",
        "--dark",
        session / "dark",
        "--white",
        session / "white",
        "--white-mode",
        "pixels",
        "-o",
        tmp_path / "H.h5",
        "--strict",
        "--json",
    )
    assert run.code == 0, run.err
    assert run.json["shape"] == [*SHAPE, *CUTOUT]  # type: ignore[index, call-overload]
    with open_psf(tmp_path / "H.h5") as H:
        for z, y, x in np.ndindex(SHAPE):
            frame = true_frame(z, y, x).astype(float)
            row, column = ANCHOR[0] + y, ANCHOR[1] + x
            truth = frame[row - 4 : row + 5, column - 5 : column + 6]
            np.testing.assert_allclose(H[z, y, x], truth, atol=0.5)
        assert H.camera is not None and H.camera.sensor.shape == (40, 48)
        steps = H.provenance["corrections"]["steps"]
        assert [step["kind"] for step in steps] == ["dark", "white"]


def test_names_give_positions(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    (session / "frames" / "manifest.csv").unlink()
    run = lfcal("assemble", session / "frames", "--pattern", "z{z}_y{y}_x{x}.png", "-o", tmp_path / "H.h5")
    assert run.code == 0, run.err
    assert "from 24 frames" in run.out


def test_cutout_by_energy(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    options = ("--dark", session / "dark", "-o", tmp_path / "H.h5", "--cutout", "auto", "--json")
    run = lfcal("assemble", session / "frames", *options)
    assert run.code == 0, run.err
    nt, ns = run.json["shape"][3:]  # type: ignore[index, call-overload]
    assert 9 <= nt <= 17 and 9 <= ns <= 17 and nt % 2 == ns % 2 == 1


def test_missing_positions_are_noted(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    manifest = session / "frames" / "manifest.csv"
    lines = manifest.read_text().splitlines()
    manifest.write_text("\n".join(lines[:-2]) + "\n")
    run = lfcal("assemble", session / "frames", "-o", tmp_path / "H.h5")
    assert run.code == 0 and "Positions without a frame: 2 positions; (z, y, x) = " in run.out
    assert lfcal("assemble", session / "frames", "-o", tmp_path / "S.h5", "--strict").code == 2
    assert not (tmp_path / "S.h5").exists()


def test_transpose_and_export(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    assert lfcal("assemble", session / "frames", "-o", tmp_path / "H.h5").code == 0
    assert lfcal("transpose", tmp_path / "H.h5", "-o", tmp_path / "HT.h5").code == 0
    with open_psf(tmp_path / "H.h5") as H, open_psf(tmp_path / "HT.h5") as HT:
        np.testing.assert_array_equal(np.asarray(HT), np.asarray(H.T))
    for name in ("H.mat", "H.npy", "H.tif"):
        assert lfcal("export", tmp_path / "H.h5", "-o", tmp_path / name).code == 0
    run = lfcal("export", tmp_path / "H.h5", "-o", tmp_path / "one.tif", "--position", "1,2")
    assert run.code == 0 and (tmp_path / "one.tif").exists()
    assert "square period" in lfcal("export", tmp_path / "H.h5", "-o", tmp_path / "H.mat", "--force").err


def test_nan_is_masked_or_refused(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    with open_frames(session / "frames") as frames:
        values = np.stack([frames.read(k) for k in range(len(frames))]).astype(np.float32)
    values[:, 3, 4] = np.nan
    np.save(session / "stack.npy", values)
    given = ("assemble", session / "stack.npy", "--order", "raster", "--dark", session / "dark")
    run = lfcal(*given, "-o", tmp_path / "H.h5")
    assert run.code == 0 and "1 pixel without a finite value" in run.err, run.err
    assert "--nan mask" in lfcal(*given, "-o", tmp_path / "R.h5", "--nan", "refuse").err
