"""Hypothesis strategies for cameras and plans."""

from __future__ import annotations

from hypothesis import strategies as st

from lfcal.camera import BrownDistortion, Camera, LensletLattice, LensType, MainLens, Microscope, Sensor


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


depth_ranges = st.none() | st.tuples(numbers(-5, 2), numbers(2.5, 50))
lens_types = st.builds(LensType, numbers(500, 5000), depth_ranges)
lattices = st.one_of(
    st.builds(
        LensletLattice,
        kind=st.sampled_from(["square", "hexagonal"]),
        pitch_um=numbers(60, 300),
        gap_um=numbers(300, 3000),
        types=st.tuples(lens_types),
        rotation_rad=numbers(-0.02, 0.02),
        offset_um=st.tuples(numbers(-500, 500), numbers(-500, 500)),
        clear_um=st.none() | numbers(30, 60),
        row_pitch_um=st.none() | numbers(60, 300),
    ),
    st.builds(
        LensletLattice,
        kind=st.just("hexagonal"),
        pitch_um=numbers(60, 300),
        gap_um=numbers(300, 3000),
        types=st.tuples(lens_types, lens_types, lens_types),
        rotation_rad=numbers(-0.02, 0.02),
        type_step=st.sampled_from([1, 2]),
    ),
)
optics = st.one_of(
    st.builds(
        MainLens,
        focal_length_um=numbers(30e3, 200e3),
        f_number=numbers(1, 16),
        working_distance_um=numbers(250e3, 3e6),
        blades=st.sampled_from([0, 3, 5, 9, 11]),
        blade_curvature=numbers(0, 1),
    ),
    st.builds(Microscope, numbers(5, 100), numbers(0.1, 0.95), numbers(1, 1.6), numbers(1e5, 3e5)),
)
sensors = st.builds(
    Sensor,
    shape=st.tuples(st.integers(1500, 6000), st.integers(1500, 6000)),
    pixel_um=numbers(2, 10),
    bit_depth=st.integers(8, 16),
    cfa=st.sampled_from(["", "GRBG", "RGGB"]),
)
cameras = st.builds(
    Camera,
    name=st.text(max_size=10),
    optics=optics,
    lattice=lattices,
    sensor=sensors,
    wavelength_um=numbers(0.3, 1),
    bandwidth_um=numbers(0, 0.2),
    distortion=st.none()
    | st.builds(
        BrownDistortion, st.tuples(numbers(-1, 1), numbers(-1, 1)), st.tuples(numbers(0, 4000), numbers(0, 4000))
    ),
)
