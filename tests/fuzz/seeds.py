"""One small good file of every kind that lfcal reads, made by lfcal itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from unittest import mock
from uuid import UUID

import cv2
import h5py
import numpy as np
import tifffile

from lfcal.acquire import Options, RedoList, iter_finish, record
from lfcal.acquire.control import Control
from lfcal.base.axes import Position
from lfcal.base.progress import drain
from lfcal.devices import simulated_rig
from lfcal.judge.quality.metric import Reading
from lfcal.psf import PSFMatrix, export, save, save_regions
from lfcal.psf.facts import Origin
from lfcal.work.journal import Journal
from lfcal.work.records import save_record
from lfcal_gui.models.project import ProjectState
from tests.acquire.rigs import small_plan
from tests.camera.importers.files import CONFIGURATION, OLAF, napari
from tests.camera.importers.test_raytrix_xml import xml
from tests.cli.conftest import ANCHOR, SENSOR, SHAPE, true_frame
from tests.cli.conftest import small_plan as frames_plan
from tests.frames.scenes import write_dng
from tests.lattice.white_frames import draw_white
from tests.psf.test_lfc_import import psfs, save_lfc

__all__ = ["RECORD", "make"]

DARK = 20
RECORD = small_plan((2, 3), 2)
"""What the recorded sessions hold: 12 positions."""


def make(folder: Path) -> None:
    """Write one file or folder of every kind into ``folder``."""
    _matrices(folder)
    _frames(folder)
    _stacks(folder)
    _descriptions(folder)
    _runs(folder)
    _splats(folder)
    _sessions(folder)


def _matrices(folder: Path) -> None:
    rng = np.random.default_rng(0)
    window = np.outer(np.hanning(11)[1:-1], np.hanning(13)[1:-1])
    values = (rng.random((2, 2, 2, 9, 11)) * window).astype(np.float32)
    matrix = PSFMatrix(values, depths=(0.0, 100.0), camera=RECORD.camera, anchor=(8.0, 9.0))
    save(matrix, folder / "H.h5", dtype="rounded")
    save(matrix, folder / "Hz.h5", compression="zstd")
    save(matrix.T, folder / "HT.h5")
    save_regions({"centre": matrix, "edge": matrix}, folder / "Hr.h5")
    export(matrix, folder / "H.mat")
    np.save(folder / "H.npy", values)
    save(matrix, folder / "H1.h5", dtype="rounded")
    with h5py.File(folder / "H1.h5", "r+") as file:  # version 1 had none of these
        file.attrs["version"] = 1
        for name in {"checksum", "variance", "valid", "window", "error", "entry"} & set(file):
            del file[name]
    frame = rng.poisson(200, (20, 24)).astype(np.uint16)
    tifffile.imwrite(folder / "light.tif", frame)


def _frames(folder: Path) -> None:
    (folder / "frames").mkdir()
    rows, entries = ["file,z,y,x,exposure_s"], []
    for z, y, x in np.ndindex(SHAPE):
        name = f"z{z}_y{y}_x{x}.png"
        cv2.imwrite(str(folder / "frames" / name), true_frame(z, y, x) + np.uint16(DARK))
        rows.append(f"{name},{z},{y},{x},0.02")
        entries.append({"file": name, "z": z, "y": y, "x": x})
    body = {"format": "lfcal-manifest", "version": 1, "plan_shape": SHAPE, "shape": SENSOR, "dtype": "uint16"}
    (folder / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n")
    (folder / "frames" / "list.json").write_text(json.dumps({**body, "frames": entries}, indent=1))


def _stacks(folder: Path) -> None:
    stack = np.stack([true_frame(*p) for p in np.ndindex(SHAPE)])
    np.save(folder / "stack.npy", stack)
    np.savez(folder / "stack.npz", stack=stack)
    with h5py.File(folder / "stack.h5", "w") as file:
        file.create_dataset("frames", data=stack, chunks=(1, *SENSOR), compression="gzip", shuffle=True)
        file["positions"] = np.array(list(np.ndindex(SHAPE)), np.int32)
        file["exposure_s"] = np.full(len(stack), 0.02)
        file["mask"] = np.ones(SENSOR, np.uint8)
    grey = {"photometric": "minisblack"}
    tifffile.imwrite(folder / "plain.tif", stack, metadata=None, **grey)
    tifffile.imwrite(folder / "lzw.tif", stack, metadata=None, compression="lzw", predictor=True, **grey)
    tifffile.imwrite(folder / "deflate.tif", stack, metadata=None, compression="zlib", **grey)
    tifffile.imwrite(folder / "big.tif", stack, metadata=None, bigtiff=True, **grey)
    tifffile.imwrite(folder / "ome.tif", stack.reshape(2, 12, *SENSOR), ome=True, metadata={"axes": "ZTYX"}, **grey)
    tifffile.imwrite(folder / "imagej.tif", stack.reshape(2, 12, *SENSOR), imagej=True, metadata={"axes": "TZYX"})
    dark = np.full(SENSOR, DARK, np.uint16)
    cv2.imwrite(str(folder / "dark.png"), dark)
    cv2.imwrite(str(folder / "dark8.png"), dark.astype(np.uint8))
    cv2.imwrite(str(folder / "dark.pgm"), dark)
    tifffile.imwrite(folder / "dark.tif", dark)
    np.save(folder / "dark.npy", dark)
    np.save(folder / "fdark.npy", dark.astype(np.float32))
    tifffile.imwrite(folder / "fdark.tif", dark.astype(np.float64))
    write_dng(folder / "dark.dng", dark)
    white = draw_white(RECORD.camera.sensor.shape, pitch=12.0, fill=0.85).frame
    cv2.imwrite(str(folder / "white.png"), white)
    cv2.imwrite(str(folder / "white.pgm"), white)
    tifffile.imwrite(folder / "white.tif", white)
    np.save(folder / "white.npy", white)
    write_dng(folder / "white.dng", white)


def _descriptions(folder: Path) -> None:
    plan = frames_plan()
    (folder / "plan.json").write_text(plan.to_json())
    (folder / "record.json").write_text(RECORD.to_json())
    (folder / "camera.json").write_text(RECORD.camera.to_json())
    (folder / "camera.xml").write_text(xml())
    RedoList.of([(0, 0, 1), (1, 1, 2)], ["dim", ""]).write(folder / "redo.json")
    (folder / "olaf.yaml").write_text(OLAF)
    (folder / "mm.cfg").write_text(CONFIGURATION)
    (folder / "napari.json").write_text(napari())
    summary = {"Width": 512, "Height": 400, "BitDepth": 14, "PixelSize_um": 0.325, "Slices": 3}
    (folder / "metadata.txt").write_text(json.dumps({"Summary": summary}))
    state = ProjectState(plan=plan, frames="frames", redo=((0, 0, 1),), settings={"frames": {"strict": True}})
    (folder / "work.lfcal").write_text(state.to_json())
    assert ANCHOR == plan.anchor


def _runs(folder: Path) -> None:
    """Write what long runs leave: a journal, and the record of a unit."""
    parts = folder / "H.h5.parts"
    parts.mkdir()
    with Journal.open(parts) as journal:
        journal.begin("H of 3 planes", [f"plane {z}" for z in range(3)], "processes", 2, "")
        journal.settle({"workers": 2}, ["a1", "b2"])
        journal.note("started", unit="plane 0", worker="1")
        journal.note("done", unit="plane 0", seconds=1.5, file="plane 0.a1.h5", seal="0123")
        journal.note("failed", unit="plane 1", seconds=0.5, reason="the disk is full")
        journal.note("joining")
    image = np.arange(6.0).reshape(2, 3)
    found = {"reading": Reading(0.5, image, image > 1, "words"), "place": Position(1, 2, 3), "origin": Origin.MODEL}
    save_record(folder / "unit.record", found)


def _splats(folder: Path) -> None:
    """Write a calibration of napari-LF."""
    module = ModuleType("lflib.optics")
    database = type("PsfDatabase", (), {"__module__": "lflib.optics"})
    module.PsfDatabase = database  # type: ignore[attr-defined]
    with mock.patch.dict(sys.modules, {"lflib": ModuleType("lflib"), "lflib.optics": module}):
        save_lfc(folder / "c.lfc", psfs(database, 1, [-3.0, 4.0]))


IDENTITIES = {
    "packed": "f7951a5e5f3641619485b8a9532085c4",
    "raw": "0e593ed2bc484e599791522866b4bc6a",
    "open": "f73d6e3f094b494dab9ffe51bc7092f4",
}
"""Names of the sessions: recordings of the corpus carry them, and are refused at once in a session of another."""


def _sessions(folder: Path) -> None:
    options = Options(darks=2, reference_every=5, controls=1, keep_free_bytes=0)
    control, seen = Control(), []

    def stop(*_: object) -> None:
        seen.append(1)
        if len(seen) == 7:
            control.stop()

    for name, identity in IDENTITIES.items():
        with mock.patch("uuid.uuid4", lambda identity=identity: UUID(identity)):
            ends = {"control": control, "observers": (stop,)} if name == "open" else {}
            record(folder / name, RECORD, simulated_rig(RECORD), options, **ends)
    drain(iter_finish(folder / "packed"))
    for name in IDENTITIES:
        (folder / name / "session.lock").unlink(missing_ok=True)
