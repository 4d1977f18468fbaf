"""``lfcal acquire --until-error``: positions recorded until a fit's error of H is as small as wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError
from lfcal.cli._options import parse_groups

if TYPE_CHECKING:
    from lfcal.campaign import Adapted, AdaptiveStep, Goal

__all__ = ["adapted_facts", "parse_goal", "show_adapted", "tell_step"]


def parse_goal(error: str, most: int, unknowns: str) -> Goal | None:
    """Return what ``--until-error 0.5%`` (or 0.005), ``--most`` and ``--unknowns`` ask for; None where they do not."""
    from lfcal.campaign import Goal

    if not error:
        if most or unknowns:
            name = "--most" if most else "--unknowns"
            raise InputError(f"{name}: is of sessions that end by the error of H; say it with --until-error")
        return None
    text = error.strip()
    try:
        value = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        raise InputError.expected("--until-error", "an error of H", repr(error), "for example 0.5%") from None
    groups = "auto" if unknowns in ("", "auto") else parse_groups(unknowns)
    return Goal(value, most=most or None, unknowns=groups)


def tell_step(step: AdaptiveStep) -> None:
    """Print what is known after a fit."""
    from lfcal.cli._console import report

    report(str(step))


def adapted_facts(found: Adapted) -> dict[str, Any]:
    """Return what ``--json`` says of an adaptive session."""
    steps = [
        {
            "positions": step.positions,
            "expected_error": step.expected_error,
            "left_out_error": step.held_out_error.value if step.held_out_error.known else None,
            "left_out_limit": step.held_out_error.limit,
            "chi2": step.chi2,
            "complete": step.complete,
            "groups": step.groups,
            "outliers": step.outliers,
        }
        for step in found.steps
    ]
    return {"ended": found.how, "steps": steps}


def show_adapted(found: Adapted, out: object) -> None:
    """Print how an adaptive session ended, and what to do next."""
    if found.words:
        colour = typer.colors.GREEN if found.how == "reached" else typer.colors.RED
        typer.echo(f"  {found.steps[-1]}")
        typer.secho(f"  {found.words}", fg=colour, bold=True)
        typer.echo(f"  lfcal fit {out} -o fit/ makes camera and H of it")
    elif found.outcome.how != "complete":
        typer.echo("  with the same --until-error")
