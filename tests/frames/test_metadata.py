"""What is known of all frames of a source: one documented record, made once, also of what plug-ins say."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    ORIENTATIONS,
    ArraySource,
    CorrectionChain,
    Dark,
    FrameMetadata,
    White,
    corrected,
    oriented,
)
from lfcal.frames.corrections import steps
from lfcal.psf import AssemblySettings, assemble_plan
from tests.distribution import in_a_new_process, install


def test_every_field_is_documented() -> None:
    text = inspect.cleandoc(FrameMetadata.__doc__ or "").split("Attributes\n----------\n")[1].split("\nExamples\n")[0]
    assert re.findall(r"^(\w+)\n {4}\S", text, re.MULTILINE) == [one.name for one in fields(FrameMetadata)]


def test_a_mapping_becomes_a_record() -> None:
    stated = {"bit_depth": 12, "gains": [1.0, 2.0], "saturation": None, "lamp": "LED", "other": 3}
    known = FrameMetadata.of(stated)
    assert known == FrameMetadata(bit_depth=12, gains=(1.0, 2.0), other={"lamp": "LED", "other": 3})
    assert FrameMetadata.of(known) is known
    assert FrameMetadata.of({}) == FrameMetadata()
    with pytest.raises(InputError, match=r"frame source: expected FrameMetadata, got list; return lfcal\.frames"):
        FrameMetadata.of([("bit_depth", 12)])  # type: ignore[arg-type]  # what an untyped plug-in may return


def test_what_is_kept_is_what_is_known() -> None:
    known = FrameMetadata(codec={"name": "lzw"}, origin=(0, 0), suspect=[])
    assert known.stated(("origin", "suspect", "optics", "codec")) == {"origin": (0, 0), "codec": {"name": "lzw"}}


def small() -> tuple[ScanPlan, ArraySource, CorrectionChain]:
    """Return a scan of a small sensor, and a chain with a dark and a white frame."""
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(90, 100)))
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=21, exposure_s=0.02), period=(2, 3))
    frames = np.random.default_rng(0).integers(64, 4000, (*plan.shape[:3], *camera.sensor.shape), np.uint16)
    frames.reshape(-1)[::64] = 64
    dark = Dark(np.full(camera.sensor.shape, 64, np.float32), count=4, variance=2.0)
    white = White(np.full(camera.sensor.shape, 2000, np.float32), 64.0)
    return plan, ArraySource(frames, metadata={"saturation": 4095.0}), CorrectionChain((dark, white))


def test_calibration_frames_are_checksummed_once_in_an_assembly(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: list[int] = []
    made = steps.fingerprint
    monkeypatch.setattr(steps, "fingerprint", lambda array: seen.append(array.size) or made(array))
    plan, source, chain = small()
    view = oriented(corrected(source, chain), ORIENTATIONS["mirror x"], plan.camera.sensor.shape)
    report = assemble_plan(view, plan, tmp_path / "H.h5", AssemblySettings(keep_pedestal=True))
    assert len(report.matrix.provenance["corrections"]["steps"]) == 2
    report.matrix.close()
    assert seen == [9000, 9000]


PLUGIN = """
from pathlib import Path
import numpy as np
from lfcal.frames import ArraySource, FrameInfo, Frames, Position
from lfcal.frames.sources.base import SourceKind

class Lab(Frames):
    lamp = "LED"
    def __init__(self, path, options):
        self.frames = np.load(path)
        self.closed = False
    @property
    def shape(self):
        return self.frames.shape[1:]
    @property
    def dtype(self):
        return self.frames.dtype
    @property
    def metadata(self):
        return {"bit_depth": 12, "saturation": 3000.0, "black_level": None, "lamp": self.lamp}
    def __len__(self):
        return len(self.frames)
    def info(self, index):
        return FrameInfo((Position(0, 0, index),), label=f"{self.metadata['lamp']} {index}")
    def read(self, index, region=None):
        frame = self.frames[index]
        return (frame if region is None else frame[region]).copy()
    def repeats(self):
        return ArraySource(self.frames, [(0, 0, 0)] * len(self.frames))
    def close(self):
        print("closed")

SOURCE = SourceKind("lab", lambda path: path.suffix == ".lab", Lab, 5)
"""

USE = """
import numpy as np
from lfcal.frames import CorrectionChain, Dark, corrected, open_frames
from lfcal.psf import Cutout, assemble
with open_frames({path!r}) as source:
    known = source.metadata
    print(known.bit_depth, known.black_level, dict(known.other), source.samples(1).saturated, len(source.repeats()))
    print(source.info(2).label, source.read(2, (slice(0, 2), slice(0, 3))).shape)
    view = corrected(source, CorrectionChain((Dark(level=10.0),)))
    report = assemble(view, (1, 1, 3), Cutout((5, 5), anchor=(7, 8)))
    print(report.saturated, report.matrix.provenance["corrections"]["steps"], view.metadata.other["lamp"])
"""


def test_a_plug_in_that_returns_a_mapping_keeps_working(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install(monkeypatch, tmp_path, "lab_source", PLUGIN, {"lfcal.sources": "lab = lab_source:SOURCE"})
    frames = np.random.default_rng(0).integers(10, 2000, (3, 16, 18)).astype(np.uint16)
    frames[1, 7, 9] = 3000
    with (tmp_path / "scan.lab").open("wb") as file:
        np.save(file, frames)
    said = in_a_new_process(tmp_path, USE.format(path=str(tmp_path / "scan.lab"))).splitlines()
    assert said == [
        "12 None {'lamp': 'LED'} 1 3",
        "LED 2 (2, 3)",
        "1 [{'kind': 'dark', 'level': 10.0}] LED",
        "closed",
    ]


@pytest.mark.parametrize("metadata", [FrameMetadata(bit_depth=12), {"bit_depth": 12, "exposure_s": 0.5}, None])
def test_an_array_says_what_it_is_given(metadata: Any) -> None:
    source = ArraySource(np.zeros((1, 1, 1, 4, 6), np.uint16), metadata=metadata)
    assert source.metadata == FrameMetadata(bit_depth=None if metadata is None else 12)
    assert source.info(0).exposure_s == (0.5 if isinstance(metadata, dict) else None)
