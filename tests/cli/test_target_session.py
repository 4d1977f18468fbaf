"""A target from its plan to H of two regions, by the commands that a user types."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.psf import open_psf
from lfcal.psf.opening import regions_of
from lfcal.reconstruct import FieldProjector, Projector
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
ARRAY = "array:4x4@1.3mm,hole=20um,absent=0:0+0:1+1:0"
EFFECTS = [{"name": "vignetting", "distance_um": 30000.0, "radius": 1.05}]


@pytest.mark.long
def test_from_a_plan_to_h_of_two_regions(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    camera = preset("bench")
    true = replace(camera, sensor=replace(camera.sensor, shape=(300, 300)))
    Path("camera.json").write_text(true.to_json())
    Path("effects.json").write_text(json.dumps(EFFECTS))
    assert lfcal("plan", "camera.json", "--virtual-depths", "4", "--cutout", "49", "-o", "scan.json").code == 0
    run = lfcal(
        "plan",
        "target",
        "scan.json",
        ARRAY,
        "--most-frames",
        "3",
        "--tolerance",
        "0.5",
        "--regions",
        "1x2",
        "-o",
        "target.json",
    )
    assert run.code == 0 and "2 regions, all in the same frames" in run.out, run.err
    optics = ("--option", "optics=wave", "--option", "effects=effects.json", "--option", "brightness=0.1")
    run = lfcal(
        "acquire", "target.json", "-o", "s", "--darks", 2, "--reference-every", 0, *optics, "--assemble", "A.h5"
    )
    assert run.code == 0 and "A.h5: H (1, 19, 33, 49, 49)" in run.out, run.err
    assert "3 of 3 frames of a target" in lfcal("status", "s").out
    said = lfcal("assemble", "s", "-o", "H.h5", "--json").json
    assert isinstance(said, dict) and said["target"]["points"] == 39 and said["target"]["stage_px"] < 0.1
    fitted = ("fit", "s", "-o", "fit", "--effect", "vignetting=on", "--unknowns", "geometry,focal_lengths,iris")
    found = lfcal(*fitted, "--positions", 18, "--regions", "1x2", "--workers", 1, "--json").json
    assert isinstance(found, dict) and found["chi2"]["lit"] < 1.6
    gap = next(one for one in found["parameters"] if one["name"] == "gap_um")
    assert gap["value"] == pytest.approx(true.lattice.gap_um, rel=1e-3)
    assert regions_of("fit/H.h5") == ("r1c1", "r1c2")
    told = lfcal("inspect", "fit/H.h5", "--seconds", 0, "--json").json
    assert isinstance(told, dict) and len(told["regions"]["regions"]) == 2
    assert {one["key"]: one["merit"] for one in told["metrics"]}["target_pose"] == "good"
    # what points show at positions is what the camera as found has there, but for noise and the part of a pixel
    with open_psf("fit/H.h5", region="r1c1") as model, open_psf("H.h5") as seen:
        assert model.shape == seen.shape and np.argwhere(seen.recorded > 0).size > 0
    frame = np.zeros((300, 300), np.float32)
    frame[100:200, 100:200] = np.asarray(open_psf("fit/H.h5").plane(0)).sum((0, 1)).mean()
    np.save("frame.npy", frame)
    run = lfcal("reconstruct", "fit/H.h5", "frame.npy", "--region", "all", "--solver", "rl", "-n", 1, "-o", "v.npy")
    assert run.code == 0, run.err
    volume = np.load("v.npy")
    assert volume.shape[0] == 1 and np.isfinite(volume).all() and volume.max() > 0
    # both regions are blended, and the blend has its adjoint
    with open_psf("fit/H.h5", region="r1c1") as left, open_psf("fit/H.h5", region="r1c2") as right:
        both, one = FieldProjector([left, right], (300, 300)), Projector(left, (300, 300))
        rng = np.random.default_rng(0)
        seen, lit = rng.random((300, 300)).astype(np.float32), rng.random(both.volume_shape).astype(np.float32)
        forward, back = both.forward(lit), both.adjoint(seen)
        sums = [float((a.astype(float) * b).sum()) for a, b in ((forward, seen), (back, lit))]
        assert sums[0] == pytest.approx(sums[1], rel=1e-5)
        assert np.abs(forward - one.forward(lit)).max() > 1e-3 * forward.max()
