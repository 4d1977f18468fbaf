"""``lfcal demo``: run the main workflow from end to end on the sample session."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import format_length, format_seconds, read_text
from lfcal.cli._console import print_json, print_table, run_work
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix


FILES = ("H.h5", "H_and_HT.png", "depth_sums.png", "truth.h5", "recorded_H.h5", "H.mat")
"""Files that are written besides the report."""

REPORT = "report"


Step = tuple[str, str, float]
"""Title, products, and seconds of a step."""


@contextmanager
def _step(steps: list[Step], title: str) -> Iterator[list[str]]:
    """Time a step; the block appends the names of its products to the yielded list."""
    start = time.perf_counter()
    made: list[str] = []
    yield made
    steps.append((title, ", ".join(made), time.perf_counter() - start))


def command(
    out: Path = typer.Argument(Path("demo_out"), help="Folder to write into."),
    *,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Run the main workflow on the sample session: frames, H, its transpose, pictures, a report, a MATLAB file.

    Example: `lfcal demo demo_out`
    """
    from lfcal.judge.report import report_files
    from lfcal.tasks import check_outputs

    check_outputs([*(out / name for name in FILES), *report_files(out / REPORT)], force=force)
    steps: list[Step] = []
    with ExitStack() as files:
        found = _made(out, steps, files, quiet=json)
    if json:
        done = [{"step": title, "made": made, "seconds": seconds} for title, made, seconds in steps]
        del found["camera"]
        print_json({"out": out, "steps": done, **found})
        return
    print_table(
        ["step", "made", "time"],
        [[title, made, format_seconds(seconds)] for title, made, seconds in steps],
        title=f"H (z, y, x, t, s) = {found['shape']} from {found['camera']}, written to {out}/",
    )
    typer.echo(f"check: {found['words']}")
    typer.echo(f"check: correlation with the recorded session {found['recorded_correlation']:.4f}")
    typer.echo(f"next: open {out / 'report' / 'index.html'} in a browser, or run lfcal-gui --demo")


def _made(out: Path, steps: list[Step], files: ExitStack, *, quiet: bool) -> dict[str, Any]:
    """Carry out all steps, and return the results of the comparisons; matrices are open until ``files`` are closed."""
    from lfcal.camera import ScanPlan
    from lfcal.frames import CorrectionRecipe
    from lfcal.judge import compare
    from lfcal.judge.report import iter_report
    from lfcal.psf import AssemblySettings, PSFMatrix, iter_export
    from lfcal.simulate import sample_recording, sample_session, simulate_psf
    from lfcal.tasks import Assemble

    def assembled(**given: Any) -> PSFMatrix:
        (one,) = run_work(Assemble(settings=AssemblySettings(strict=True), **given).work(), quiet=quiet)
        files.callback(one.close)
        made.append(f"{one.out.name} from {one.report.frames} frames")
        matrix: PSFMatrix = one.report.matrix
        return matrix

    session = sample_session()
    plan = ScanPlan.from_json(read_text(session / "plan.json"))
    with _step(steps, "frames, corrected and cropped with the shifting cutout") as made:
        recipe = CorrectionRecipe(dark=session / "dark", white=session / "white")
        given = {"frames": session / "frames", "plan": session / "plan.json", "corrections": recipe}
        matrix = assembled(out=out / "H.h5", **given)
    _pictures(matrix, out, steps)
    with _step(steps, "the same H simulated directly, and compared") as made:
        # the sample comes from a simulated camera, so the truth is known
        truth = files.enter_context(simulate_psf(plan, "auto", tolerance=0.05, out=out / "truth.h5"))
        found = compare(matrix, truth)
        made.append("truth.h5")
    with _step(steps, "a recorded session with its dark frames") as made:
        own = assembled(frames=sample_recording(), out=out / "recorded_H.h5")
        recorded = compare(own, PSFMatrix(truth.plane(0)[None], depths=own.depths))
    with _step(steps, "quality report") as made:
        run_work(iter_report(matrix, out / REPORT), quiet=quiet)
        made.append("report/index.html")
    with _step(steps, "export for the published codes") as made:
        run_work(iter_export(matrix, out / "H.mat"), quiet=quiet)
        made.append("H.mat (H, Ht, Nnum, CAindex, x3objspace)")
    words = f"correlation with the simulated truth {found.correlation:.4f}, largest centroid shift "
    return {
        "shape": plan.shape,
        "camera": plan.camera.name,
        "correlation": found.correlation,
        "max_shift_px": found.max_shift_px,
        "words": words + f"{found.max_shift_px:.2f} px",
        "recorded_correlation": recorded.correlation,
    }


def _pictures(matrix: PSFMatrix, out: Path, steps: list[Step]) -> None:
    from lfcal.base import draw_image, figure, save_figure

    z, y, x = len(matrix) // 2, matrix.period[0] // 2, matrix.period[1] // 2
    with _step(steps, "one slice of the transposed matrix, without building it") as made, figure(9, 3.4) as fig:
        left, right = fig.subplots(1, 2)
        where = f"z = {format_length(float(matrix.depths[z]))}, y {y}, x {x}"
        draw_image(left, matrix[z, y, x], title=f"H: a point on the sensor ({where})", unit="counts")
        draw_image(
            right,
            matrix.T[z, y, x],
            title="HT: a pixel in the volume",
            unit="counts",
            xlabel="voxel column s (px)",
            ylabel="voxel row t (px)",
        )
        save_figure(fig, out / "H_and_HT.png")
        made.append("H_and_HT.png")
    with _step(steps, "depth-plane sums: the aperture from every depth") as made, figure(3.2 * len(matrix), 3) as fig:
        for k, axes in enumerate(fig.subplots(1, len(matrix), squeeze=False)[0]):
            draw_image(axes, matrix.depth_sum(k), title=f"z = {format_length(float(matrix.depths[k]))}", unit="counts")
        save_figure(fig, out / "depth_sums.png")
        made.append("depth_sums.png")
