from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from lfcal.camera import LatticeDistortion
from lfcal.cli import white
from tests.lattice.white_frames import barrel, draw_white

SHAPE = (300, 360)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("white files")
    truth = draw_white(SHAPE, 12.3, bend=barrel(2.0, math.hypot(*SHAPE) / 2), seed=1)
    np.save(folder / "white.npy", truth.frame)
    app = typer.Typer()
    app.command()(white.command)
    done = CliRunner().invoke(app, [str(folder / "white.npy"), "-o", str(folder / "out")])
    assert done.exit_code == 0, done.output
    return folder / "out", done.output


def test_the_lattice_is_written_without_a_camera(written: tuple[Path, str]) -> None:
    data = json.loads((written[0] / "lattice.json").read_text())
    assert (data["format"], data["version"], data["form"]) == ("lfcal-lattice", 1, "radial")
    bend = data["distortion"]
    made = LatticeDistortion(bend["model"], bend["centre_px"], bend["scale_px"], bend["terms_px"])
    assert made.terms[0][0] == pytest.approx(2.0, abs=5 * data["errors"]["distortion_terms_px"][0][0])
    assert data["pitch_px"] == pytest.approx(12.3, abs=0.01)


def test_every_lenslet_has_a_line(written: tuple[Path, str]) -> None:
    with (written[0] / "residuals.csv").open(newline="") as table:
        lines = list(csv.DictReader(table))
    data = json.loads((written[0] / "lattice.json").read_text())
    assert len(lines) == data["lenslets"]
    assert sum(line["dead"] == "1" for line in lines) == len(data["dead"]) > 0
    assert all((line["residual_row_px"] == "") == (line["dead"] == "1") for line in lines)
    left = [float(line["residual_row_px"]) for line in lines if line["dead"] == "0"]
    assert math.sqrt(np.mean(np.square(left))) < 0.06
    assert (written[0] / "residuals.png").stat().st_size > 5000


def test_model_numbers_errors_and_reason_are_shown(written: tuple[Path, str]) -> None:
    for shown in ("radial: removes", "±", "centre"):
        assert shown in written[1]


def test_distortion_is_shown_as_pitch_and_largest_displacement(written: tuple[Path, str]) -> None:
    data, shown = json.loads((written[0] / "lattice.json").read_text()), " ".join(written[1].split())
    assert "k1" not in shown, "coefficients are in the file"
    low, high, centre = (
        float(re.search(pattern, shown)[1])  # type: ignore[index]
        for pattern in (
            r"pitch over the field ([\d.]+) to",
            r"pitch over the field [\d.]+ to ([\d.]+) px",
            r"pitch at the centre ([\d.]+) px",
        )
    )
    # barrel of 2 px at the corner: d(2 u³)/dr is 0 in the middle, and largest far outside
    assert centre == pytest.approx(data["pitch_px"], abs=0.02) and low <= centre < high
    assert "largest distortion 1." in shown or "largest distortion 2." in shown
