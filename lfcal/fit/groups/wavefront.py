"""Zernike terms of the main lens or objective."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import Zernike

__all__ = ["WavefrontGroup"]

HELD = "piston, tilt and defocus are fixed at 0"
DEFOCUS = 0.25
"""Usual defocus of a main lens or objective (waves at the pupil's rim), as a standard deviation."""


def _name(n: int, m: int) -> str:
    return f"zernike_{n}_{m}" if m >= 0 else f"zernike_{n}_m{-m}"


class WavefrontGroup(Group):
    """Group of Zernike terms of the wavefront.

    Parameters
    ----------
    name, title, rank
        As in `Group`.
    terms
        Radial and azimuthal orders (n, m) of the terms, whose radial polynomials are 1 at the rim of the pupil.
    late
        Whether the terms are tried only after the other groups.
    """

    needs = "a main lens"  # an objective is simulated with terms of rotational symmetry alone

    def __init__(
        self, name: str, title: str, rank: int, terms: tuple[tuple[int, int], ...], *, late: bool = False
    ) -> None:
        self.name, self.title, self.rank, self.terms, self.late = name, title, rank, terms, late

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the coefficients of the Zernike terms (waves at the rim).

        For an objective, only terms with m = 0 are unknowns. The result is empty without a periodic array.
        """
        del frame
        own = setup.effect(Zernike)
        known = {} if own is None else {(n, m): waves for n, m, waves in own.terms}
        return tuple(
            Unknown(_name(n, m), self.name, "waves", known.get((n, m), 0.0), 0.1, None, -10.0, 10.0, gauge=HELD)
            for n, m in self._terms_of(setup)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the coefficients in ``values``; the other terms of its wavefront are unchanged."""
        del frame
        own = setup.effect(Zernike)
        known = {} if own is None else {(n, m): waves for n, m, waves in own.terms}
        known |= {(n, m): values[_name(n, m)] for n, m in self._terms_of(setup)}
        return setup.with_effect(Zernike(tuple((n, m, waves) for (n, m), waves in known.items())))

    def _terms_of(self, setup: Setup) -> tuple[tuple[int, int], ...]:
        """Return the terms that can be simulated; for an objective, only those with rotational symmetry."""
        if not setup.camera.has_lattice:
            return ()
        lens = not setup.camera.optics.telecentric
        return tuple((n, m) for n, m in self.terms if lens or m == 0)


class ThirdOrder(WavefrontGroup):
    """Third-order terms, tried together with the groups ``distance`` and ``stage_zero``.

    The reason is that the Seidel forms of these terms also contain defocus and tilt.
    """

    along = ("distance", "stage_zero")


class Defocus(WavefrontGroup):
    """Defocus of the wavefront, proportional to the square of the pupil radius.

    For a main lens, defocus has the same effect as a common displacement of all planes, and is included in it. For the
    wide pupil of an objective, the two differ, because the phase of a displacement depends on the cosine of the angle.
    For objectives, the fit therefore uses distance, depth in a specimen and spherical aberration instead.
    """

    held = True

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the coefficient (waves), with a prior standard deviation of a quarter of a wave."""
        return tuple(replace(one, sigma=DEFOCUS, gauge="") for one in super().unknowns(setup, frame))


GROUPS = (
    Defocus("defocus", "defocus of the wavefront of the main lens or objective", 51, ((2, 0),)),
    ThirdOrder(
        "wavefront", "astigmatism, coma and spherical aberration", 50, ((2, 2), (2, -2), (3, 1), (3, -1), (4, 0))
    ),
    WavefrontGroup("trefoil", "trefoil", 52, ((3, 3), (3, -3))),
    WavefrontGroup(
        "higher_wavefront",
        "remaining wavefront of fourth and sixth order",
        54,
        ((4, 2), (4, -2), (4, 4), (4, -4), (6, 0)),
    ),
    WavefrontGroup(
        "fifth_order_wavefront",
        "wavefront of fifth order",
        56,
        ((5, 1), (5, -1), (5, 3), (5, -3), (5, 5), (5, -5)),
        late=True,
    ),
)
