"""A specimen of another refractive index than the immersion medium, behind a plane interface."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.checks import check_number

__all__ = ["Specimen"]


@dataclass(frozen=True, slots=True)
class Specimen:
    """What the light crosses on its way from a microscope's source to the immersion medium.

    Attributes
    ----------
    index
        Refractive index of the specimen.
    depth_um
        Depth of the nominal focal plane below the interface: a source at z lies ``depth_um + z`` deep, and one that
        lies before the interface in the immersion medium.
    """

    index: float
    depth_um: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("index of the specimen", self.index, at_least=1, at_most=4)
        check_number("depth of the focal plane below the interface (µm)", self.depth_um, at_least=0)

    def source_um(self, z_um: float) -> float:
        """Return the depth of a source below the interface; negative before it."""
        return self.depth_um + z_um

    def focus_um(self, z_um: float, medium_index: float) -> float:
        """Return where a source at ``z_um`` seems to lie by paraxial rays, as seen in the immersion medium."""
        deep = self.source_um(z_um)
        return z_um if deep < 0 else medium_index * deep / self.index - self.depth_um
