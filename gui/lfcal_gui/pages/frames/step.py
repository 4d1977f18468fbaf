"""Assembly as a command. No Qt."""

from __future__ import annotations

from lfcal.frames import parse_origin
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, needed_file, needed_plan, options_of
from lfcal_gui.pages.frames.model import FrameSettings

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how H is made of the frames."""
    frames = needed_file(project.frames, "frames", "Frames")
    plan, chosen = needed_plan(project), FrameSettings.of(project)
    out = out or "H.h5"
    dark = chosen.dark if chosen.use_dark else "none"
    white = chosen.white if chosen.use_white else ""
    background = "border" if chosen.use_background else "none"
    pairs = (
        ("--plan", PLAN_FILE),
        ("--manifest", chosen.manifest),
        ("--pattern", chosen.pattern),
        ("--columns", chosen.columns),
        ("--first", chosen.first),
        ("--dark", dark),
        ("--white", white),
        ("--defects", chosen.use_defects),
        ("--background", background),
        ("--shift", chosen.shift or ""),
        ("--channel", chosen.channel),
        ("--interpolation", chosen.interpolation),
        ("--orientation", chosen.orientation),
        ("--origin", chosen.origin),
        ("--skip-damaged", chosen.skip_damaged),
        ("--out", out),
    )
    script = _script(frames, chosen, dark, white, background, out)
    return CommandStep(("assemble", frames, *options_of(pairs)), script, ((PLAN_FILE, plan.to_json()),))


def _script(frames: str, chosen: FrameSettings, dark: str, white: str, background: str, out: str) -> str:
    first = int(chosen.first) if chosen.first else None
    skip = without = ""
    place = f", origin={parse_origin(chosen.origin)!r}" if chosen.origin else ""
    if chosen.skip_damaged:
        skip, without = ", skip_damaged=True", "    frames = drain(iter_undamaged(frames))\n"
    return f"""
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe, corrected_view, iter_undamaged, open_frames
from lfcal.frames.orientation import oriented
from lfcal.base.progress import drain
from lfcal.psf import AssemblySettings, assemble_plan
from lfcal.psf.upright import iter_upright

plan = ScanPlan.from_json(Path({PLAN_FILE!r}).read_text(encoding="utf-8"))
recipe = CorrectionRecipe(
    dark={dark!r}, white={white!r}, defects={chosen.use_defects}, background={background!r},
    shift={chosen.shift!r}, channel={chosen.channel!r},
)
with open_frames(
    {frames!r}, manifest={chosen.manifest or None!r}, pattern={chosen.pattern or None!r},
    columns={chosen.columns!r}, first={first!r}, plan=plan{skip}{place},
) as frames:
{without}    view = corrected_view(frames, recipe, plan)
    turn, lie = drain(iter_upright(view, plan, {chosen.orientation!r}))
    upright = oriented(view, turn, plan.camera.sensor.shape)
    settings = AssemblySettings(interpolation={chosen.interpolation!r})
    print(assemble_plan(upright, plan, {out!r}, settings, provenance=lie).matrix)
"""
