"""The unknowns of a fit, each with a unit, a start and a scale, in groups that are found by registry."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Registry, check_number
from lfcal.camera import ScanPlan
from lfcal.fit.setup import Setup

__all__ = [
    "GROUP",
    "GROUPS",
    "Group",
    "ScanScales",
    "Unknown",
    "Vector",
    "check_groups",
    "field_of",
    "find_groups",
    "lacking",
]

GROUP = "lfcal.unknowns"
"""Entry point group for groups of unknowns of other packages."""


@dataclass(frozen=True, slots=True)
class ScanScales:
    """Properties of the scan that set the scales of unknowns.

    Attributes
    ----------
    planes
        Number of depth planes.
    reach_px
        Lever arm of a rotation and of a change of the pitch (pixels), which is half the longer side of the cutout. For
        several regions, the distance of the farthest region from ``middle_um`` is added.
    middle_um
        Middle (x, y) of the scanned region relative to the centre of the sensor (µm); for several regions, their mean.
    fields_um
        Middle (x, y) of each of several regions, relative to the centre of the sensor (µm); empty for a single one.
    """

    planes: int
    reach_px: float
    middle_um: tuple[float, float] = (0.0, 0.0)
    fields_um: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, plan: ScanPlan) -> ScanScales:
        """Return the properties of the scan of a single region, described by ``plan``."""
        return cls(plan.shape[0], max(plan.cutout) / 2, field_of(plan))

    @classmethod
    def over(cls, plans: Sequence[ScanPlan]) -> ScanScales:
        """Return the properties of a scan of several regions, described by one plan for each region."""
        fields = np.array([field_of(plan) for plan in plans])
        middle = fields.mean(0)
        far = float(np.hypot(*(fields - middle).T).max()) / plans[0].camera.sensor.pixel_um
        reach = max(plans[0].cutout) / 2 + far
        return cls(plans[0].shape[0], reach, (float(middle[0]), float(middle[1])), tuple(map(tuple, fields.tolist())))


def field_of(plan: ScanPlan) -> tuple[float, float]:
    """Return the middle (x, y) of the region scanned by ``plan``, relative to the centre of the sensor (µm)."""
    middle = np.array(plan.anchor) + (np.array(plan.period) - 1) / 2
    y, x = (middle - np.array(plan.camera.sensor.centre_px)) * plan.camera.sensor.pixel_um
    return float(x), float(y)


@dataclass(frozen=True, slots=True)
class Unknown:
    """Unknown parameter of a fit.

    Attributes
    ----------
    name, group, unit
        Name of the parameter, name of its group, and unit of its value.
    start
        Start value, from the description of the camera.
    scale
        Change that noticeably affects the patterns; the unit in which the fit measures steps of the parameter.
    sigma
        Standard deviation of the prior, which is centred at ``start``. None: no prior.
    low, high
        Smallest and largest allowed value.
    squared
        Whether the square of the value is fitted. This is better for values on whose square the patterns depend, such
        as widths that add in quadrature.
    gauge
        Description of what is fixed to make the unknown unique; may be empty.

    Examples
    --------
    >>> from lfcal.fit import Unknown
    >>> gap = Unknown("gap_um", "geometry", "um", start=290.0, scale=1.0, low=0.0)
    >>> print(gap.value(0.4), gap.unit)  # 0.4 scales from the start
    290.4 um
    """

    name: str
    group: str
    unit: str
    start: float
    scale: float
    sigma: float | None = None
    low: float = -math.inf
    high: float = math.inf
    squared: bool = False
    gauge: str = ""

    def __post_init__(self) -> None:
        """Check every value."""
        check_number(f"{self.name}: starting value", self.start)
        check_number(f"{self.name}: scale", self.scale, above=0)
        if self.sigma is not None:
            check_number(f"{self.name}: sigma", self.sigma, above=0)
        if not self.low <= self.start <= self.high:
            wanted = f"{self.low:g} to {self.high:g}"
            raise InputError.expected(
                f"starting value of {self.name}",
                wanted,
                f"{self.start:g}",
                "correct this value in the camera description",
            )

    def value(self, u: float) -> float:
        """Return the value at ``u``, limited to `low` and `high`: start + u scale.

        If `squared`, it is the square root of start² + u scale².
        """
        if self.squared:
            square = self.start**2 + u * self.scale**2
            return min(self.high, max(self.low, math.sqrt(max(0.0, square))))
        return min(self.high, max(self.low, self.start + u * self.scale))

    def sigma_of(self, u: float, sigma: float) -> float:
        """Return the standard deviation of the value at ``u``, given the standard deviation ``sigma`` of ``u``."""
        if not self.squared:
            return sigma * self.scale
        value = self.value(u)
        # the root of a square that is smaller than its error has no first-order error
        return (
            min(sigma * self.scale**2 / (2 * value), math.sqrt(sigma) * self.scale)
            if value > 0
            else (math.sqrt(sigma) * self.scale)
        )

    def clipped(self, u: float) -> float:
        """Return ``u``, limited so that the value stays between `low` and `high`."""
        if self.squared:
            low, high = (self.low**2 if self.low > 0 else 0.0), self.high**2
            bounds = ((low - self.start**2) / self.scale**2, (high - self.start**2) / self.scale**2)
        else:
            bounds = (self.low - self.start) / self.scale, (self.high - self.start) / self.scale
        return min(bounds[1], max(bounds[0], u))


class Group(ABC):
    """Base class for a group of related unknowns that defines how they change a setup.

    Examples
    --------
    >>> from lfcal.fit import GROUPS, Group
    >>> group: Group = GROUPS.get("geometry")
    >>> print(group.title)
    gap, rotation and offset of the array
    """

    name: str
    """Name in options, files and commands."""
    title: str
    """Display name."""
    rank: int = 50
    """Sort key in lists; smaller numbers come first."""
    late: bool = False
    """Whether the group is tried only after the others, because each pattern needs many runs of the engine."""
    held: bool = False
    """Whether ``unknowns="auto"`` never adds the group, but reports the degeneracies that it would cause."""
    assumed: bool = False
    """Whether the group, when fixed, contributes to the standard deviations of other unknowns, however little."""
    along: tuple[str, ...] = ()
    """Groups that ``unknowns="auto"`` also tries together with this one, because each may have no effect alone."""
    core: bool = False
    """Whether ``unknowns="auto"`` starts with the group; others are added if they lower the held-out error."""
    needs: str = "a camera that has them"
    """What a camera or a scan must have for the group to have unknowns, as text."""

    @abstractmethod
    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns of the group for ``setup``; empty if its camera or the scan has none of them.

        ``frame`` contains the properties of the scan that set the scales of the unknowns.
        """

    @abstractmethod
    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return a copy of ``setup`` with the unknowns of the group set to ``values`` (by name).

        ``setup`` is that from which the fit started, possibly with the unknowns of other groups already applied.

        ``frame`` contains the properties of the scan, as in `unknowns`.
        """


def check_group(group: Group) -> None:
    """Raise `TypeError` unless ``group`` is an instance of `Group` and its title is a string."""
    if not isinstance(group, Group):
        raise TypeError(f"expected an object derived from Group, got {type(group).__name__}")
    if not isinstance(getattr(group, "title", None), str):
        raise TypeError("expected a group with a title (str), got one without")


def find_groups() -> Registry[Group]:
    """Return the registry of all groups of unknowns, ordered by rank, including those of other packages."""
    return Registry(
        "unknowns", "lfcal.fit.groups", "GROUPS", GROUP, order=lambda g: (g.rank, g.name), check=check_group
    )


GROUPS = find_groups()
"""All groups of unknowns."""


class Vector:
    """The unknowns of several groups as one vector ``u``: differences from the start, in units of the scales.

    Parameters
    ----------
    setup, frame
        Setup from which the fit starts, and the properties of the scan.
    groups
        Names of the groups; groups without unknowns for this setup and scan are left out.

    Raises
    ------
    InputError
        If a group does not exist, or two unknowns have the same name.
    """

    def __init__(self, setup: Setup, frame: ScanScales, groups: Sequence[str]) -> None:
        self.setup, self.frame = setup, frame
        found = [(GROUPS.get(name), GROUPS.get(name).unknowns(setup, frame)) for name in groups]
        self.groups = tuple(group for group, own in found if own)
        self.unknowns = tuple(one for _, own in found for one in own)
        names = [one.name for one in self.unknowns]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError.expected("unknowns", "each one once", f"{twice} twice", "remove the repetition")

    def __len__(self) -> int:
        """Return the number of unknowns."""
        return len(self.unknowns)

    def values(self, u: NDArray[np.float64]) -> dict[str, float]:
        """Return the values of all unknowns by name."""
        return {one.name: one.value(float(v)) for one, v in zip(self.unknowns, u, strict=True)}

    def changes(self, u: NDArray[np.float64]) -> dict[str, float]:
        """Return the deviation of each unknown from its start, by name."""
        return {one.name: one.value(float(v)) - one.start for one, v in zip(self.unknowns, u, strict=True)}

    def at(self, changes: Mapping[str, float]) -> NDArray[np.float64]:
        """Return the vector for ``changes`` of unknowns from their start, by name; all others are at their start.

        Changes of unknowns whose square is fitted are ignored, and the vector is limited to the bounds.
        """
        u = np.array([changes.get(one.name, 0.0) / one.scale for one in self.unknowns])
        return self.clipped(np.where([one.squared for one in self.unknowns], 0.0, u))

    def clipped(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``u`` with every unknown limited to its bounds."""
        return np.array([one.clipped(float(v)) for one, v in zip(self.unknowns, u, strict=True)])

    def setup_at(self, u: NDArray[np.float64]) -> Setup:
        """Return the setup for a vector of unknowns.

        Raises
        ------
        InputError
            If the vector does not describe a possible camera.
        """
        values, setup = self.values(u), self.setup
        for group in self.groups:
            own = {one.name: values[one.name] for one in self.unknowns if one.group == group.name}
            setup = group.applied(setup, own, self.frame)
        return setup

    def prior(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the prior precisions (1/sigma²; 0: no prior) and prior means of ``u``, as vectors."""
        precision = [0.0 if one.sigma is None else (one.scale / one.sigma) ** 2 for one in self.unknowns]
        return np.array(precision), np.zeros(len(precision))

    def of_groups(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Return the indices of the unknowns of the groups ``names``."""
        return np.array([k for k, one in enumerate(self.unknowns) if one.group in names], np.intp)


def lacking(setup: Setup, plan: ScanPlan, frame: ScanScales | None = None) -> dict[str, str]:
    """Return, for each group without unknowns, what the camera or scan would need to have some, in words.

    Keys are the names of the groups. ``frame`` contains the properties of the scan. None: those of ``plan``, which is
    then a scan of a single region.
    """
    frame = frame or ScanScales.of(plan)
    return {group.name: group.needs for group in GROUPS if not group.unknowns(setup, frame)}


def check_groups(setup: Setup, plan: ScanPlan, names: Sequence[str], frame: ScanScales | None = None) -> None:
    """Raise `InputError` if one of the groups ``names`` has no unknowns; the arguments are those of `lacking`."""
    if not names:
        return
    without = lacking(setup, plan, frame)
    wrong = [name for name in names if name in without]
    if wrong:
        there = ", ".join(name for name in GROUPS.names() if name not in without)
        raise InputError.expected(
            "unknowns",
            f"groups that the camera {plan.camera.name} has",
            f"{wrong[0]}, which needs {without[wrong[0]]}",
            f"choose from {there}",
        )
