"""The fault atlas of the documentation: ``python -m tests.judge.atlas`` puts every fault in and writes what is found.

Each fault is put into the clean recording of the bench camera that its tests use, and searched as by ``lfcal inspect``.
``docs/faults.md`` shows it with a picture, the numbers that were found, how it is recognised, and its remedy.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfcal.base.figures import figure, save_figure
from lfcal.base.files import replace_whole
from lfcal.base.progress import drain
from lfcal.base.units import format_share
from lfcal.judge import FAULTS, Evidence, Fault, FoundFault, iter_search
from lfcal.judge.quality import METRICS
from lfcal.judge.telling import draw_picture
from tests.judge.common import clean, evidence_of
from tests.judge.injections import INJECTIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["INJECTIONS", "chapter", "document", "parts"]

DOCS = Path(__file__).parents[2] / "docs"
PAGE, IMAGES = "faults.md", "images/faults"
MOST = 999
"""Largest significance that the page states (standard deviations)."""


# -- what is found -----------------------------------------------------------------------------------------
def found_of(name: str) -> tuple[FoundFault, Evidence]:
    """Return what is found of a fault that was put in, and the patterns that it was found in."""
    evidence = evidence_of(INJECTIONS[name].made())
    found, _ = drain(iter_search(evidence))
    own = [one for one in found if one.name == name]
    if not own:
        raise RuntimeError(f"{name}: put in, and not found but {[one.name for one in found]}")
    return own[0], evidence


# -- the page ----------------------------------------------------------------------------------------------
def parts(fault: Fault) -> tuple[str, ...]:
    """Return the lines of a fault's chapter that follow from the fault alone."""
    titles = [METRICS.get(key).title for key in fault.settles]
    metrics = f"**Checks that respond to this fault:** {', '.join(titles)}." if titles else ""
    injected = INJECTIONS[fault.name]
    return (
        f"## {fault.title[:1].upper()}{fault.title[1:]}",
        f"`{fault.name}`. {' '.join((type(fault).__doc__ or '').split())}",
        f"**Fault in this example:** {injected.what}.",
        f"**How it is recognised:** {injected.how}.",
        f"**What to do:** {fault.advice}",
        *((metrics,) if metrics else ()),
    )


def numbers(found: FoundFault) -> str:
    """Return what was found of it."""
    share = format_share(min(found.share, 1.0))
    sure = f"more than {MOST}" if found.sigmas > MOST else f"{found.sigmas:.0f}"
    said = f"*{found.fault.title}: {found.detail}.*"
    return f"**Report:** {said} The fault affects {share} of the light. Its significance is {sure} sigma."


def chapter(fault: Fault, found: FoundFault) -> str:
    """Return a fault's chapter."""
    title, name, put, how, remedy, *metrics = parts(fault)
    picture = f"![{fault.title}]({IMAGES}/{fault.name}.png)"
    return "\n\n".join([title, name, picture, put, numbers(found), how, remedy, *metrics])


HEAD = """# Fault atlas

These are the faults that `lfcal inspect` finds by comparison with the camera, in the order of its search. Each fault
was added to a simulated recording with the preset `bench` (two planes, 3,000 counts at the peak, photon and read noise,
lamp fluctuations of 0.5 % rms), and searched for in 60 patterns. Each figure shows a pattern without the fault, the
same pattern with the fault (both as the square root of the light), and the measurement that reveals the fault. The
report is the line that `lfcal inspect` prints. Numbers in parentheses are positions (plane, row, column) or pixels
(row, column), starting at 0. The affected fraction of the light is the relative L1 difference that the fault causes in
the patterns. `python -m tests.judge.atlas` makes this page.
"""


def document(chapters: list[str]) -> str:
    """Return the whole page."""
    return HEAD + "\n" + "\n\n".join(chapters) + "\n"


@contextmanager
def _drawn(found: FoundFault, evidence: Evidence) -> Iterator[Figure]:
    """Draw a pattern without the fault, the same with it, and what shows it."""
    k = _shown(found, evidence)
    place = tuple(int(v) for v in evidence.index[k])
    pure = clean()[place]
    with figure(8.6, 2.5, dpi=72) as fig:
        panels: list[Axes] = list(fig.subplots(1, 3, width_ratios=(1, 1, 1.5)))
        top = float(np.sqrt(pure.max()))
        for axes, image, title in ((panels[0], pure, "without"), (panels[1], evidence.data[k], f"with, at {place}")):
            axes.imshow(np.sqrt(np.maximum(image, 0)), vmin=0, vmax=top, cmap="viridis")
            axes.grid(False)
            axes.set_title(title)
            axes.set_xlabel("column s (px)")
        panels[0].set_ylabel("row t (px)")
        if found.picture is None:
            panels[2].set_axis_off()
        else:
            draw_picture(panels[2], found.picture)
        yield fig


def _shown(found: FoundFault, evidence: Evidence) -> int:
    """Return which pattern shows a fault most: one that it concerns, and that is changed most of all."""
    away = np.array(
        [np.abs(data - clean()[tuple(place)]).sum() for data, place in zip(evidence.data, evidence.index, strict=True)]
    )
    if len(found.positions):
        concerned = {tuple(place) for place in found.positions.tolist()}
        away[[tuple(place) not in concerned for place in evidence.index.tolist()]] = -1.0
    return int(away.argmax())


def main(arguments: list[str] | None = None) -> int:
    """Write the page and its pictures; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.judge.atlas", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS, help="folder of the documentation")
    out: Path = parser.parse_args(arguments).out
    (out / IMAGES).mkdir(parents=True, exist_ok=True)
    chapters = []
    for fault in FAULTS:
        found, evidence = found_of(fault.name)
        with _drawn(found, evidence) as fig:
            save_figure(fig, out / IMAGES / f"{fault.name}.png", colours=256)
        chapters.append(chapter(fault, found))
        print(fault.name, (out / IMAGES / f"{fault.name}.png").stat().st_size, numbers(found))
    with replace_whole(out / PAGE) as part:
        part.write_text(document(chapters), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
