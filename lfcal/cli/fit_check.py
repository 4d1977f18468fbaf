"""``lfcal fit check``: check whether an old H is still valid, with new frames of a point source."""

from __future__ import annotations

from lfcal.cli._console import print_table, report, show_judgement
from lfcal.tasks import CheckedMatrix


def show(made: tuple[CheckedMatrix, ...]) -> None:
    """Print, for each checked H, the results of each frame, the verdict and notes."""
    from lfcal.judge import judgement_of

    for found in (one.check for one in made):
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
        print_table(["frame", "z, y, x", "displacement (px)", "light", "background", "chi²", "error"], rows)
        show_judgement(judgement_of(found), found.answer)
        report(f"note: noise: {found.noise_from}")
        for note in found.notes:
            report(f"note: {note}")
