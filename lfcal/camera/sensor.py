"""Image sensor."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.base import InputError, check_length, check_number, check_tuple, check_type

__all__ = ["Sensor"]

CFA_LETTERS = "RGBWCMYE"


@dataclass(frozen=True, slots=True)
class Sensor:
    """Image sensor: its pixels, noise and range.

    Attributes
    ----------
    shape
        Number of pixels ``(rows, columns)``.
    pixel_um
        Pixel pitch (µm); with relay optics between lenslets and sensor, the pitch of the image of the pixels at the
        lenslets.
    bit_depth
        Number of bits of a sample.
    full_well_e
        Full well: signal at the highest sample value (electrons).
    read_noise_e
        Read noise (electrons rms).
    dark_current_e_s
        Dark current (electrons per pixel per second).
    black_level
        Sample value without light (counts).
    prnu
        Photo-response non-uniformity (PRNU): rms variation of the pixel gains relative to their mean.
    quantum_efficiency
        Quantum efficiency: fraction of the incident photons that are detected, above 0 and at most 1.
    fill_factor
        Light-sensitive fraction of the area of a pixel, above 0 and at most 1.
    cfa
        Letters of the colour filters of one unit of the pattern in row-major order, such as ``"GRBG"`` for 2 x 2
        pixels; empty for a monochrome sensor.
    saturation
        Lowest sample value that counts as saturated (counts). None: the highest sample value.
    dsnu_e
        Dark-signal non-uniformity (DSNU): rms variation of the pixel offsets in the dark (electrons). None: unknown.
    linearity
        Largest relative deviation of the signal from a linear response to exposure. None: unknown.

    Examples
    --------
    >>> from lfcal.camera import Sensor
    >>> sensor = Sensor((1000, 1600), pixel_um=5.0, bit_depth=10, full_well_e=10_230)
    >>> print(sensor.max_value, sensor.electrons_per_count, sensor.centre_px)
    1023 10.0 (499.5, 799.5)
    """

    shape: tuple[int, int] = (4384, 6576)
    pixel_um: float = 5.5
    bit_depth: int = 12
    full_well_e: float = 20e3
    read_noise_e: float = 12.0
    dark_current_e_s: float = 1.0
    black_level: float = 0.0
    prnu: float = 0.01
    quantum_efficiency: float = 0.5
    fill_factor: float = 1.0
    cfa: str = ""
    saturation: float | None = None
    dsnu_e: float | None = None
    linearity: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        shape = check_tuple("sensor shape (rows, columns)", self.shape, 2, at_least=1, at_most=200_000, integer=True)
        object.__setattr__(self, "shape", shape)
        check_length("pixel pitch (µm)", self.pixel_um)
        check_number("bit depth", self.bit_depth, at_least=1, at_most=16, integer=True)
        check_number("full well (e-)", self.full_well_e, above=0)
        check_number("read noise (e-)", self.read_noise_e, at_least=0)
        check_number("dark current (e-/s)", self.dark_current_e_s, at_least=0)
        check_number("black level", self.black_level, at_least=0, below=self.max_value)
        check_number("PRNU", self.prnu, at_least=0, at_most=1)
        check_number("quantum efficiency", self.quantum_efficiency, above=0, at_most=1)
        check_number("fill factor", self.fill_factor, above=0, at_most=1)
        if self.saturation is not None:
            check_number("saturation (sample value)", self.saturation, above=self.black_level, at_most=self.max_value)
        for what, value in (("DSNU (e-)", self.dsnu_e), ("linearity", self.linearity)):
            if value is not None:
                check_number(what, value, at_least=0)
        check_type("colour filter pattern", self.cfa, str)
        # Bayer is 2 x 2, Quad Bayer 4 x 4, X-Trans 6 x 6
        side = {0: 0, 1: 1, 4: 2, 16: 4, 36: 6}.get(len(self.cfa))
        if side is None or any(letter not in CFA_LETTERS for letter in self.cfa):
            raise InputError.expected(
                "colour filter pattern",
                f"1, 4, 16 or 36 letters from {CFA_LETTERS}",
                repr(self.cfa),
                'list the letters of one period row by row ("GRBG"), or give "" for a monochrome sensor',
            )

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre ``(row, column)`` of the sensor (px); integers are pixel centres."""
        return (self.shape[0] - 1) / 2, (self.shape[1] - 1) / 2

    @property
    def max_value(self) -> int:
        """Highest possible sample value (counts), 2^`bit_depth` - 1."""
        return (1 << self.bit_depth) - 1

    @property
    def saturated_from(self) -> float:
        """Lowest sample value that counts as saturated (counts)."""
        return float(self.max_value if self.saturation is None else self.saturation)

    @property
    def electrons_per_count(self) -> float:
        """Conversion factor from counts above the black level to electrons (electrons per count)."""
        # full well is reached at the highest sample value, and the black level corresponds to no electrons
        return self.full_well_e / (self.max_value - self.black_level)
