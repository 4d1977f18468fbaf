"""A folder of another lab: a maker's XML, an Excel list of the stage, TIFFs. Four commands lead to H and its report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import open_psf
from tests.cli.conftest import Lfcal

SHAPE, PIXEL, FOCAL, AWAY, GAP = (132, 144), 5.5, 100e3, 500e3, 150.0
START, RADIUS = np.array([60.0, 62.0]), 9.0
XML = """<?xml version="1.0" encoding="utf-16"?>
<RayCalibData version="1.0">
  <offset units="pix"><x>2.25</x><y>1.5</y></offset>
  <diameter units="pix">{pitch}</diameter>
  <rotation units="rad">0.0002</rotation>
  <lens_border units="pix">1</lens_border>
  <tcp units="virtual_depth">2.11</tcp>
  <lens_base_x units="lens"><x>1</x><y>0</y></lens_base_x>
  <lens_base_y units="lens"><x>0.5</x><y>0.866025</y></lens_base_y>
  <sub_grid_base units="lens"><x>3</x><y>1.732051</y></sub_grid_base>
  <distortion type="radial"><function>constant</function></distortion>
  <lens_type id="0"><offset units="lens"><x>0</x><y>0</y></offset>
    <depth_range units="virtual_depth"><min>1</min><max>3</max></depth_range></lens_type>
  <lens_type id="1"><offset units="lens"><x>1</x><y>0</y></offset>
    <depth_range units="virtual_depth"><min>2.8</min><max>4</max></depth_range></lens_type>
  <lens_type id="2"><offset units="lens"><x>2</x><y>0</y></offset>
    <depth_range units="virtual_depth"><min>3.8</min><max>100</max></depth_range></lens_type>
</RayCalibData>
"""


def picture(place: np.ndarray, pitch: float, rng: np.random.Generator) -> np.ndarray:
    """Return a frame: micro-images of a point at ``place``, drawn in the pixels of a lattice that stands still."""
    out = np.full(SHAPE, 100.0)
    j, i = np.mgrid[-20:21, -20:21].reshape(2, -1)
    lattice = np.stack([64.0 + j * pitch * np.sqrt(0.75), 73.75 + (i + 0.5 * (j % 2)) * pitch], axis=1)
    shares = np.clip((RADIUS - np.hypot(*(lattice - place).T)) / pitch + 0.5, 0, 1)
    for at, share in zip(lattice[shares > 0], shares[shares > 0], strict=True):
        seen = at + (at - place) / 4
        rows, columns = (np.exp(-((np.arange(n) - c) ** 2) / 2) for n, c in zip(SHAPE, seen, strict=True))
        out += 3000 * share * np.outer(rows, columns)
    return np.rint(out + rng.normal(0, 3, SHAPE)).astype(np.uint16)


def foreign_folder(root: Path, pitch: float, period: tuple[int, int], planes: tuple[float, ...]) -> Path:
    """Write XML, list and frames of a serpentine scan; depths are of the stage, 7 mm from those of the camera."""
    (root / "Aufnahmen für H").mkdir(parents=True)
    (root / "Kalibrierung.xml").write_bytes(XML.format(pitch=pitch).encode("utf-16"))
    lines, rng = ["Dateiname;Pos X (mm);Pos Y (mm);Pos Z (mm);Belichtung (ms);"], np.random.default_rng(1)
    image = 1 / (1 / FOCAL - 1 / AWAY)
    for z in planes:
        step = PIXEL * (AWAY + z) / (image + GAP)
        for y in range(period[0]):
            for x in range(period[1])[:: 1 if y % 2 == 0 else -1]:
                place = START + np.array([y, x])
                name = f"Aufnahme {len(lines):04d} ü.tif"
                tifffile.imwrite(root / "Aufnahmen für H" / name, picture(place, pitch, rng))
                middle = (np.array(SHAPE) - 1) / 2
                stage = [12.3 + (place[1] - middle[1]) * step / 1e3, (place[0] - middle[0]) * step / 1e3, z / 1e3 + 7]
                cells = [f"{value:.5f}".replace(".", ",") for value in stage]
                lines.append(";".join([name, *cells, "20", ""]))
    (root / "Tisch.csv").write_bytes(("\ufeff" + "\r\n".join([*lines, ";;;;;", ""])).encode())
    return root


def three_commands(lfcal: Lfcal, root: Path) -> tuple[Path, str]:
    """Run import, plan and assemble as docs/tutorials/frames.md does; return H and everything printed by the last."""
    tiffs, listed, plan, out = root / "Aufnahmen für H", root / "Tisch.csv", root / "plan.json", root / "H.h5"
    optics = ("--sensor", f"{SHAPE[0]}x{SHAPE[1]},{PIXEL}", "--lens", "100,4,500")
    lfcal("camera", "import", root / "Kalibrierung.xml", *optics, "-o", root / "c.json").ok()
    lfcal("plan", root / "c.json", "--positions", listed, "--frames", tiffs, "-o", plan).ok()
    done = lfcal("assemble", tiffs, "--manifest", listed, "--plan", plan, "--black-level", 100, "-o", out).ok()
    return out, done.out + done.err


def test_a_makers_xml_leads_to_h(lfcal: Lfcal, tmp_path: Path) -> None:
    out, said = three_commands(lfcal, foreign_folder(tmp_path / "f", 4.0, (7, 12), (-37e3,)))
    assert "plan: assumed values of the camera: gap between lenslets and sensor" in said
    with open_psf(out) as matrix:
        assert matrix.shape[:3] == (1, 7, 12)
        assert matrix.depths[0] == pytest.approx(-37e3, abs=1e3), "the stage's zero is found from the steps"
        whole = np.asarray(matrix)[0].sum(axis=(2, 3))
        assert np.ptp(whole) < 0.25 * whole.mean(), "every pattern is whole"
        reach = matrix.shape[3] // 2
        frame = tifffile.imread(tmp_path / "f" / "Aufnahmen für H" / "Aufnahme 0001 ü.tif").astype(float) - 100
        row, column = map(int, matrix.anchor)
        cut = frame[row - reach : row + reach + 1, column - reach : column + reach + 1]
        np.testing.assert_allclose(matrix[0, 0, 0], cut, atol=1)


@pytest.mark.long
def test_a_makers_xml_leads_to_a_report(lfcal: Lfcal, tmp_path: Path) -> None:
    out, _ = three_commands(lfcal, foreign_folder(tmp_path / "f", 6.0, (10, 18), (-37e3, -30e3)))
    assert "assumed values of the camera: gap" in lfcal("inspect", out, "--report", tmp_path / "report").ok().err
    assert (tmp_path / "report" / "index.html").exists()
    told = lfcal("inspect", out, "--json")
    assert "lattice.gap_um" in json.loads(told.out)["assumed"] and "assumed" not in told.err
