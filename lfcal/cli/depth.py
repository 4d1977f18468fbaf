"""``lfcal depth``: measure a depth and confidence map from one light-field frame of any plenoptic camera."""

from __future__ import annotations

from lfcal.base import format_seconds
from lfcal.cli._console import print_result, print_written
from lfcal.tasks import MeasuredDepth


def show(made: tuple[MeasuredDepth, ...]) -> None:
    """Print lattice, method, size, range of depths and scale of each depth map, and the files."""
    for one in made:
        assert one.out is not None
        facts = one.to_dict()
        rows, columns = facts["shape"]
        unit = "µm" if facts["unit"] == "um" else "(slope)"
        spread = "none: no place has enough texture"
        if facts["depths"]:
            low, middle, high = facts["depths"]
            spread = f"{low:.5g} to {high:.5g} {unit}, median {middle:.5g}"
        table = [
            ["lattice", f"of {one.lattice}"],
            ["matched", one.found.method],
            ["samples", f"{rows} x {columns}, {100 * facts['known']:.1f} % with a depth"],
            ["depths", spread],
            ["scale", f"of {one.scale}" if one.scale else "none: give --camera or --psf for depths in µm"],
            ["points", "no cloud" if one.points is None else str(one.points)],
            ["time", format_seconds(one.seconds)],
        ]
        print_result(facts, ["depth map", one.out.name], table, json=False)
        print_written(one.out, *([one.cloud] if one.cloud else []))
