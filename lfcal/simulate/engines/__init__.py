"""Engines that compute the patterns of one depth plane, one per level of accuracy.

- ``base``: interface of an engine, its sampling and energy balance; ``choose`` selects one
- ``_geometric``: rays; ``_wave``: waves per lenslet, summed without phase; ``microscope``: Debye integral, coherent;
  ``reference``: the coherent sum over the whole array
- ``_fields_sum``: incoherent fields, with one engine each
- ``field``: the light in front of the array; ``masks``, ``_polygon``: apertures; ``tables``: tables computed once per
plane
- ``_nodes``, ``_quadrature``, ``_radial``, ``_debye``, ``zernike``: numerical parts
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.engines._shared import *  # noqa: F403

lazy_face(__name__)
