"""The plug-in for napari: its manifest is right, and layers have the values of the files; napari is not needed."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from fnmatch import fnmatch
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lfcal.acquire.session import record
from lfcal.base.errors import FileFormatError
from lfcal.camera import ScanPlan
from lfcal.napari._lazy import Lazy
from lfcal.napari.reader import get_reader, read_layers
from lfcal.psf import PSFMatrix, save
from lfcal.psf.store import PSFWriter
from lfcal.psf.voxels import pixel_um, voxel_um
from lfcal.reconstruct.volumes import VolumeFacts, save_volume, write_volumes
from tests.acquire.rigs import CAREFUL, frames_of, rig_for, small_plan
from tests.architecture.sources import ROOT

MANIFEST = ROOT / "lfcal" / "napari" / "napari.yaml"


PLAN: ScanPlan = small_plan()


def one(path: Path) -> tuple[Any, dict[str, Any]]:
    (layer,) = read_layers(path)
    assert layer[2] == "image"
    return layer[0], layer[1]


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    H = np.random.default_rng(0).random((3, 3, 3, 21, 21), np.float32)
    save(PSFMatrix(H, depths=PLAN.depths_um, camera=PLAN.camera, anchor=PLAN.anchor), tmp_path / "H.h5")
    return tmp_path / "H.h5"


def test_h_and_ht_are_two_layers_with_units(matrix: Path) -> None:
    values = np.random.default_rng(0).random((3, 3, 3, 21, 21), np.float32)
    H = PSFMatrix(values, depths=PLAN.depths_um, camera=PLAN.camera)
    (first, words, kind), (second, other, _) = read_layers(matrix)
    assert kind == "image" and words["visible"] and not other["visible"]
    assert words["name"] == "H (H)" and other["name"] == "H (HT)"
    assert first.shape == (3, 3, 3, 21, 21) and first.dtype == np.float32 and first.ndim == 5
    np.testing.assert_array_equal(first[1, 2, np.int64(0)], H[1, 2, 0])
    np.testing.assert_array_equal(np.asarray(second), np.asarray(H.T[:]))
    assert words["axis_labels"] == ("z", "y", "x", "t", "s") and words["units"] == ("micrometer",) * 5
    step, pixel = voxel_um(H), pixel_um(H)
    assert step is not None and pixel is not None
    mean = float(np.abs(np.diff(PLAN.depths_um)).mean())
    assert words["scale"] == (mean, *step, *pixel) and other["scale"] == (mean, *pixel, *step)
    assert words["translate"][0] == PLAN.depths_um[0]
    assert words["metadata"]["lfcal"]["depths_um"] == list(PLAN.depths_um)
    assert words["contrast_limits"] == (0, H[1, 1, 1].max())


def test_a_file_of_ht_without_a_camera_is_in_pixels(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((2, 3, 4, 5, 5), np.float32)
    writer = PSFWriter(tmp_path / "HT.h5", values.shape, transposed=True)
    with writer:
        for z in range(2):
            writer.write_plane(z, values[z])
    data, words = one(tmp_path / "HT.h5")
    assert words["name"] == "HT (HT)" and words["scale"] == (1.0,) * 5 and words["units"] == ("pixel",) * 5
    np.testing.assert_array_equal(data[...], values)


def test_nothing_is_read_before_it_is_looked_at(matrix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    real = PSFMatrix._from_plane

    def noted(self: PSFMatrix, z: int, y: Any, x: Any, pixels: Any) -> Any:
        seen.append(z)
        assert isinstance(y, int) and isinstance(x, int)
        return real(self, z, y, x, pixels)

    monkeypatch.setattr(PSFMatrix, "_from_plane", noted)
    data = read_layers(matrix)[0][0]
    assert set(seen) == {1}, "one pattern of the middle plane, for the contrast"
    seen.clear()
    _ = data[2, 0, 1]
    assert seen == [2]


def test_sessions_have_their_frames_and_missing_positions_are_dark(tmp_path: Path) -> None:
    record(tmp_path / "session", PLAN, rig_for(PLAN), CAREFUL)
    frames = frames_of(tmp_path / "session")
    data, words = one(tmp_path / "session")
    assert data.shape[:3] == PLAN.shape[:3] and words["axis_labels"] == ("z", "y", "x", "row", "column")
    for place, frame in frames.items():
        np.testing.assert_array_equal(data[place], frame)
    part = np.stack([[frames[z, 2, x][3:9, 4] for x in (0, 1)] for z in (1, 2)])
    np.testing.assert_array_equal(data[1:, 2, 0:2, 3:9, 4], part)
    assert words["units"] == ("micrometer",) * 5 and words["scale"][3:] == (PLAN.camera.sensor.pixel_um,) * 2
    assert one(tmp_path / "session" / "session.json")[0].shape == data.shape
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL, only=[(0, 0, 0), (1, 1, 1)])  # type: ignore[list-item]
    data, _ = one(tmp_path / "s")
    assert data[0, 0, 0].any() and data[1, 1, 1].any() and not data[2].any()


SUFFIXES = (".h5", ".ome.zarr") if importlib.util.find_spec("zarr") else (".h5",)
DESCENDING = (-20.0, -26.0, -38.0)


def test_volumes_are_placed_in_micrometres(tmp_path: Path) -> None:
    depths = (-2.0, 0.0, 6.0)
    for suffix, times in product(SUFFIXES, (0, 4)):
        volumes = np.random.default_rng(2).random((max(1, times), 3, 8, 9), np.float32)
        path = tmp_path / f"v{times}{suffix}"
        if times:
            with write_volumes(path, volumes.shape, VolumeFacts(np.array(depths), (2.0, 3.0))) as add:
                for volume in volumes:
                    add(volume)
        else:
            save_volume(path, volumes[0], depths_um=depths, voxel_um=(2.0, 3.0))
        data, words = one(path)
        axes = 4 if times or suffix == ".ome.zarr" else 3
        assert data.ndim == axes and words["axis_labels"] == ("t", "z", "y", "x")[-axes:]
        assert words["scale"] == (1.0, 4.0, 2.0, 3.0)[-axes:] and words["translate"] == (0.0, -2.0, 0.0, 0.0)[-axes:]
        assert words["units"] == ("pixel", *("micrometer",) * 3)[-axes:]
        assert words["metadata"]["lfcal"]["depths_um"] == list(depths) and words["name"] == f"v{times}"
        np.testing.assert_array_equal(data[...].reshape(volumes.shape), volumes)
    # napari places plane k at start + k step: planes from far to near are reversed
    facts = VolumeFacts(np.array(DESCENDING), (2.0, 3.0), {}, (-8.0, 4.0), [5.0, 7.5, 10.0, 12.5])
    for suffix in SUFFIXES:
        with write_volumes(tmp_path / f"far{suffix}", volumes.shape, facts) as add:
            for volume in volumes:
                add(volume)
        data, words = one(tmp_path / f"far{suffix}")
        assert words["scale"] == (2.5, 9.0, 2.0, 3.0) and words["translate"] == (5.0, -38.0, -8.0, 4.0)
        assert words["units"] == ("second", *("micrometer",) * 3)
        assert words["metadata"]["lfcal"]["depths_um"] == sorted(DESCENDING)
        for key in (..., (1, 0), (slice(None), slice(0, 2), 3), (0, slice(0, None, 2)), (0, slice(1, 1))):
            np.testing.assert_array_equal(data[key], volumes[:, ::-1][key])


def test_a_zarr_of_an_earlier_version_is_reversed_too(tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="zarr is not installed")
    volume = np.random.default_rng(4).random((3, 8, 9), np.float32)
    save_volume(tmp_path / "v.zarr", volume, depths_um=sorted(DESCENDING))
    place = tmp_path / "v.zarr" / ".zattrs"
    said = json.loads(place.read_text())
    said["lfcal"]["depths_um"] = list(DESCENDING)  # the planes as they are, with a start of 0
    said["multiscales"][0]["datasets"][0]["coordinateTransformations"] = [{"type": "scale", "scale": [1, 9, 1, 1]}]
    place.write_text(json.dumps(said))
    data, words = one(tmp_path / "v.zarr")
    assert words["translate"] == (0.0, -38.0, 0.0, 0.0) and words["scale"] == (1.0, 9.0, 1.0, 1.0)
    np.testing.assert_array_equal(data[0], volume[::-1])


def test_h_and_sessions_from_far_to_near_are_placed_at_their_depths(tmp_path: Path) -> None:
    plan = small_plan()
    depths = sorted(plan.depths_um, reverse=True)
    values = np.random.default_rng(0).random((3, 3, 3, 21, 21), np.float32)
    save(PSFMatrix(values, depths=depths, camera=plan.camera, anchor=plan.anchor), tmp_path / "H.h5")
    data, words, _ = read_layers(tmp_path / "H.h5")[0]
    np.testing.assert_array_equal(data[0], values[2])
    np.testing.assert_array_equal(data[:, 1, 0:2, 3], values[::-1, 1, 0:2, 3])
    assert words["translate"][0] == depths[-1] and words["metadata"]["lfcal"]["planes"] == [2, 1, 0]
    falling = replace(plan, depths_um=tuple(depths))
    record(tmp_path / "s", falling, rig_for(falling), CAREFUL)
    frames = frames_of(tmp_path / "s")
    data, words = one(tmp_path / "s")
    np.testing.assert_array_equal(data[0, 1, 2], frames[2, 1, 2])
    np.testing.assert_array_equal(data[0:2, 1, 2, 3:5], np.stack([frames[z, 1, 2][3:5] for z in (2, 1)]))
    assert words["translate"][0] == depths[-1]


def test_other_files_are_left_to_other_readers(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.zeros(3)
    (tmp_path / "damaged.h5").write_bytes(b"no HDF5")
    (tmp_path / "my session").mkdir()
    for name in ("other.h5", "damaged.h5", "my session", "none.h5", "none.zarr"):
        assert get_reader(str(tmp_path / name)) is None
    assert get_reader([str(tmp_path / "a.h5"), str(tmp_path / "b.h5")]) is None
    with pytest.raises(FileFormatError, match="open it with another reader"):
        read_layers(tmp_path / "other.h5")


def test_the_reader_of_the_manifest_is_found_and_reads(matrix: Path) -> None:
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["napari.manifest"]
    package, _, file = points["lfcal"].partition(":")
    place = importlib.util.find_spec(package)
    assert place is not None and place.origin is not None and Path(place.origin).parent / file == MANIFEST
    said = yaml.safe_load(MANIFEST.read_text())
    (command,) = said["contributions"]["commands"]
    module, _, name = command["python_name"].partition(":")
    find = getattr(importlib.import_module(module), name)
    for path in (str(matrix), [str(matrix)]):
        read = find(path)
        assert read is not None and [words["name"] for _, words, _ in read(path)] == ["H (H)", "H (HT)"]
    patterns = [one for reader in said["contributions"]["readers"] for one in reader["filename_patterns"]]
    for path in ("a/H.h5", "a/v.ome.zarr", "a/session", "a/bead_session", "a/s/session.json"):
        assert any(fnmatch(path, pattern) for pattern in patterns), path
    # every program's files: napari would ask each time which plug-in to take
    assert not any(fnmatch(path, pattern) for path in ("a/b.tif", "a/b.npy", "a/b.png", "a/b") for pattern in patterns)
    assert {reader["command"] for reader in said["contributions"]["readers"]} == {command["id"]}


VALIDATED = """
import sys
from npe2 import PluginManifest
manifest = PluginManifest.from_file(sys.argv[1])
manifest.validate_imports()
print(manifest.name, len(manifest.contributions.readers))
"""
LOADED = """
import sys
from lfcal.napari.reader import read_layers
read_layers(sys.argv[1])
print([m for m in sys.modules if m.split('.')[0] in ('napari', 'npe2', 'PySide6')])
"""


def printed_by(code: str, path: Path) -> str:
    """Run code in its own process: imports of npe2 warn."""
    quiet = {**os.environ, "PYTHONWARNINGS": "ignore"}
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_npe2_accepts_the_manifest() -> None:
    if importlib.util.find_spec("npe2") is None:
        pytest.skip("npe2 is not installed")
    assert printed_by(VALIDATED, MANIFEST) == "lfcal 2"


@pytest.mark.long
def test_napari_is_not_imported(matrix: Path) -> None:
    assert printed_by(LOADED, matrix) == "[]"


def test_lazy_arrays_are_indexed_as_numpy_does() -> None:
    values = np.arange(24).reshape(2, 3, 4)
    lazy = Lazy(values.shape, values.dtype, values.__getitem__)
    assert lazy.size == 24 and len(lazy) == 2
    for key in (1, (-1, slice(None), 2), (..., 3), (0, ..., slice(1, 3)), (slice(None, None, 2), 1, 1), ...):
        np.testing.assert_array_equal(lazy[key], values[key])
    for wrong in (2, (0, 0, 0, 0), (..., 0, ...)):
        with pytest.raises(IndexError):
            lazy[wrong]
