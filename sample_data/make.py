"""Make the sample session: ``python sample_data/make.py [OUT]``. Seeded; the same files every time.

A recorded session of the small ``bench`` camera as its simulator sees it, noise and all: two depth planes of
33 x 19 positions, 16-bit PNG frames, dark and white frames, camera, plan, manifest, and the known truth.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.simulate.camera_source import SimulatedCamera

SEED = 20
SENSOR = (80, 96)
CUTOUT = 55
VIRTUAL_DEPTHS = (3.0, 4.0)
DARKS, WHITES = 8, 4


def sample_camera() -> Camera:
    """Return the bench camera with just enough sensor for the scan."""
    camera = preset("bench")
    return replace(camera, name="bench (sample session)", sensor=replace(camera.sensor, shape=SENSOR))


def sample_plan() -> ScanPlan:
    """Return the plan of the session."""
    return ScanPlan.for_camera(sample_camera(), virtual_depths=VIRTUAL_DEPTHS, cutout=CUTOUT, exposure_s=0.02)


def sample_source() -> SimulatedCamera:
    """Return the simulated camera that records the session."""
    return SimulatedCamera(sample_plan(), "auto", tolerance=0.05, peak=0.8, seed=SEED)


def frame_name(source: SimulatedCamera, index: int) -> str:
    """Return the file name of a frame."""
    z, y, x = source.position(index)
    return f"z{z}_y{y:02d}_x{x:02d}.png"


def write_png(path: Path, frame: np.ndarray) -> None:
    """Write a 16-bit PNG as small as it gets."""
    ok, encoded = cv2.imencode(".png", np.asarray(frame, np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not ok:
        raise RuntimeError(f"{path}: PNG encoding failed")
    path.write_bytes(encoded.tobytes())


def make(out: Path) -> None:
    """Write the whole session into ``out``, replacing what was there."""
    shutil.rmtree(out, ignore_errors=True)
    for name in ("frames", "dark", "white"):
        (out / name).mkdir(parents=True)
    source = sample_source()
    rows = ["file,z,y,x"]
    for index in range(len(source)):
        name = frame_name(source, index)
        write_png(out / "frames" / name, source.read(index))
        rows.append(f"{name},{','.join(map(str, source.position(index)))}")
    (out / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    for k in range(DARKS):
        write_png(out / "dark" / f"dark_{k}.png", source.dark_frame(k))
    for k in range(WHITES):
        write_png(out / "white" / f"white_{k}.png", source.white_frame(k))
    plan = source.plan
    (out / "camera.json").write_text(plan.camera.to_json() + "\n", encoding="utf-8")
    (out / "plan.json").write_text(plan.to_json() + "\n", encoding="utf-8")
    truth = {
        "seed": SEED,
        "tolerance": source.tolerance,
        "effects": source.metadata["simulated"]["effects"],
        "counts_per_unit": [float(source.counts_per_unit(z)) for z in range(len(plan.depths_um))],
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")


def main() -> None:
    """Make the session."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parent / "session")
    make(parser.parse_args().out)


if __name__ == "__main__":
    main()
