"""Find all kinds of effects by the registry."""

from __future__ import annotations

import inspect
import math
from dataclasses import is_dataclass

from lfcal.base import Registry
from lfcal.camera import preset
from lfcal.simulate.effects.base import ActsOn, Effect, EngineSeconds, Estimate
from lfcal.simulate.effects.outlook import Outlook

__all__ = ["CATALOGUE", "GROUP", "catalogue", "check_effect", "find_effects"]

GROUP = "lfcal.effects"
"""Entry point group for effects of other packages."""


def check_effect(kind: type[Effect]) -> None:
    """Raise `TypeError` unless ``kind`` is a complete effect class: a frozen dataclass with title and ``acts_on``.

    Its `Effect.estimate` with default values must return a finite error for the preset ``"bench"``. Exceptions that the
    methods of ``kind`` raise are passed on.
    """
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise TypeError(f"expected a class derived from Effect, got {kind!r}")
    if inspect.isabstract(kind):
        raise TypeError(f"the class lacks the methods {', '.join(sorted(kind.__abstractmethods__))}")
    # the fields are the magnitudes stored in provenance; two equal effects must compare equal
    if not is_dataclass(kind) or not kind.__dataclass_params__.frozen:
        raise TypeError("expected a frozen dataclass; decorate the class with @dataclass(frozen=True)")
    if not isinstance(getattr(kind, "title", None), str) or not isinstance(getattr(kind, "acts_on", None), ActsOn):
        raise TypeError("the class lacks a title (str) or acts_on (ActsOn)")
    # tried here, because an estimate that fails later would stop every plan, even one without this effect
    camera = preset("bench")
    outlook = Outlook(camera, camera.depth_of(4.0), (61, 61), (33, 19))
    found = kind().estimate(outlook)
    if not isinstance(found, Estimate) or not math.isfinite(found.error):
        raise TypeError("estimate() did not return an Estimate with a finite error")
    kind().seconds(outlook, EngineSeconds(1.0, 1.0))


def find_effects() -> Registry[type[Effect]]:
    """Return the effect classes by name, including those from plug-in packages.

    They are in the order of `ActsOn`, then of `Effect.rank`.

    Examples
    --------
    >>> from lfcal.simulate.effects import find_effects
    >>> kinds = find_effects()
    >>> Coma = kinds.get("coma")
    >>> print(Coma.title, Coma(waves=0.5), sep=": ")
    coma: Coma(waves=0.5, angle_rad=0.0)
    """
    places = list(ActsOn)
    return Registry(
        "effect",
        "lfcal.simulate.effects",
        "EFFECTS",
        GROUP,
        order=lambda kind: (places.index(kind.acts_on), kind.rank, kind.name),
        check=check_effect,
    )


CATALOGUE = find_effects()
"""All kinds of effects."""


def catalogue() -> tuple[Effect, ...]:
    """Return one instance of every effect, with default magnitudes, in the order of `find_effects`.

    Deviations have a typical size. Magnitudes of the camera's description are None.

    Examples
    --------
    >>> from lfcal.simulate.effects import catalogue
    >>> effects = {effect.name: effect for effect in catalogue()}
    >>> effects["lenslet_gap"], effects["read_noise"]  # a typical error; what the camera says
    (LensletGap(error_um=5.0), ReadNoise(rms_e=None))
    """
    return tuple(kind() for kind in CATALOGUE)
