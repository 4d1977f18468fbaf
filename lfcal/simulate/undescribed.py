"""Effects that the camera does not describe, and the cheapest measurements that determine their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lfcal.base import format_length, format_share
from lfcal.camera import Camera
from lfcal.simulate.accuracy import EFFECTS_SHARE, EffectSelection, PlannedEffect
from lfcal.simulate.effects import WHITE_IMAGE

__all__ = ["EffectMeasurement", "UndescribedEffects", "undescribed_effects"]

NAMED = 3
"""Largest number of effects that the sentence names."""

BEAD_FRAMES = 3
"""Number of frames of a point source for each depth: the fewest that `lfcal plan fit` chooses."""

SEEN = 0.5
"""Smallest ratio of an effect's error at a depth to its largest one with which frames at that depth determine it."""

FITTED = ("geometry", "focal_lengths", "iris")
"""Groups of unknowns that are fitted together with those of the effects."""


@dataclass(frozen=True, slots=True)
class EffectMeasurement:
    """A measurement that determines the sizes of effects.

    Attributes
    ----------
    title
        Short description of what is recorded or stated, such as ``"one white image"``.
    rows
        Effects whose sizes the measurement determines, largest error first.
    frames
        Number of frames to record.
    depths_um
        Object depths of the point source (µm, relative to the working plane, positive away from the camera); empty if
        no point source is used.
    unknowns
        Groups of unknowns that a fit of the frames finds; empty if no point source is used.
    commands
        Commands to run, in order; ``CAMERA`` is a placeholder for the camera's file or preset.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import EffectMeasurement, plan_effects, undescribed_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> first: EffectMeasurement = undescribed_effects(plan_effects(plan), camera).measurements[0]
    >>> first.title, first.commands_for("bench")
    ('one white image', ['lfcal white white.tif --camera bench -o white/'])
    """

    title: str
    rows: tuple[PlannedEffect, ...]
    frames: int
    depths_um: tuple[float, ...]
    unknowns: tuple[str, ...]
    commands: tuple[str, ...]

    def to_dict(self, camera: str) -> dict[str, Any]:
        """Return title, frames, depths, names and largest error of the effects, and commands, as plain JSON types.

        ``camera`` is the file or preset in the commands. The groups of unknowns are not included.
        """
        return {
            "measurement": self.title,
            "frames": self.frames,
            "depths_um": self.depths_um,
            "effects": [row.name for row in self.rows],
            "error": max(row.estimate.error for row in self.rows),
            "commands": self.commands_for(camera),
        }

    def commands_for(self, camera: str) -> list[str]:
        """Return `commands` with ``CAMERA`` replaced by ``camera``, a file or preset."""
        return [command.replace("CAMERA", camera) for command in self.commands]


@dataclass(frozen=True, slots=True)
class UndescribedEffects:
    """Effects that the camera does not describe and that may exceed the error allowed for omitted effects.

    Attributes
    ----------
    rows
        The effects, largest error first.
    measurements
        The measurements that determine the sizes of the effects, as far as they are needed. First come one white image,
        and bead frames at a few depths that together show all effects; the values that you have to enter are last.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import UndescribedEffects, plan_effects, undescribed_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> found: UndescribedEffects = undescribed_effects(plan_effects(plan, tolerance=1.0), camera)
    >>> found.sentence
    'not described: cover glass, up to 81 % of the image'
    """

    rows: tuple[PlannedEffect, ...]
    measurements: tuple[EffectMeasurement, ...]

    @property
    def sentence(self) -> str:
        """One sentence that names the largest effects and their errors; empty if there are none."""
        if not self.rows:
            return ""
        first, *others = (f"{row.effect.title}, up to {format_share(row.estimate.error)}" for row in self.rows[:NAMED])
        more = len(self.rows) - NAMED
        smaller = [] if more <= 0 else [f"{more} smaller one{'s' if more > 1 else ''}"]
        return f"not described: {'; '.join([f'{first} of the image', *others, *smaller])}"

    def lines(self, camera: str) -> tuple[str, ...]:
        """Return the measurements as lines of text: what to record, the effects determined by it, and the commands.

        ``camera`` is the file or preset in the commands.
        """
        found = []
        for one in self.measurements:
            effects = "; ".join(f"{row.effect.title}, {format_share(row.estimate.error)}" for row in one.rows)
            found += [f"{one.title} ({effects})", *(f"    {command}" for command in one.commands_for(camera))]
        return tuple(found)

    def to_dict(self, camera: str) -> dict[str, Any]:
        """Return the sentence, the names of the effects, and the measurements as plain JSON types.

        ``camera`` is the file or preset in the commands.
        """
        return {
            "sentence": self.sentence,
            "effects": [row.name for row in self.rows],
            "measurements": [one.to_dict(camera) for one in self.measurements],
        }


def undescribed_effects(selection: EffectSelection, camera: Camera) -> UndescribedEffects:
    """Return the undescribed effects of a selection for ``camera``, and the measurements that determine them.

    Effects whose estimated error is within that allowed for omitted effects need no measurement and are not listed.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import plan_effects, undescribed_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> found = undescribed_effects(plan_effects(plan), camera)
    >>> print(found.sentence.partition(";")[0])
    not described: cover glass, up to 81 % of the image
    >>> [measurement.title for measurement in found.measurements][:2]
    ['one white image', '3 bead frames at z = -26.02 mm']
    """
    allowed = EFFECTS_SHARE * selection.tolerance
    unknown = (row for row in selection.rows if row.undescribed and row.estimate.error > allowed)
    rows = tuple(sorted(unknown, key=lambda row: -row.estimate.error))
    by_source: dict[str, list[PlannedEffect]] = {WHITE_IMAGE: [], "beads": [], "": []}
    for row in rows:
        source = row.effect.settled_by(camera)
        by_source[source if source in by_source else "beads"].append(row)
    white, beads, stated = by_source.values()
    found = []
    if white:
        command = "lfcal white white.tif --camera CAMERA -o white/"
        found.append(EffectMeasurement("one white image", tuple(white), 1, (), (), (command,)))
    if beads:
        found.append(_bead_frames(beads, [selection.depths_um[k] for k in _fewest_planes(beads)], camera))
    if stated:
        commands = tuple(f"lfcal simulate CAMERA --effect {row.name}=VALUE" for row in stated)
        found.append(EffectMeasurement("a stated value, as in a data sheet", tuple(stated), 0, (), (), commands))
    return UndescribedEffects(rows, tuple(found))


def _fewest_planes(rows: Sequence[PlannedEffect]) -> list[int]:
    """Return a few planes that together show all effects; each shows the most of the effects not shown before."""
    planes: list[int] = []
    left = list(rows)
    while left:
        # among equal ones the plane with the largest errors
        errors = [[row.errors[k] for row in left if _seen(row, k)] for k in range(len(left[0].errors))]
        planes.append(max(range(len(errors)), key=lambda k: (len(errors[k]), sum(errors[k]))))
        left = [row for row in left if not _seen(row, planes[-1])]
    return sorted(planes)


def _seen(row: PlannedEffect, plane: int) -> bool:
    return row.errors[plane] >= SEEN * row.estimate.error


def _bead_frames(rows: Sequence[PlannedEffect], depths_um: Sequence[float], camera: Camera) -> EffectMeasurement:
    """Return the recording and the fit of a point source at some depths that determine ``rows`` together."""
    groups = dict.fromkeys(row.effect.settled_by(camera) for row in rows)
    unknowns = tuple(dict.fromkeys((*FITTED, *groups)))
    named = ",".join(unknowns)
    frames = BEAD_FRAMES * len(depths_um)
    commands = (
        f"lfcal plan CAMERA --depths={','.join(f'{z_um:.7g}' for z_um in depths_um)} -o beads.json",
        f"lfcal plan fit beads.json --count {frames} --unknowns {named} -o positions.json",
        "lfcal acquire beads.json --positions positions.json -o beads/",
        f"lfcal fit beads/ -o fit/ --unknowns {named}",
    )
    title = f"{frames} bead frames at z = {' and '.join(map(format_length, depths_um))}"
    return EffectMeasurement(title, tuple(rows), frames, tuple(depths_um), unknowns, commands)
