"""Frames of one array, parts of frames, and the record of what is known of all frames."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.axes import check_region, grow_region, whole
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    ORIENTATIONS,
    ArraySource,
    CorrectionChain,
    Dark,
    Defects,
    FrameInfo,
    FrameMetadata,
    FrameSource,
    Position,
    White,
    channel_source,
    corrected,
    open_frames,
    oriented,
)
from lfcal.frames.corrections import steps
from lfcal.psf import AssemblySettings, assemble_plan
from tests.distribution import in_a_new_process, install
from tests.frames.scenes import session


def test_five_axes_are_positions() -> None:
    frames = session()
    source = ArraySource(frames)
    assert isinstance(source, FrameSource)
    assert len(source) == 24 and source.shape == (20, 30) and source.dtype == np.uint16
    for k in range(24):
        np.testing.assert_array_equal(source.read(k), frames[source.info(k).position])
    part = source.read(0, (slice(2, 9), slice(None, 4)))
    np.testing.assert_array_equal(part, source.read(0)[2:9, :4])
    assert part.flags.c_contiguous
    source.read(3)[:] = 0
    assert frames.min() > 0, "a frame that was read is a copy"
    swapped = ArraySource(frames.astype(">u2"))
    assert swapped.dtype.isnative and swapped.read(0).dtype.isnative
    np.testing.assert_array_equal(swapped.read(5), frames.reshape(-1, 20, 30)[5])


def test_exposure_and_drift() -> None:
    places = [(0, 0, 0), (0, 0, 1)]
    source = ArraySource(session((2, 20, 30)), places, exposures_s=[0.1, 0.2], drifts=[(0, 0), (0.5, -1)])
    assert source.info(1).exposure_s == 0.2
    assert source.info(1).drift == (0.5, -1.0)
    assert ArraySource(session(), metadata={"exposure_s": 0.25}).info(7).exposure_s == 0.25
    unknown = ArraySource(session()).info(0)
    assert unknown.exposure_s is None and unknown.drift is None and unknown.saturated is None
    assert unknown.origin == (0, 0) and unknown.label == "frames[0]"
    several = FrameInfo((Position(0, 0, 0), Position(0, 1, 1)), label="target")
    with pytest.raises(InputError, match="target: expected one point source, got 2"):
        _ = several.position


def test_unusable_arrays_are_refused() -> None:
    one = {"positions": [(0, 0, 0)]}
    for frames, more, words in (
        (np.zeros((3, 4)), {}, "axes"),
        (np.zeros((3, 0, 4)), {}, "axes"),
        (np.zeros((2, 3, 4), complex), {}, "complex128"),
        (np.zeros((2, 3, 4)), {}, "expected 2 positions, got none"),
        (np.zeros((2, 3, 4)), one, "expected 2, one per frame, got 1"),
        (np.zeros((1, 3, 4)), one | {"exposures_s": [1, 2]}, "exposures of frames"),
    ):
        with pytest.raises(InputError, match=words):
            ArraySource(frames, **more)  # type: ignore[arg-type]


def test_regions_are_checked_and_grow_to_the_border() -> None:
    source = ArraySource(session())
    for index in (-1, 24):
        with pytest.raises(InputError, match="frame index: expected 0 … 23"):
            source.read(index)
    for rows in (slice(-1, 5), slice(5, 5), slice(0, 21), slice(0, 10, 2)):
        with pytest.raises(InputError, match="region rows: expected start < stop within 0 … 20"):
            source.read(0, (rows, slice(0, 5)))
    assert grow_region((slice(1, 5), slice(20, 29)), 2, (20, 30)) == (slice(0, 7), slice(18, 30))
    assert check_region((slice(None), slice(None)), (20, 30)) == whole((20, 30))


def test_a_pixel_mask_travels_with_the_frames(tmp_path: Path) -> None:
    """Masked pixels are not valid and do not count as saturated, in views and files alike."""
    frames = session((2, 20, 30))
    frames[0, 3, 4] = frames[0, 5, 6] = 4095
    mask = np.ones((20, 30), bool)
    mask[3, 4] = mask[10, 11] = False
    places, facts = [(0, 0, 0), (0, 0, 1)], {"saturation": 4095.0, "cfa": "GRBG"}
    source = ArraySource(frames, places, mask=mask, metadata=facts)
    with h5py.File(tmp_path / "stack.h5", "w") as file:
        file["frames"], file["positions"], file["mask"] = frames, np.array(places), mask.astype(np.uint8)
    view = corrected(source, CorrectionChain((Defects([(10, 11)], (20, 30)),)))
    for found, expected in ((source, {(3, 4), (5, 6), (10, 11)}), (view, {(3, 4), (5, 6)})):
        samples = found.samples(0)
        assert samples.valid is not None and samples.saturated == 1
        assert set(map(tuple, np.argwhere(~samples.valid).tolist())) == expected
        part = found.samples(0, (slice(5, 12), slice(6, 30)))
        assert part.valid is not None and not part.valid[0, 0] and part.saturated == 1
    red = channel_source(source, "B").samples(0)
    assert red.valid is not None and np.argwhere(~red.valid).tolist() == [[1, 2], [2, 3]]
    with open_frames(tmp_path / "stack.h5") as stack:
        assert stack.info(1).mask is not None and not stack.samples(1).valid[10, 11]  # type: ignore[index]
    with pytest.raises(InputError, match=r"pixel mask: expected \d+ x \d+ px, got 3 x 3 px"):
        ArraySource(frames, places, mask=np.ones((3, 3)))


# -- metadata ----------------------------------------------------------------------------------------------------------


def test_every_field_is_documented() -> None:
    text = inspect.cleandoc(FrameMetadata.__doc__ or "").split("Attributes\n----------\n")[1].split("\nExamples\n")[0]
    assert re.findall(r"^(\w+)\n {4}\S", text, re.MULTILINE) == [one.name for one in fields(FrameMetadata)]


def test_a_mapping_becomes_a_record() -> None:
    stated = {"bit_depth": 12, "gains": [1.0, 2.0], "saturation": None, "lamp": "LED", "other": 3}
    known = FrameMetadata.of(stated)
    assert known == FrameMetadata(bit_depth=12, gains=(1.0, 2.0), other={"lamp": "LED", "other": 3})
    assert FrameMetadata.of(known) is known
    assert FrameMetadata.of({}) == FrameMetadata()
    for metadata, bits, exposure in (
        (known, 12, None),
        ({"bit_depth": 12, "exposure_s": 0.5}, 12, 0.5),
        (None, None, None),
    ):
        source = ArraySource(np.zeros((1, 1, 1, 4, 6), np.uint16), metadata=metadata)
        assert (source.metadata.bit_depth, source.info(0).exposure_s) == (bits, exposure)
    kept = FrameMetadata(codec={"name": "lzw"}, origin=(0, 0), suspect=[])
    assert kept.stated(("origin", "suspect", "optics", "codec")) == {"origin": (0, 0), "codec": {"name": "lzw"}}
    with pytest.raises(InputError, match=r"frame source: expected FrameMetadata, got list; return lfcal\.frames"):
        FrameMetadata.of([("bit_depth", 12)])  # type: ignore[arg-type]  # what an untyped plug-in may return


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
import numpy as np
from lfcal.frames import ArraySource, FrameInfo, Frames, Position
from lfcal.frames.sources.base import SourceKind

class Lab(Frames):
    shape = property(lambda self: self.frames.shape[1:])
    dtype = property(lambda self: self.frames.dtype)
    metadata = property(lambda self: {"bit_depth": 12, "saturation": 3000.0, "black_level": None, "lamp": "LED"})
    def __init__(self, path, options):
        self.frames = np.load(path)
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
    corrections = "1 [{'kind': 'dark', 'level': 10.0}] LED"
    assert said == ["12 None {'lamp': 'LED'} 1 3", "LED 2 (2, 3)", corrections, "closed"]
