"""``lfcal demo``: the main job, end to end, on the recorded sample session."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._options import ForceOption, JsonOption, WorkersOption

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import Frames
    from lfcal.psf import PSFMatrix


FILES = ("H.h5", "H_and_HT.png", "depth_sums.png", "truth.h5", "recorded_H.h5", "H.mat")
"""What is written besides the report."""

REPORT = "report"


def register(app: typer.Typer) -> None:
    """Add ``demo`` to the app."""
    app.command("demo")(command)


@dataclass
class _Steps:
    """What was made, and how long each step took."""

    rows: list[tuple[str, str, float]] = field(default_factory=list)

    @contextmanager
    def step(self, title: str) -> Iterator[list[str]]:
        """Time a step; the block puts what it made into the list it is given."""
        start = time.perf_counter()
        made: list[str] = []
        yield made
        self.rows.append((title, ", ".join(made), time.perf_counter() - start))


def command(
    out: Path = typer.Argument(Path("demo_out"), help="Folder to write into."),
    *,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Run the main job on the sample session: frames, H, its transpose, pictures, a report, a MATLAB file.

    Example: `lfcal demo demo_out`
    """
    from lfcal.base import format_seconds
    from lfcal.cli._console import print_json, print_table
    from lfcal.cli.sample import sample_session
    from lfcal.judge.report import report_files
    from lfcal.tasks import ScanFrames, check_outputs

    check_outputs([*(out / name for name in FILES), *report_files(out / REPORT)], force=force)
    session = sample_session()
    source, plan = ScanFrames(session / "frames", session / "plan.json").open()
    steps = _Steps()
    with _assembled(source, session, plan, out, steps, quiet=json) as matrix:
        _pictures(matrix, out, steps)
        check = _against_truth(matrix, plan, out, steps)
        check |= _recorded(out, steps, quiet=json)
        _report(matrix, out, steps, quiet=json)
        _export(matrix, out, steps, quiet=json)
    if json:
        print_json(
            {
                "out": out,
                "shape": plan.shape,
                "steps": [{"step": title, "made": made, "seconds": seconds} for title, made, seconds in steps.rows],
                **check,
            }
        )
        return
    print_table(
        ["step", "made", "time"],
        [[title, made, format_seconds(seconds)] for title, made, seconds in steps.rows],
        title=f"H (z, y, x, t, s) = {plan.shape} from {plan.camera.name}, written to {out}/",
    )
    typer.echo(f"check: {check['words']}")
    typer.echo(f"check: correlation of the recorded session with it {check['recorded_correlation']:.4f}")
    typer.echo(f"next: open {out / 'report' / 'index.html'} in a browser, or run lfcal-gui --demo")


@contextmanager
def _assembled(
    source: Frames, session: Path, plan: ScanPlan, out: Path, steps: _Steps, *, quiet: bool
) -> Iterator[PSFMatrix]:
    from lfcal.cli._console import run_work
    from lfcal.frames import CorrectionRecipe, corrected_view
    from lfcal.psf import AssemblySettings, iter_assemble_plan

    with steps.step("frames, corrected and cropped with the shifting cutout") as made:
        with source:
            recipe = CorrectionRecipe(dark=session / "dark", white=session / "white")
            view = corrected_view(source, recipe, plan)
            work = iter_assemble_plan(view, plan, out / "H.h5", AssemblySettings(strict=True))
            report = run_work(work, quiet=quiet)
        made.append(f"H.h5 from {report.frames} frames")
    with report.matrix as matrix:
        yield matrix


def _pictures(matrix: PSFMatrix, out: Path, steps: _Steps) -> None:
    from lfcal.base import draw_image, figure, format_length, save_figure

    z, y, x = len(matrix) // 2, matrix.period[0] // 2, matrix.period[1] // 2
    with steps.step("one slice of the transposed matrix, without building it") as made, figure(9, 3.4) as fig:
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
    with steps.step("depth-plane sums: the aperture from every depth") as made, figure(3.2 * len(matrix), 3) as fig:
        for k, axes in enumerate(fig.subplots(1, len(matrix), squeeze=False)[0]):
            draw_image(axes, matrix.depth_sum(k), title=f"z = {format_length(float(matrix.depths[k]))}", unit="counts")
        save_figure(fig, out / "depth_sums.png")
        made.append("depth_sums.png")


def _against_truth(matrix: PSFMatrix, plan: ScanPlan, out: Path, steps: _Steps) -> dict[str, Any]:
    """Simulate the same H directly and compare: the sample camera's truth is known."""
    from lfcal.judge import compare
    from lfcal.simulate import simulate_psf

    with steps.step("the same H simulated directly, and compared") as made:
        truth = simulate_psf(plan, "auto", tolerance=0.05, out=out / "truth.h5")
        with truth:
            found = compare(matrix, truth)
        made.append("truth.h5")
    # the sample camera is simulated, so the truth is known.
    words = f"correlation with the simulated truth {found.correlation:.4f}, largest centroid shift "
    words += f"{found.max_shift_px:.2f} px"
    return {"correlation": found.correlation, "max_shift_px": found.max_shift_px, "words": words}


def _recorded(out: Path, steps: _Steps, *, quiet: bool) -> dict[str, Any]:
    """Assemble the session that lfcal recorded itself, its own darks subtracted, and compare its plane."""
    from lfcal.cli._console import run_work
    from lfcal.cli.sample import sample_recording
    from lfcal.frames import CorrectionRecipe, corrected_view
    from lfcal.judge import compare
    from lfcal.psf import AssemblySettings, PSFMatrix, iter_assemble_plan, open_psf
    from lfcal.tasks import ScanFrames

    with steps.step("a recorded session, with the darks it brings") as made:
        source, plan = ScanFrames(sample_recording()).open()
        with source:
            view = corrected_view(source, CorrectionRecipe(), plan)
            target = out / "recorded_H.h5"
            report = run_work(iter_assemble_plan(view, plan, target, AssemblySettings(strict=True)), quiet=quiet)
        with report.matrix as matrix, open_psf(out / "truth.h5") as truth:
            found = compare(matrix, PSFMatrix(truth.plane(0)[None], depths=matrix.depths))
        made.append(f"recorded_H.h5 from {report.frames} frames")
    return {"recorded_correlation": found.correlation}


def _report(matrix: PSFMatrix, out: Path, steps: _Steps, *, quiet: bool) -> None:
    from lfcal.cli._console import run_work
    from lfcal.judge.report import iter_report

    with steps.step("quality report") as made:
        run_work(iter_report(matrix, out / REPORT), quiet=quiet)
        made.append("report/index.html")


def _export(matrix: PSFMatrix, out: Path, steps: _Steps, *, quiet: bool) -> None:
    from lfcal.cli._console import run_work
    from lfcal.psf import iter_export

    with steps.step("export for the published codes") as made:
        run_work(iter_export(matrix, out / "H.mat"), quiet=quiet)
        made.append("H.mat (H, Ht, Nnum, CAindex, x3objspace)")
