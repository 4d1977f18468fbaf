"""Options of a session in addition to the scan plan: extra frames, tolerances, checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lfcal.acquire._motion import Motion
from lfcal.acquire.suspending import Bound
from lfcal.base import InputError, check_choice, check_number, check_type
from lfcal.camera import ScanPlan, build

__all__ = ["ORDERS", "POLICIES", "Options"]

ORDERS = ("plan", "coarse")
POLICIES = ("stop", "flag")
LEAST_RESERVE = 16 << 20
_RESHAPING = ("bracket", "margin_px", "darks", "dark_every", "reference_every", "controls")


@dataclass(frozen=True, slots=True)
class Options:
    """Settings for the recording of a session.

    Attributes
    ----------
    order
        Order of the positions: ``"plan"`` (as planned), or ``"coarse"`` (first a coarse grid in all planes, then finer
        ones).
    bracket
        Exposure times at each position, as different multiples of the plane's exposure time, one of which is 1. Frames
        of several exposures are merged to extend the dynamic range.
    margin_px
        Width of the margin recorded around the cutout (px), for interpolation at sub-pixel anchors and for drift. None:
        12 if the plan's anchor is between pixels or frames are resampled, else no margin.
    darks, dark_every
        Number of frames averaged into each dark frame (0: none), taken at the start and after every ``dark_every``
        positions (0: at the start only). There is one dark frame for each exposure time of the plan. Assembly subtracts
        the dark frames; without them, H contains the sensor's dark level. Dark frames require a light source that can
        be switched off.
    reference_every
        Number of positions recorded between two reference frames of a fixed position (0: none). The first is taken at
        the start, and the last at the end. Reference frames show the drift of the lamp. The default adds 1 % to the
        number of frames.
    controls
        Number of control frames per plane and direction, for the check of periodicity (0: none). Their displacements
        are whole periods, from one period up to the edge of the field.
    retries
        Number of further attempts at a position after a transient fault.
    tolerance_um, overshoot_um
        As in `Motion` (µm, for the stage axes x, y, z). Tolerance None: a tenth of the smallest lateral step of the
        scan for lateral axes, and this whole step for the depth axis.
    move_timeout_s, grab_timeout_s, light_settle_s
        Longest waiting times for the stage to arrive and for a frame (beyond its exposure), and the settling time after
        switching the light (s).
    keep_free_bytes
        Free disk space required in addition to the recording (bytes). None: a tenth of the recording, at least 16 MiB.
        With less, the session does not start, or is paused.
    origin_tolerance_px
        Largest shift of the image when the last position is recorded again on resuming (px). A larger shift means that
        the stage's origin is lost. None: no check.
    on_suspect
        Treatment of a frame whose content is still suspect after the frame was taken again: ``"stop"`` the session, or
        ``"flag"`` the position, to be recorded again later.
    allow_automatic
        Whether to record even if the camera changes pixel values automatically, by automatic exposure, gain or black
        level, or by a gamma curve.
    suspend, steady_s
        Bounds of gauges as texts for `Bound.parse`, such as ``"temperature=20:22"``. The session is paused while a
        gauge is outside its bounds, and continues when all gauges have been within their bounds for ``steady_s`` (s).
    check_stage
        Whether to measure sign, scale, repeatability and depth of the stage before the first frame of each run, with
        about 16 frames that are not recorded; see `lfcal.acquire.setup.iter_stage_check`.

    Examples
    --------
    >>> from lfcal.acquire import Options
    >>> options = Options(order="coarse", darks=16, reference_every=50, bracket=(1.0, 0.1))
    >>> print(options.darks, "darks; each position exposed", len(options.bracket), "times")
    16 darks; each position exposed 2 times
    """

    order: str = "plan"
    bracket: tuple[float, ...] = (1.0,)
    margin_px: int | None = None
    darks: int = 8
    dark_every: int = 0
    reference_every: int = 100
    controls: int = 0
    retries: int = 2
    tolerance_um: tuple[float, ...] | None = None
    overshoot_um: tuple[float, ...] = (20.0, 20.0, 20.0)
    move_timeout_s: float = 60.0
    grab_timeout_s: float = 5.0
    light_settle_s: float = 0.5
    keep_free_bytes: int | None = None
    origin_tolerance_px: float | None = 0.5
    on_suspect: str = "stop"
    suspend: tuple[str, ...] = ()
    steady_s: float = 30.0
    allow_automatic: bool = False
    check_stage: bool = True

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("order", self.order, ORDERS)
        check_type("check stage", self.check_stage, bool)
        check_type("allow automatic", self.allow_automatic, bool)
        check_choice("on suspect", self.on_suspect, POLICIES)
        # a bracket without 1 has no frame at the plan's exposure, to which the others are scaled
        if not self.bracket or 1.0 not in self.bracket or len(set(self.bracket)) != len(self.bracket):
            raise InputError.expected(
                "exposure bracket",
                "different factors that include 1",
                self.bracket,
                "list different factors, one of which is 1: 1, 0.25, 0.0625",
            )
        for factor in self.bracket:
            check_number("exposure factor", factor, above=0, at_most=1e4)
        if self.margin_px is not None:
            check_number("margin (px)", self.margin_px, at_least=0, integer=True)
        for name in ("darks", "dark_every", "reference_every", "controls", "retries"):
            check_number(name.replace("_", " "), getattr(self, name), at_least=0, integer=True)
        if self.keep_free_bytes is not None:
            check_number("space to keep free (bytes)", self.keep_free_bytes, at_least=0, integer=True)
        for name in ("move_timeout_s", "grab_timeout_s"):
            check_number(f"{name[:-2].replace('_', ' ')} (s)", getattr(self, name), above=0, at_most=86_400)
        check_number("steady time (s)", self.steady_s, at_least=0, at_most=86_400)
        self.bounds  # noqa: B018 this parses and checks each one
        check_number("light settle time (s)", self.light_settle_s, at_least=0, at_most=86_400)
        for name in ("tolerance_um", "overshoot_um"):
            values = getattr(self, name)
            if values is not None and len(values) != 3:
                raise InputError.expected(
                    name, "three numbers (x, y, z) in µm", values, "give one number for each axis"
                )
        if self.origin_tolerance_px is not None:
            check_number("origin tolerance (px)", self.origin_tolerance_px, above=0)

    @property
    def plain(self) -> bool:
        """Whether each position is recorded with a single exposure time; several frames may still be averaged."""
        return len(self.bracket) == 1

    def reserve(self, recording_bytes: int) -> int:
        """Return the disk space to keep free (bytes) in addition to a recording of ``recording_bytes``."""
        return max(recording_bytes // 10, LEAST_RESERVE) if self.keep_free_bytes is None else self.keep_free_bytes

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """Bounds of the gauges, parsed from ``suspend``; raises `InputError` if a text cannot be parsed."""
        return tuple(Bound.parse(text) for text in self.suspend)

    def motion(self, plan: ScanPlan) -> Motion:
        """Return the settings for moving the stage to the positions of ``plan``."""
        tolerance = self.tolerance_um
        if tolerance is None:
            step = min(min(plan.step_um(z)) for z in range(len(plan.depths_um)))
            # an error in depth changes a pattern much less than a lateral one
            sideways, away = 0.1 * step, step
            axis = plan.stage.away[1]
            tolerance = tuple(away if name == axis else sideways for name in "xyz")
        return Motion(plan.settle_s, _triple(tolerance), _triple(self.overshoot_um), self.move_timeout_s)

    def differences(self, other: Options) -> list[str]:
        """Return the names of options that affect the layout of the recording and have other values in ``other``."""
        return [name for name in _RESHAPING if getattr(self, name) != getattr(other, name)]

    def to_dict(self) -> dict[str, Any]:
        """Return the options as plain JSON types."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Options:
        """Return the options described by ``data``; unknown entries raise `InputError`.

        Options that are missing, as in older sessions, have their default values.
        """
        return build(cls, data, "options", partial=True)


def _triple(values: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
