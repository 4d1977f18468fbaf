"""What an installation contains: the wheel is small, and optional libraries stay optional."""

from __future__ import annotations

import tomllib
import zlib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
WHEEL = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
UNSHIPPED = {"__pycache__", ".nbi", ".nbc", ".pyc"}
NAMES = 120
"""Bytes that a wheel needs for each file besides its content."""


def packed(place: Path) -> int:
    """Return the bytes that a file or folder takes in a wheel."""
    files = [place] if place.is_file() else [path for path in place.rglob("*") if path.is_file()]
    kept = [path for path in files if not UNSHIPPED & {path.suffix, path.parent.name}]
    assert kept, f"{place}: nothing to ship"
    return sum(len(zlib.compress(path.read_bytes())) + NAMES + 2 * len(str(path.relative_to(ROOT))) for path in kept)


def test_the_wheel_is_below_6_megabytes() -> None:
    assert sum(packed(ROOT / place) for place in (*WHEEL["packages"], *WHEEL["force-include"])) < 6e6
