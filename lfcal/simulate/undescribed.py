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
"""Frames of a point source at one depth: the fewest that `lfcal plan fit` chooses."""

FITTED = "geometry,focal_lengths,iris"
"""Groups of unknowns that are fitted together with those of the effects."""


@dataclass(frozen=True, slots=True)
class EffectMeasurement:
    """A measurement that determines the sizes of effects.

    Attributes
    ----------
    title
        Short description of the recording, such as ``"one white image"``.
    rows
        Effects whose sizes the measurement determines, largest error first.
    frames
        Number of frames to record.
    z_um
        Object depth of the point source (µm, relative to the working plane, positive away from the camera); None if no
        point source is used.
    commands
        Commands to run, in order; ``CAMERA`` is the camera's file or preset.

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
    z_um: float | None
    commands: tuple[str, ...]

    def to_dict(self, camera: str) -> dict[str, Any]:
        """Return the values as plain JSON types, with the commands for ``camera``, a file or preset."""
        return {
            "measurement": self.title,
            "frames": self.frames,
            "z_um": self.z_um,
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
        The measurements that determine the sizes of the effects: those with the fewest frames first, and last the
        values that you have to enter.

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
        """Return the measurements as lines of text: what to record, the effects determined by it, and the commands."""
        found = []
        for one in self.measurements:
            effects = "; ".join(f"{row.effect.title}, {format_share(row.estimate.error)}" for row in one.rows)
            found += [f"{one.title} ({effects})", *(f"    {command}" for command in one.commands_for(camera))]
        return tuple(found)

    def to_dict(self, camera: str) -> dict[str, Any]:
        """Return the values as plain JSON types, with the commands for ``camera``, a file or preset."""
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
    by_source: dict[tuple[str, float], list[PlannedEffect]] = {}
    for row in rows:
        source = row.effect.settled_by(camera)
        kind = source if source in ("", WHITE_IMAGE) else "beads"
        by_source.setdefault((kind, row.z_um if kind == "beads" else 0.0), []).append(row)
    found = (_measurement(kind, z_um, some, camera) for (kind, z_um), some in by_source.items())
    return UndescribedEffects(rows, tuple(sorted(found, key=lambda one: one.frames or BEAD_FRAMES + 1)))


def _measurement(kind: str, z_um: float, rows: Sequence[PlannedEffect], camera: Camera) -> EffectMeasurement:
    """Return the measurement of a kind that determines ``rows``."""
    some = tuple(rows)
    if kind == WHITE_IMAGE:
        white = "lfcal white white.tif --camera CAMERA -o white/"
        return EffectMeasurement("one white image", some, 1, None, (white,))
    if kind == "":
        stated = (f"lfcal simulate CAMERA --effect {row.name}=VALUE" for row in some)
        return EffectMeasurement("a stated value, as in a data sheet", some, 0, None, tuple(stated))
    groups = dict.fromkeys(row.effect.settled_by(camera) for row in some)
    unknowns = ",".join(dict.fromkeys((*FITTED.split(","), *groups)))
    commands = (
        f"lfcal plan CAMERA --depths={z_um:.7g} -o beads.json",
        f"lfcal plan fit beads.json --count {BEAD_FRAMES} --unknowns {unknowns} -o positions.json",
        "lfcal acquire beads.json --positions positions.json -o beads/",
        f"lfcal fit beads/ -o fit/ --unknowns {unknowns}",
    )
    title = f"{BEAD_FRAMES} bead frames at z = {format_length(z_um)}"
    return EffectMeasurement(title, some, BEAD_FRAMES, z_um, commands)
