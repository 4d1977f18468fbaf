"""The documented camera format works, and the page lists all formats."""

from __future__ import annotations

from pathlib import Path

from lfcal.camera import CAMERA_FORMATS, ImportOptions
from tests.distribution import names_of

PAGE = Path(__file__).parents[3] / "docs/camera.md"


def test_a_format_of_your_own() -> None:
    found = names_of("extending.md", "A camera format")
    form, note = found["FORMAT"], "# lab camera\npitch = 125\n"
    assert form.recognises(note)
    imported = form.read(note, Path("x.lab"), ImportOptions({"optics.magnification": 40.0}))
    camera = imported.camera
    assert (camera.lattice.pitch_um, camera.lattice.gap_um, camera.magnification) == (125, 2500, 40)
    assert camera.marks["lattice.gap_um"] == "derived" and camera.marks["sensor.pixel_um"] == "assumed"


def test_every_format_is_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in CAMERA_FORMATS.names():
        assert name.split()[0] in text, name
