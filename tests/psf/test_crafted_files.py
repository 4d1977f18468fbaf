"""H files whose parts lie: the library and every command say so in one line before they use them, and leave nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import LfcalError
from lfcal.camera import preset
from lfcal.psf import PSFMatrix, open_psf, save

# the command line as a user runs it
from tests.cli.conftest import Run, lfcal  # noqa: F401

Craft = Callable[[h5py.File], object]
DEEP = "[" * 30_000 + "]" * 30_000
NOT_SO_DEEP = "[" * 700 + "]" * 700
NAN, INF, VOID, EMPTY = np.nan, np.inf, np.void(b"\1\2\3"), h5py.Empty("f8")


def _attribute(name: str, value: object, place: str = "/", version: int | None = None) -> Craft:
    def craft(file: h5py.File) -> None:
        if version is not None:
            file.attrs["version"] = version
        file[place].attrs[name] = value

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


def _at(value: float) -> Craft:
    def change(values: np.ndarray) -> np.ndarray:
        values[1, 0, 1, 4, 4] = value
        return values

    return _values(change)


ATTRIBUTES: dict[str, list[Any]] = {
    "anchor": ["left", 1.0, [1.0, 2.0, 3.0], ["1", "2"], [NAN, 1.0], EMPTY],
    "camera": [7, VOID, "{}", "{", DEEP],
    "provenance": [7, EMPTY, DEEP, NOT_SO_DEEP, "[1]"],
    "version": [[2, 2], "two", 99],
    "format": [[1, 2], "other"],
    **{"matrix": ["G"], "axes": ["x,y,z,s,t"], "region": [7]},
}
OF_VERSION_2: dict[str, list[Any]] = {
    "scale": [NAN, [1.0, NAN], 0.0, INF, [1.0, 1.0, 1.0], "big", VOID],
    "offset": [NAN, ["a", "b"]],
}
"""A scale and an offset for each plane."""
CAMERAS: list[Callable[[dict[str, Any]], object]] = [
    lambda camera: camera["sensor"].pop("black_level"),
    lambda camera: camera.update(speed=1),
    lambda camera: camera["sensor"].update(pixel_um="5"),
    lambda camera: camera["sensor"].update(pixel_um=NAN),
]
EVEN, BYTES, COMPLEX = ((2, 2, 2, 8, 10), "f4"), ((2, 2, 2, 9, 11), "S4"), ((2, 2, 2, 9, 11), "c8")
DATASETS: dict[str, list[Any]] = {
    "H": [h5py.Empty("f4"), *(np.zeros(*one) for one in (((2, 3, 4, 5), "f4"), ((0, 2, 2, 9, 11), "f4"), EVEN, BYTES))],
    "depths": [[0.0, NAN], [0.0, INF], [5.0, 5.0], [0.0, 1.0, 2.0], np.array([b"a", b"b"]), EMPTY],
    "depth_sum": [np.zeros((2, 3, 3), np.float32), np.full((2, 9, 11), NAN, np.float32)],
    "recorded": [np.ones((1, 1), np.uint16), np.full((2, 2, 2), NAN)],
}
REFUSED: dict[str, Craft] = {
    **{f"{name} = {v!r:.30}": _attribute(name, v) for name, values in ATTRIBUTES.items() for v in values},
    **{f"{name} = {v!r:.30}": _attribute(name, v, "H", 2) for name, values in OF_VERSION_2.items() for v in values},
    **{f"scaling factor {v!r}": _attribute("scaling_factor", v, "H") for v in (0.0, NAN, [1.0, 1.0], "big")},
    **{f"camera {k}": _camera(change) for k, change in enumerate(CAMERAS)},
    **{f"{name} {k}": _dataset(name, v) for name, values in DATASETS.items() for k, v in enumerate(values)},
    "complex H": _dataset("H", np.ones(*COMPLEX)),
    **{f"H with {v}": _at(v) for v in (NAN, INF, -INF, 3e38)},
}
DARK: dict[str, Craft] = {
    "H of zeros": _values(lambda v: v * 0),
    "H below zero": _values(lambda v: -1 - v),
    "scale below zero": _attribute("scale", [-1.0, -1.0], "H", 2),
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


def _crafted(folder: Path, craft: Craft) -> None:
    with h5py.File(folder / "H.h5", "r+") as file:
        craft(file)


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


def test_the_library_refuses_every_lie(folder: Path) -> None:
    """A file is refused when it is opened, or when its planes are copied."""
    whole = (folder / "H.h5").read_bytes()
    for case, craft in REFUSED.items():
        (folder / "H.h5").write_bytes(whole)
        _crafted(folder, craft)
        with pytest.raises(LfcalError) as error:
            with open_psf("H.h5") as H:
                save(H, "copy.h5")
        assert "\n" not in str(error.value) and len(str(error.value)) < 600, case
        assert not (folder / "copy.h5").exists(), case


@pytest.mark.few(1)
@pytest.mark.parametrize("case", REFUSED)
def test_every_command_refuses(case: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    _crafted(folder, REFUSED[case])
    codes = {command: _run(lfcal, folder, command).code for command in COMMANDS}
    assert set(codes.values()) == {2}, codes


@pytest.mark.few(1)
@pytest.mark.parametrize("case", DARK)
def test_values_without_light_are_reported(case: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    _crafted(folder, DARK[case])
    assert _run(lfcal, folder, "reconstruct").code == 2
    inspected = _run(lfcal, folder, "inspect")
    assert inspected.code == 2 or "should not be used" in inspected.out
    for command in ("export", "export mat", "transpose"):
        _run(lfcal, folder, command)


@pytest.mark.few(1)
@pytest.mark.parametrize("command", COMMANDS)
def test_the_good_file_is_accepted(command: str, folder: Path, lfcal: Callable[..., Run]) -> None:  # noqa: F811
    assert _run(lfcal, folder, command).code == 0
