"""The application: every command of this package, in the order of the data."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from types import ModuleType
from typing import Any

import typer

from lfcal import __version__

__all__ = ["build_app", "command_line", "command_modules"]

ORDER = (
    "demo",
    "camera",
    "plan",
    "white",
    "views",
    "simulate",
    "accuracy",
    "acquire",
    "verify",
    "assemble",
    "inspect",
    "compare",
    "fit",
    "trend",
    "transpose",
    "reduce",
    "export",
    "reconstruct",
    "multiplex",
    "bench",
    "doctor",
)
"""The order of the data; commands not named here come after."""


def command_modules(package: str, order: tuple[str, ...] = ()) -> list[ModuleType]:
    """Import the public modules of ``package`` that register commands, in ``order`` and then by name."""
    path = importlib.import_module(package).__path__
    names = sorted(m.name for m in pkgutil.iter_modules(path) if not m.name.startswith("_"))
    # camera_new is a part of camera, which registers it
    names = [name for name in names if name.partition("_")[0] == name or name.partition("_")[0] not in names]
    # A stable sort: what is not named in the order stays sorted by name behind it.
    names.sort(key=lambda name: order.index(name) if name in order else len(order))
    loaded = [importlib.import_module(f"{package}.{name}") for name in names]
    return [module for module in loaded if hasattr(module, "register")]


def _version(value: bool) -> None:
    if value:
        typer.echo(f"lfcal {__version__}")
        raise typer.Exit


def build_app() -> typer.Typer:
    """Return the application with every command registered."""
    app = typer.Typer(
        name="lfcal",
        help="PSF calibration and acquisition for plenoptic (light-field) cameras.",
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode="markdown",
        # Errors end in one line, printed by main; the traceback of a defect is left to Python.
        pretty_exceptions_enable=False,
    )

    @app.callback()
    def _root(
        *,
        version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
    ) -> None:
        """PSF calibration and acquisition for plenoptic (light-field) cameras."""

    for module in command_modules("lfcal.cli", ORDER):
        module.register(app)
    return app


@cache
def command_line() -> Any:
    """Return the parser of the whole command line, made once: reading the signature of every command takes a while."""
    return typer.main.get_command(build_app())
