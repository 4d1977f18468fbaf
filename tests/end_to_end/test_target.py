"""Targets and displays from their plan to H, by the commands that a user types."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.psf.opening import regions_of
from lfcal.reconstruct import FieldProjector, Projector
from lfcal.targets import TargetPlan
from tests.cli.conftest import Lfcal
from tests.targets.common import scan_of, small

ARRAY = "array:4x4@1.3mm,hole=20um,absent=0:0+0:1+1:0"
EFFECTS = [{"name": "vignetting", "distance_um": 30000.0, "radius": 1.05}]


@pytest.mark.long
def test_from_a_plan_to_h_of_two_regions(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    camera = preset("bench")
    true = replace(camera, sensor=replace(camera.sensor, shape=(300, 300)))
    Path("camera.json").write_text(true.to_json())
    Path("effects.json").write_text(json.dumps(EFFECTS))
    lfcal("plan", "camera.json", "--virtual-depths", "4", "--cutout", "49", "-o", "scan.json").ok()
    planned = ("--most-frames", "3", "--tolerance", "0.5", "--regions", "1x2", "-o", "target.json")
    assert "2 regions, all in the same frames" in lfcal("plan", "target", "scan.json", ARRAY, *planned).ok().out
    optics = ("--option", "optics=wave", "--option", "effects=effects.json", "--option", "brightness=0.1")
    run = lfcal("acquire", "target.json", "-o", "s", *optics, *RECORDED, "A.h5").ok()
    assert "A.h5: H (1, 19, 33, 49, 49)" in run.out and "3 of 3 frames of a target" in lfcal("status", "s").out
    said = lfcal("assemble", "s", "-o", "H.h5", "--json").json
    assert said["target"]["points"] == 39 and said["target"]["stage_px"] < 0.1
    fitted = ("fit", "s", "-o", "fit", "--effect", "vignetting=on", "--unknowns", "geometry,focal_lengths,iris")
    found = lfcal(*fitted, "--positions", 18, "--regions", "1x2", "--workers", 1, "--json").json
    assert found["chi2"]["lit"] < 1.6
    gap = next(one for one in found["parameters"] if one["name"] == "gap_um")
    assert gap["value"] == pytest.approx(true.lattice.gap_um, rel=1e-3) and regions_of("fit/H.h5") == ("r1c1", "r1c2")
    told = lfcal("inspect", "fit/H.h5", "--seconds", 0, "--json").json
    assert len(told["regions"]["regions"]) == 2
    assert {one["key"]: one["merit"] for one in told["metrics"]}["target_pose"] == "good"
    # what points show at positions is what the camera as found has there, but for noise and the part of a pixel
    with open_psf("fit/H.h5", region="r1c1") as model, open_psf("H.h5") as seen:
        assert model.shape == seen.shape and np.argwhere(seen.recorded > 0).size > 0
    frame = np.zeros((300, 300), np.float32)
    frame[100:200, 100:200] = np.asarray(open_psf("fit/H.h5").plane(0)).sum((0, 1)).mean()
    np.save("frame.npy", frame)
    lfcal("reconstruct", "fit/H.h5", "frame.npy", "--region", "all", "--solver", "rl", "-n", 1, "-o", "v.npy").ok()
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


DISPLAY_SCAN = scan_of(small(200))


CODED = ("plan", "target", "scan.json", "--tolerance", "0.3", "--crosstalk", "0.02")


SOURCE = "display:2000x2000@5um"
RECORDED = ("--darks", 2, "--reference-every", 0, "--assemble")


@pytest.fixture
def display_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scan.json").write_text(DISPLAY_SCAN.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_a_display_from_its_plan_to_h(lfcal: Lfcal, display_place: Path) -> None:
    words = (*CODED, SOURCE, "--most-frames", 7, "--signal", 100, "--patterns", "shown", "-o")
    assert "frames show 4 subsets of points together" in lfcal(*words, "plan.json").ok().out
    # images are replaced on request, and none of an earlier plan stays
    (display_place / "shown" / "frame_0099.png").write_bytes(b"of an earlier plan")
    lfcal(*words, "other.json").refused("add --force")
    assert not (display_place / "other.json").exists()
    lfcal(*words, "plan.json", "--force").ok()
    plan = TargetPlan.from_json((display_place / "plan.json").read_text())
    shown = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((display_place / "shown").iterdir())]
    assert plan.lit is not None and len(shown) == 7 and shown[0].shape == (2000, 2000)
    assert {int((one > 0).sum()) for one in shown} == {4 * len(plan.target.holes)}
    assert "A.h5: H" in lfcal("acquire", "plan.json", "-o", "s", *RECORDED, "A.h5").ok().out
    # the same frames in a folder, as the program of a display records them
    folder = display_place / "folder"
    folder.mkdir()
    with open_frames("s") as source:
        for k in range(len(source)):
            cv2.imwrite(str(folder / f"f{k}.png"), source.read(k))
    again = lfcal("assemble", "folder", "--plan", "plan.json", "-o", "C.h5", "--json").ok().json
    assert again["target"]["points"] > 100
    # several subsets at once are as much more light
    (display_place / "alone.json").write_text(replace(plan, lit=None).to_json())
    lfcal("acquire", "alone.json", "-o", "t", *RECORDED, "B.h5").ok()
    light = [np.asarray(open_frames(one).read(3), float) - 64 for one in ("s", "t")]
    assert light[0].sum() == pytest.approx(4 * light[1].sum(), rel=0.1)
    lfcal("compare", "A.h5", "B.h5", "--json").ok()
