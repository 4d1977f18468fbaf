"""``lfcal install-desktop``: add the workstation, its icon and its file type to the menu of a Linux desktop."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import typer

from lfcal.base import InputError, StorageError, replace_whole
from lfcal.cli._console import print_json
from lfcal.cli._options import JsonOption

__all__ = ["desktop_files", "window_program"]

ICON = Path(__file__).with_name("lfcal.svg")

ENTRY = """[Desktop Entry]
Type=Application
Version=1.1
Name=lfcal
GenericName=Light-field camera calibration
Comment=PSF calibration and acquisition for plenoptic (light-field) cameras
Exec={program} %f
Icon=lfcal
Terminal=false
Categories=Science;Education;Engineering;
Keywords=PSF;plenoptic;light field;microscope;deconvolution;
MimeType=application/x-lfcal-project;
StartupWMClass=lfcal
"""

FILE_TYPE = """<?xml version="1.0" encoding="UTF-8"?>
<mime-info xmlns="http://www.freedesktop.org/standards/shared-mime-info">
  <mime-type type="application/x-lfcal-project">
    <comment>lfcal project</comment>
    <icon name="lfcal"/>
    <glob pattern="*.lfcal"/>
  </mime-type>
</mime-info>
"""

REFRESHED = (("update-desktop-database", "applications"), ("update-mime-database", "mime"))
"""Programs that notify a running desktop of changes, and the folder of each; without them it rescans later."""


def command(
    *,
    uninstall: bool = typer.Option(False, "--uninstall", help="Remove the menu entry, its icon and the file type."),
    json: JsonOption = False,
) -> None:
    """Add lfcal-gui with its icon to the menu of this user's desktop, and let it open .lfcal files.

    Files are written below $XDG_DATA_HOME (~/.local/share); those of an earlier call are replaced.

    Example: `lfcal install-desktop`, and to remove it: `lfcal install-desktop --uninstall`
    """
    if not sys.platform.startswith("linux"):
        raise InputError.expected("install-desktop", "a Linux desktop", sys.platform, "pin lfcal-gui manually")
    place = data_home()
    files = desktop_files("" if uninstall else window_program())
    changed = _remove(place, files) if uninstall else _write(place, files)
    _refresh(place)
    if json:
        print_json({"uninstalled" if uninstall else "installed": changed})
        return
    for path in changed:
        typer.echo(f"{'removed' if uninstall else 'written'}: {path}")
    if uninstall and not changed:
        typer.echo(f"nothing of lfcal in {place}")


def data_home(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this user's menu entries and icons: ``XDG_DATA_HOME`` if absolute, else ~/.local/share."""
    stated = environment.get("XDG_DATA_HOME", "")
    # the specification says that a relative path must be ignored
    return Path(stated) if os.path.isabs(stated) else Path.home() / ".local" / "share"


def window_program() -> str:
    """Return the path of ``lfcal-gui``, next to this Python or else in PATH; raise `InputError` if there is none."""
    beside = Path(sys.executable).with_name("lfcal-gui")
    found = str(beside) if os.access(beside, os.X_OK) and beside.is_file() else shutil.which("lfcal-gui")
    if found is None:
        raise InputError('lfcal-gui: not found; install lfcal with pip install "lfcal[gui]", or add its folder to PATH')
    return os.path.abspath(found)


def desktop_files(program: str) -> dict[str, bytes]:
    """Return the contents of the files to write for ``program``, by their paths below the folder of `data_home`."""
    return {
        "applications/lfcal.desktop": ENTRY.format(program=_quoted(program)).encode(),
        "icons/hicolor/scalable/apps/lfcal.svg": ICON.read_bytes(),
        "mime/packages/lfcal.xml": FILE_TYPE.encode(),
    }


def _quoted(program: str) -> str:
    r"""Return a path for the ``Exec`` key of an entry: quoted, with special characters escaped.

    The specification of desktop entries requires that characters are escaped twice. They are escaped within the quotes,
    then as a string of the file. ``%`` is doubled, because it begins a field code.
    """
    if not program.isprintable():  # a line break would begin another key of the entry
        raise InputError.expected("path of lfcal-gui", "printable text in UTF-8", program, "install it elsewhere")
    inside = "".join(f"\\{c}" if c in '"`$\\' else c for c in program)
    return f'"{inside}"'.replace("\\", "\\\\").replace("%", "%%")


def _write(place: Path, files: Mapping[str, bytes]) -> list[Path]:
    for name, content in files.items():
        with replace_whole(place / name) as part:
            part.write_bytes(content)
    return [place / name for name in files]


def _remove(place: Path, files: Mapping[str, bytes]) -> list[Path]:
    there = [place / name for name in files if (place / name).is_file()]
    for path in there:
        try:
            path.unlink()
        except OSError as error:
            raise StorageError(f"{path}: {error.strerror}; remove it manually") from error
    return there


def _refresh(place: Path) -> None:
    for program, folder in REFRESHED:
        found = shutil.which(program)
        if found is not None and (place / folder).is_dir():
            with suppress(OSError, subprocess.TimeoutExpired):
                subprocess.run([found, str(place / folder)], capture_output=True, check=False, timeout=60)
