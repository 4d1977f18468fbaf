"""Figure of the section on speed, drawn from its table: ``python -m docs_build.speed``."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["draw", "ratios_of", "section", "short"]

ROOT = Path(__file__).resolve().parents[1]
PAGE, PICTURE = ROOT / "docs" / "accuracy.md", ROOT / "docs" / "images" / "speed.png"

RATIO = re.compile(r"(?P<who>[^:;|]+): (?:about |over )?(?P<times>[\d,]+) times slower")


def section(page: str) -> str:
    """Return the section on speed of a page."""
    return page.partition("## Speed\n")[2].partition("\n## ")[0]


def ratios_of(page: str) -> list[tuple[str, str, float]]:
    """Return the task, the other program and its time relative to lfcal, for each row that states one."""
    found = []
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4:
            hits = RATIO.finditer(cells[2])
            found += [(cells[0], hit["who"].strip(), float(hit["times"].replace(",", ""))) for hit in hits]
    return found


def short(what: str) -> str:
    """Return the name of a task, with its error if it states one."""
    parts = what.split(", ")
    return ", ".join([parts[0], *(part for part in parts[1:] if part.endswith("error"))])


def draw(path: Path) -> None:
    """Draw bars on a logarithmic axis."""
    from lfcal.base.figures import figure, save_figure

    rows = ratios_of(section(PAGE.read_text(encoding="utf-8")))
    with figure(7, 4.6) as fig:
        axes = fig.subplots()
        axes.barh(range(len(rows)), [times for _, _, times in rows], color="#3b6ea5")
        axes.set_yticks(range(len(rows)), [f"{who}\n{short(what)}" for what, who, _ in rows], fontsize=8)
        for k, (_, _, times) in enumerate(rows):
            axes.annotate(f" {times:,.0f} ×", (times, k), va="center", fontsize=9)
        axes.axvline(1, color="black", linewidth=1)
        longest = max(times for *_, times in rows)
        axes.set(xscale="log", xlim=(0.8, 3 * longest), xlabel="time relative to lfcal, 2 cores")
        axes.invert_yaxis()
        axes.grid(False)
        axes.spines[["top", "right"]].set_visible(False)
        save_figure(fig, path)


if __name__ == "__main__":
    draw(PICTURE)
