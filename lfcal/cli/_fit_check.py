"""``lfcal fit --check``: whether an old H still holds, from new frames."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.fit import Compared, NewFrame
    from lfcal.frames import CorrectionRecipe, FrameSource
    from lfcal.judge import Check
    from lfcal.psf import PSFMatrix

__all__ = ["CheckRequest", "check_h", "new_frame", "single_frames"]

NAMES = ("*z{z}_y{y}_x{x}.*", "*y{y}_x{x}.*")
"""Names of single files that say where their source is."""

NEAR_DEPTH = 0.02
"""Share of a depth by which that of a plane may be another and be the same."""


@dataclass(frozen=True)
class CheckRequest:
    """What is asked of an old H, and how frames are read.

    Attributes
    ----------
    noise
        Constant and slope of a sample's variance; None: what frames or H state.
    limit
        Error up to which H holds (relative L2).
    most
        Frames that are taken of a folder or session, spread evenly; 0: all.
    plan
        Scan plan of frames in a folder.
    recipe
        Their corrections.
    orientation
        What makes them upright.
    """

    noise: tuple[float, float] | None
    limit: float
    most: int
    plan: Path | None
    recipe: CorrectionRecipe
    orientation: str


def check_h(old: Path, sources: list[Path], asked: CheckRequest, *, json: bool) -> bool:
    """Hold new frames against an old H; print the answer, and return whether it holds."""
    from lfcal.cli._console import print_json, run_work
    from lfcal.judge import iter_check
    from lfcal.tasks import open_matrix

    with open_matrix(old) as opened:
        H = opened.T if opened.is_transposed else opened
        with ExitStack() as stack:
            frames = [frame for source in sources for frame in _frames(H, source, asked, stack, quiet=json)]
            found = run_work(iter_check(H, frames, noise=asked.noise, limit=asked.limit), quiet=json)
    if json:
        print_json(check_dict(found) | {"h": old, "frames_from": sources})
    else:
        _show(found)
    return found.holds is True


def _frames(H: PSFMatrix, source: Path, asked: CheckRequest, stack: ExitStack, *, quiet: bool) -> list[NewFrame]:
    """Return the frames of a file, a folder or a session, with what is known of where their sources are."""
    from lfcal.cli._orientation import upright
    from lfcal.frames import corrected_view, named_orientation, oriented
    from lfcal.judge import plan_of
    from lfcal.psf import AUTO, CHECK
    from lfcal.tasks import ScanFrames, find_plan

    own = plan_of(H)
    scanned = source.is_dir() and ((source / "session.json").is_file() or find_plan(source, asked.plan) is not None)
    if scanned:
        scan, plan = ScanFrames(source, asked.plan, orientation=asked.orientation).open()
        stack.enter_context(scan)
        _check_colours(scan, plan, source)
        view, _ = upright(corrected_view(scan, asked.recipe, plan), plan, asked.orientation, quiet=quiet)
        _check_grid(H, view, plan, source)
        return [_of_scan(H, view, plan, k) for k in _chosen(view, plan, asked.most)]
    single = single_frames(source, stack)
    if own is not None:
        _check_colours(single, own, source)
    seen: FrameSource = corrected_view(single, asked.recipe, own)
    if asked.orientation not in (AUTO, CHECK):
        shape = seen.shape if own is None else own.camera.sensor.shape
        seen = oriented(seen, named_orientation(asked.orientation), shape)
    _check_grid(H, seen, own, source)
    names = range(len(seen)) if not asked.most else np.unique(np.linspace(0, len(seen) - 1, asked.most).astype(int))
    return [_of_file(H, seen, int(k)) for k in names]


def single_frames(source: Path, stack: ExitStack) -> FrameSource:
    """Return frames of which nobody knows the places: every page of a file, or of a folder's files."""
    from lfcal.base import StorageError
    from lfcal.cli._fit_source import own_words
    from lfcal.frames import FolderSource, FrameEntry, Manifest, Position, natural_key, open_image
    from lfcal.frames.formats import image_suffixes

    if not source.exists():
        raise StorageError(f"{source}: no such file or folder; check the name")
    if source.is_dir():
        files = sorted((p.name for p in source.iterdir() if p.suffix.lower() in image_suffixes()), key=natural_key)
        if not files:
            raise InputError.expected(f"frames in {source}", "images", "none", "name the folder that holds them")
        root = source
    else:
        root, files = source.parent, [source.name]
    entries = []
    for name in files:
        with own_words():
            image = open_image(root / name)
        try:
            entries += [FrameEntry(name, Position(0, 0, 0), page) for page in range(image.pages)]
        finally:
            image.close()
    return stack.enter_context(FolderSource(root, Manifest(tuple(entries))))


def _check_colours(frames: FrameSource, plan: ScanPlan, source: Path) -> None:
    from lfcal.frames import colours_of

    colours = colours_of(frames, plan)
    if colours:
        got, remedy = f"a mosaic of {', '.join(colours)}", "take one colour out of them, and the H of that colour"
        raise InputError.expected(str(source), "frames of one colour", got, remedy)


def _check_grid(H: PSFMatrix, view: FrameSource, plan: ScanPlan | None, source: Path) -> None:
    """Raise unless pixels of the frames are pixels of H's sensor."""
    if H.camera is None:
        return
    wanted = H.camera.sensor.shape
    origin = view.info(0).origin
    if origin == (0, 0) and view.shape != wanted and (plan is None or plan.camera.sensor.shape != view.shape):
        raise InputError.expected(f"{source}, pixels", f"{wanted} as H's camera", view.shape, "take whole frames of it")
    if plan is not None and plan.camera.sensor.shape != wanted:
        got = plan.camera.sensor.shape
        raise InputError.expected(f"{source}, sensor", f"{wanted} pixels as H's camera", got, "name the H of this one")


def _chosen(view: FrameSource, plan: ScanPlan, most: int) -> list[int]:
    from lfcal.fit import spread_out

    index = np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3)
    if not most or len(index) <= most:
        return list(range(len(index)))
    return [int(k) for k in spread_out(index, most, plan.period)]


def _of_scan(H: PSFMatrix, view: FrameSource, plan: ScanPlan, k: int) -> NewFrame:
    info = view.info(k)
    z, y, x = info.position
    drift = info.drift or (0.0, 0.0)
    place = (plan.anchor[0] + y + drift[0], plan.anchor[1] + x + drift[1])
    depth = plan.depths_um[z]
    nearest = int(np.abs(H.depths - depth).argmin())
    if abs(float(H.depths[nearest]) - depth) > NEAR_DEPTH * max(abs(depth), 1.0):
        got = f"{depth:.6g} µm"
        wanted = "a depth of H, " + ", ".join(f"{v:.6g}" for v in H.depths[:6]) + " µm"
        raise InputError.expected(f"{info.label}, depth", wanted, got, "name an H of these depths")
    return new_frame(view, k, place, nearest, info.label)


def _of_file(H: PSFMatrix, view: FrameSource, k: int) -> NewFrame:
    """Return a frame of a file of its own, whose name may say where its source is."""
    from lfcal.frames import NamePattern

    label = view.info(k).label
    found = next((at for one in NAMES if (at := NamePattern(one).parse(label)) is not None), None)
    nz, ny, nx = H.shape[:3]
    if found is None or not (found[0].z < nz and found[0].y < ny and found[0].x < nx):
        return new_frame(view, k, None, 0 if nz == 1 else None, label)
    z, y, x = found[0]
    named = NamePattern(NAMES[0]).parse(label) is not None
    return new_frame(view, k, (H.anchor[0] + y, H.anchor[1] + x), z if named or nz == 1 else None, label)


def new_frame(view: FrameSource, k: int, place: tuple[float, float] | None, plane: int | None, label: str) -> NewFrame:
    """Return frame ``k`` of a corrected view with its noise, where that is known."""
    from lfcal.cli._fit_source import own_words
    from lfcal.fit import NewFrame

    with own_words(without="" if place else ", (z, y, x) = (0, 0, 0)"):
        samples = view.samples(k)
    noise = None
    if samples.noise is not None:
        typical = samples.noise.typical(samples.values)
        noise = (float(typical.constant), float(typical.slope))
    values = np.asarray(samples.values, np.float32)
    return NewFrame(values, samples.valid, noise, view.info(k).origin, place, plane, label)


def check_dict(found: Check) -> dict[str, Any]:
    """Return what was found as plain types."""
    from lfcal.base import plain
    from lfcal.judge import judgement_of

    error, chi2 = found.error, found.chi_square
    result: dict[str, Any] = plain(
        {
            "format": "lfcal-check",
            "version": 1,
            "answer": found.answer,
            "limit": found.limit,
            "error": {"known": error.known, "value": error.value, "sigma": error.sigma, "limit": error.limit},
            "stated_error": found.stated,
            "doubt": found.doubt,
            "chi2": {"lit": chi2.lit, "sigma": chi2.sigma, "excess": chi2.excess, "all_pixels": chi2.all_pixels},
            "noise_from": found.noise_from,
            "model_misfit": found.model_misfit,
            "notes": found.notes,
            "frames": [_frame_dict(one) for one in found.frames],
            "suspects": [
                {
                    "name": one.name,
                    "shows": one.shows,
                    "error": one.error,
                    "sigma": one.sigma,
                    "left": one.left,
                    "values": [
                        {"name": name, "change": value, "sigma": sigma, "unit": unit}
                        for name, value, sigma, unit in one.values
                    ],
                }
                for one in found.suspects
            ],
            **judgement_of(found).to_dict(),
        }
    )
    return result


def _frame_dict(one: Compared) -> dict[str, Any]:
    at = one.found
    return {
        "label": one.label,
        "position": [at.z, at.y, at.x],
        "pixel": [at.row, at.column],
        "correlation": at.correlation,
        "displacement_px": one.displacement_px,
        "displacement_sigma_px": one.displacement_sigma,
        "beside_px": one.beside_px,
        "light": one.gain,
        "background": one.background,
        "error": {"known": one.error.known, "value": one.error.value, "limit": one.error.limit},
        "chi2": one.chi_square.lit,
    }


def _show(found: Check) -> None:
    from lfcal.cli._console import print_table, report
    from lfcal.cli._findings import show_judgement
    from lfcal.judge import judgement_of

    rows = [
        [
            one.label,
            f"{one.found.z}, {one.found.y}, {one.found.x}",
            f"{one.displacement_px[0]:+.3f}, {one.displacement_px[1]:+.3f}",
            f"{one.gain:.4g}",
            f"{one.background:.4g}",
            f"{one.chi_square.lit:.2f}",
            str(one.error),
        ]
        for one in found.frames
    ]
    print_table(["frame", "z, y, x", "beside (px)", "light", "background", "chi²", "error"], rows)
    show_judgement(judgement_of(found), found.answer)
    report(f"note: noise: {found.noise_from}")
    for note in found.notes:
        report(f"note: {note}")
