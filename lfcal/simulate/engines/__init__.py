"""From one depth plane to its patterns: one engine a level of accuracy.

- ``base``: what an engine provides, its sampling, and the energy it accounts for; ``choose`` picks one
- ``_geometric``: rays; ``_wave``: waves per lenslet, summed without phase; ``microscope``: Debye integral, coherent;
  ``reference``: the coherent sum over the whole array
- ``_fields_sum``: fields that do not interfere, one engine each
- ``field``: the light in front of the array; ``masks``, ``_polygon``: apertures; ``tables``: what a plane needs once
- ``_nodes``, ``_quadrature``, ``_radial``, ``_debye``, ``zernike``: numerical parts
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.engines._shared import *  # noqa: F403

lazy_face(__name__)
