"""The projector pair and its methods.

- ``projector``: `Projector`; ``_polyphase``, ``_direct``, ``_sparse``, ``_position_fft`` are its methods
- ``grid``, ``_tiles``, ``_planes``, ``_engine``: the lattice of whole periods, overlap-save tiles, planes of H, and
  what all methods share
- ``forecast``, ``_rates``: cost of each method on this machine
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct.projectors._shared import *  # noqa: F403

lazy_face(__name__)
