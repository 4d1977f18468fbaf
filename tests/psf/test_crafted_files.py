"""H files whose parts lie: every command says so in one line before it uses them, and leaves nothing behind."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save

# the command line as a user runs it
from tests.cli.conftest import Run, lfcal  # noqa: F401

Craft = Callable[[h5py.File], object]
DEEP = "[" * 100_000 + "]" * 100_000
NOT_SO_DEEP = "[" * 700 + "]" * 700


def _attribute(name: str, value: object, place: str = "/") -> Craft:
    def craft(file: h5py.File) -> None:
        file[place].attrs[name] = value

    return craft


def _of_version_2(change: Craft) -> Craft:
    """Return a craft of a file that has a scale and an offset for each plane."""

    def craft(file: h5py.File) -> None:
        file.attrs["version"] = 2
        change(file)

    return craft


def _dataset(name: str, value: Any) -> Craft:
    def craft(file: h5py.File) -> None:
        kept = dict(file[name].attrs) if name in file else {}
        for link in ("entry", name):  # the entry holds a second link to some of them
            if link in file:
                del file[link]
        file.create_dataset(name, data=value).attrs.update(kept)

    return craft


def _camera(change: Callable[[dict[str, Any]], object]) -> Craft:
    def craft(file: h5py.File) -> None:
        camera = json.loads(file.attrs["camera"])
        change(camera)
        file.attrs["camera"] = json.dumps(camera)

    return craft


def _values(change: Callable[[np.ndarray], np.ndarray]) -> Craft:
    def craft(file: h5py.File) -> None:
        values = change(file["H"][()].astype(np.float32))
        if "checksum" in file:  # a stranger's file has right checksums, or none
            del file["checksum"]
        _dataset("H", values)(file)

    return craft


def _at(values: np.ndarray, value: float) -> np.ndarray:
    values[1, 0, 1, 4, 4] = value
    return values


VOID = np.void(b"\1\2\3")

REFUSED: dict[str, Craft] = {
    "anchor of words": _attribute("anchor", "left"),
    "anchor of one number": _attribute("anchor", 1.0),
    "anchor of three numbers": _attribute("anchor", [1.0, 2.0, 3.0]),
    "anchor of strings": _attribute("anchor", ["1", "2"]),
    "anchor of NaN": _attribute("anchor", [np.nan, 1.0]),
    "anchor without a value": _attribute("anchor", h5py.Empty("f8")),
    "camera of a number": _attribute("camera", 7),
    "camera of bytes": _attribute("camera", VOID),
    "camera of another format": _attribute("camera", "{}"),
    "camera that is no JSON": _attribute("camera", "{"),
    "camera of deep JSON": _attribute("camera", DEEP[:60_000]),
    "camera with an entry less": _camera(lambda c: c["sensor"].pop("black_level")),
    "camera with an entry more": _camera(lambda c: c.update(speed=1)),
    "camera with another type": _camera(lambda c: c["sensor"].update(pixel_um="5")),
    "camera with NaN": _camera(lambda c: c["sensor"].update(pixel_um=float("nan"))),
    "provenance of a number": _attribute("provenance", 7),
    "provenance without a value": _attribute("provenance", h5py.Empty("f8")),
    "provenance of deep JSON": _attribute("provenance", DEEP[:60_000]),
    "provenance of less deep JSON": _attribute("provenance", NOT_SO_DEEP),
    "provenance of a list": _attribute("provenance", "[1]"),
    "version of two": _attribute("version", [2, 2]),
    "version of words": _attribute("version", "two"),
    "version to come": _attribute("version", 99),
    "format of numbers": _attribute("format", [1, 2]),
    "format of another program": _attribute("format", "other"),
    "matrix of another kind": _attribute("matrix", "G"),
    "axes in another order": _attribute("axes", "x,y,z,s,t"),
    "region of a number": _attribute("region", 7),
    "H without a value": _dataset("H", h5py.Empty("f4")),
    "H of four axes": _dataset("H", np.zeros((2, 3, 4, 5), np.float32)),
    "H of no planes": _dataset("H", np.zeros((0, 2, 2, 9, 11), np.float32)),
    "H of an even cutout": _dataset("H", np.zeros((2, 2, 2, 8, 10), np.float32)),
    "H of strings": _dataset("H", np.zeros((2, 2, 2, 9, 11), "S4")),
    "H of complex numbers": _dataset("H", np.ones((2, 2, 2, 9, 11), np.complex64)),
    "H with NaN": _values(lambda v: _at(v, np.nan)),
    "H with infinity": _values(lambda v: _at(v, np.inf)),
    "H with minus infinity": _values(lambda v: _at(v, -np.inf)),
    "H beyond what sums hold": _values(lambda v: _at(v, 3e38)),
    "scale of NaN": _of_version_2(_attribute("scale", np.nan, "H")),
    "scale of a NaN for a plane": _of_version_2(_attribute("scale", [1.0, np.nan], "H")),
    "scale of zero": _of_version_2(_attribute("scale", 0.0, "H")),
    "scale of infinity": _of_version_2(_attribute("scale", np.inf, "H")),
    "scale of three for two planes": _of_version_2(_attribute("scale", [1.0, 1.0, 1.0], "H")),
    "scale of words": _of_version_2(_attribute("scale", "big", "H")),
    "scale of bytes": _of_version_2(_attribute("scale", VOID, "H")),
    "scaling factor of zero": _attribute("scaling_factor", 0.0, "H"),
    "scaling factor of NaN": _attribute("scaling_factor", np.nan, "H"),
    "scaling factor for each plane": _attribute("scaling_factor", [1.0, 1.0], "H"),
    "scaling factor of words": _attribute("scaling_factor", "big", "H"),
    "offset of NaN": _of_version_2(_attribute("offset", np.nan, "H")),
    "offset of words": _of_version_2(_attribute("offset", ["a", "b"], "H")),
    "depths of NaN": _dataset("depths", np.array([0.0, np.nan])),
    "depths of infinity": _dataset("depths", np.array([0.0, np.inf])),
    "depths all the same": _dataset("depths", np.array([5.0, 5.0])),
    "depths of three for two planes": _dataset("depths", np.array([0.0, 1.0, 2.0])),
    "depths of strings": _dataset("depths", np.array([b"a", b"b"])),
    "depths without a value": _dataset("depths", h5py.Empty("f8")),
    "depth sums of another shape": _dataset("depth_sum", np.zeros((2, 3, 3), np.float32)),
    "depth sums of NaN": _dataset("depth_sum", np.full((2, 9, 11), np.nan, np.float32)),
    "recorded of another shape": _dataset("recorded", np.ones((1, 1), np.uint16)),
    "recorded of NaN": _dataset("recorded", np.full((2, 2, 2), np.nan)),
}
"""Every command ends with exit code 2."""

DARK: dict[str, Craft] = {
    "H of zeros": _values(lambda v: v * 0),
    "H below zero": _values(lambda v: -1 - v),
    "scale below zero": _of_version_2(_attribute("scale", [-1.0, -1.0], "H")),
}
"""Values that can be carried over as they are, but not used."""

COMMANDS = {
    "export": ("export", "H.h5", "-o", "out.npy"),
    "export mat": ("export", "H.h5", "-o", "out.mat"),
    "transpose": ("transpose", "H.h5", "-o", "out.h5"),
    "inspect": ("inspect", "H.h5"),
    "reconstruct": ("reconstruct", "H.h5", "light.tif", "-o", "out.tif", "-n", "2"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rng = np.random.default_rng(0)
    window = np.outer(np.hanning(11)[1:-1], np.hanning(13)[1:-1])
    values = (rng.random((2, 2, 2, 9, 11)) * window).astype(np.float32)
    matrix = PSFMatrix(values, depths=(0.0, 100.0), camera=preset("bench"), anchor=(8.0, 9.0))
    save(matrix, tmp_path / "H.h5")
    tifffile.imwrite(tmp_path / "light.tif", rng.poisson(200, (20, 24)).astype(np.uint16))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _run(lfcal: Callable[..., Run], folder: Path, command: str) -> Run:  # noqa: F811
    run = lfcal(*COMMANDS[command])
    assert run.code in (0, 2), (command, run.err)
    assert "Traceback" not in run.err and "Warning" not in run.err, (command, run.err)
    if run.code:
        # a solver says what it will cost before it works
        lines = [line for line in run.err.strip().splitlines() if " set-up " not in line]
        assert len(lines) == 1 and len(run.err) < 620, (command, run.err)
        assert sorted(path.name for path in folder.iterdir()) == ["H.h5", "light.tif"], command
    for path in folder.glob("out.*"):
        path.unlink()
    return run


@pytest.mark.few(6)
@pytest.mark.parametrize("case", REFUSED)
def test_every_command_refuses(case: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    with h5py.File(folder / "H.h5", "r+") as file:
        REFUSED[case](file)
    codes = {command: _run(lfcal, folder, command).code for command in COMMANDS}
    assert set(codes.values()) == {2}, codes


@pytest.mark.few(1)
@pytest.mark.parametrize("case", DARK)
def test_values_without_light_are_reported(case: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    with h5py.File(folder / "H.h5", "r+") as file:
        DARK[case](file)
    assert _run(lfcal, folder, "reconstruct").code == 2
    inspected = _run(lfcal, folder, "inspect")
    assert inspected.code == 2 or "should not be used" in inspected.out
    for command in ("export", "export mat", "transpose"):
        _run(lfcal, folder, command)


@pytest.mark.few(2)
@pytest.mark.parametrize("command", COMMANDS)
def test_the_good_file_is_accepted(command: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    assert _run(lfcal, folder, command).code == 0
