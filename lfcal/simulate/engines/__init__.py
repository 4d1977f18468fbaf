"""Engines that compute the patterns of one depth plane, one for each level of accuracy.

- ``base``: interface of an engine, its sampling and energy balance; ``choose`` selects one
- ``_geometric``: rays; ``_wave``: waves of each lenslet, added without phase; ``microscope``: Debye integral,
  coherent; ``grid``: all lenslets on one grid, coherent; ``reference``: the coherent sum over the whole array
- ``_fields_sum``: fields that do not interfere, with one engine for each
- ``field``: the light in front of the array; ``masks``, ``_polygon``: apertures; ``tables``: tables computed once for
  each plane
- ``_nodes``, ``_quadrature``, ``_radial``, ``_debye``, ``zernike``: numerical methods
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.engines._shared import *  # noqa: F403

lazy_face(__name__)
