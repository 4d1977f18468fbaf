"""Modulators over every plenoptic dimension: spectra, exposure, time, cameras, polarisation, tiles, files."""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.multiplex import (
    amplification,
    cfa,
    demultiplex,
    mask,
    modulator_from_matrix,
    monte_carlo_gain,
    multiplex,
    snr_gain,
    transmission,
)
from lfcal.multiplex.exposures import camera_array, coded_shutter, interleave, neutral_density
from lfcal.multiplex.matrix_file import load_modulator, save_modulator
from lfcal.multiplex.naming import modulator_of
from lfcal.multiplex.polarisation import degree_of_polarisation, polarisers
from lfcal.multiplex.spectra import (
    TABLES,
    Spectra,
    bandpass_filters,
    colour_matching,
    cosine_basis,
    daylight,
    read_spectra,
    shipped_spectra,
    spectral_array,
)
from lfcal.multiplex.tiles import tile_pixels, tiled_modulator

RNG = np.random.default_rng
FOUR = [[0, 45], [135, 90]]
NINE = spectral_array("F0,F1,F2/F3,F4,F5/F6,F7,F8", 9, filters=bandpass_filters(np.linspace(416, 684, 9), 50))
SHUTTER = coded_shutter(np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]], float))


# -- each basis: Monte Carlo and the formula ------------------------------------------------------------
FULL = [[0, 90, 45], [135, 45, 135]], [[0, 0, 0], [0, 90, 90]]
TILE = tiled_modulator("L", [(0, 0), (1, 0), (1, 1)], [(1, 2), (2, 1)], np.eye(3) * 0.7 + 0.1, colours=("R", "G", "B"))
ONE_AT_A_TIME = modulator_from_matrix("one at a time", (3, 3), np.eye(9), colours=NINE.colours)
THREE = polarisers([[0, 60, 120]])
CASES = {
    "spectral": (NINE, ONE_AT_A_TIME),
    "spectral, silicon": (modulator_of("bands:RG/GB:3"), modulator_of("bands:CM/YG:3")),
    "exposure": (neutral_density([[1, 0.25], [0.25, 0.0625]]), neutral_density([[1.0]])),
    "polarisation": (polarisers(FOUR), THREE),
    "polarisation, S3": (
        polarisers(FULL[0], retardance_deg=FULL[1]),
        polarisers([[0, 45, 90, 45]], retardance_deg=[[0, 0, 0, 90]]),
    ),
    "time": (SHUTTER, coded_shutter([[[1, 0, 0], [0, 1, 0], [0, 0, 1]]])),
    "cameras": (camera_array(2, 2), mask("pinhole", 2)),
    "colour x polarisation": (polarisers(FOUR) * cfa("RRGG/RRGG/GGBB/GGBB"), THREE * cfa("R/G/B")),
    "tile": (TILE, cfa("Bayer")),
}


@pytest.mark.few(9)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("chi2", [0.0, 3.0, math.inf])
def test_monte_carlo_is_the_formula_within_a_percent(name: str, chi2: float) -> None:
    measured = monte_carlo_gain(*CASES[name], chi2, rng=RNG(3), trials=30_000)
    wanted = snr_gain(*CASES[name], chi2)
    assert 10 ** (measured / 10) == pytest.approx(10 ** (wanted / 10), rel=0.01)


# -- spectra -------------------------------------------------------------------------------------------
def illuminant_a(waves: np.ndarray) -> np.ndarray:
    """Return CIE standard illuminant A, relative power, 100 at 560 nm (CIE 15, equation of the standard)."""
    return 100 * (560 / waves) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * waves))


def test_tables_state_their_source_and_follow_their_formulas() -> None:
    for name in TABLES:
        table = shipped_spectra(name)
        assert len(table.source) > 60 and table.values.min() >= 0
    lights = shipped_spectra("illuminants")
    np.testing.assert_allclose(lights.named("A").values[0], illuminant_a(lights.wavelengths_nm), atol=1e-4)
    np.testing.assert_allclose(lights.named("D65").values[0], daylight(6504).on(lights.wavelengths_nm)[0], atol=1e-4)
    # values printed in CIE 15
    for name, waves, printed in (
        ("A", 400, 14.7080),
        ("A", 700, 198.261),
        ("D65", 450, 117.008),
        ("D65", 650, 80.0268),
    ):
        assert lights.named(name).on(waves)[0, 0] == pytest.approx(printed, rel=3e-4)
    # chromaticities of CIE 15 through the fitted observer
    waves = np.arange(380.0, 781.0, 5.0)
    for power, x, y in ((illuminant_a(waves), 0.4476, 0.4074), (daylight(6504).on(waves)[0], 0.3127, 0.3290)):
        xyz = colour_matching(waves) @ power
        assert (xyz / xyz.sum())[:2] == pytest.approx([x, y], abs=0.003)


def test_daylight_is_that_of_colour_science() -> None:
    if importlib.util.find_spec("colour") is None:
        pytest.skip("colour-science is not installed")
    colour = importlib.import_module("colour")
    power = colour.SDS_ILLUMINANTS["D65"]
    waves = np.arange(380, 781, 10)
    np.testing.assert_allclose(daylight(6504).on(waves)[0], [power[w] for w in waves], atol=0.05)


def test_bands_are_means_of_filter_efficiency_and_light() -> None:
    waves = np.array([400.0, 500.0, 600.0, 700.0])
    filters = Spectra(("a", "b"), waves, np.array([[1.0, 1, 0, 0], [0, 0.5, 1, 1]]))
    qe = Spectra(("q",), waves, np.array([[0.5, 0.5, 0.5, 0.5]]))
    light = Spectra(("e",), waves, 1 / waves[None])  # as many photons everywhere, but for the table's chords
    plain = spectral_array("a,b", (400, 500, 600, 700), filters=filters, efficiency=qe)
    np.testing.assert_allclose(plain.matrix, [[0.5, 0.25, 0], [0.125, 0.375, 0.5]], atol=1e-12)
    lit = spectral_array("a,b", (400, 500, 600, 700), filters=filters, efficiency=qe, illuminant=light)
    np.testing.assert_allclose(lit.matrix, plain.matrix, rtol=0.02)
    assert transmission(plain) == pytest.approx(plain.matrix.sum() / 6)
    assert plain.rank() == 2 and not math.isfinite(amplification(plain))
    uneven = spectral_array("a,b", (400, 600, 700), filters=filters)
    np.testing.assert_allclose(uneven.light, [2 / 3, 1 / 3])


def test_few_filters_recover_smooth_spectra() -> None:
    basis = cosine_basis(12, 3)
    m = spectral_array("RG/GB", 12, basis=basis, illuminant=shipped_spectra("illuminants").named("D65"))
    assert m.count == 3 and m.rank() == 3
    spectrum = basis @ [0.5, 0.2, -0.1]
    whole = spectral_array("RG/GB", 12, illuminant=shipped_spectra("illuminants").named("D65"))
    frame = np.tile((whole.matrix @ spectrum).reshape(2, 2), (6, 6))
    found = demultiplex(frame, m)[:, 5, 5]
    np.testing.assert_allclose(basis @ found, spectrum, atol=1e-9)


def test_a_basis_of_another_shape_or_with_nan_is_refused() -> None:
    for basis, message in (
        (np.ones((3, 2)), r"basis of spectra: expected shape \(4, N\), got \(3, 2\); give one row per band"),
        (np.full((4, 2), np.nan), "basis of spectra: expected finite numbers, got NaN or infinity; correct the values"),
    ):
        with pytest.raises(InputError, match=f"^{message}$"):
            spectral_array("RG/GB", 4, basis=basis)


def test_ideal_filters_of_three_bands_are_those_of_the_paper() -> None:
    """Ideal filters over three bands are `cfa`."""
    ideal = Spectra(
        ("R", "G", "B"),
        np.array([400, 499.9999, 500.0001, 599.9999, 600.0001, 700]),
        np.array([[0, 0, 0, 0, 1, 1], [0, 0, 1, 1, 0, 0], [1, 1, 0, 0, 0, 0]], float),
    )
    m = spectral_array("RG/GB", 3, filters=ideal)
    np.testing.assert_allclose(m.matrix[:, ::-1], cfa("Bayer").matrix, atol=1e-5)


def test_tables_of_users(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    path.write_text("# measured by hand\nwavelength_nm,A,B\n400,0.1,1\n700,0.5,0\n", encoding="utf-8")
    found = read_spectra(path)
    assert found.source == "measured by hand" and found.on(550)[1, 0] == pytest.approx(0.5)
    with pytest.raises(InputError, match="400"):
        found.on(350)
    for text in (
        "",
        "nm,A\n1,2\n2,3\n",
        *("wavelength_nm,A\n" + end for end in ("400,x\n", "500,1\n400,1\n", "400,1,2\n")),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(FileFormatError):
            read_spectra(path)


# -- polarisation ---------------------------------------------------------------------------------------
def test_polarisers_pass_half_of_unpolarised_light() -> None:
    m = polarisers(FOUR)
    assert transmission(m) == pytest.approx(0.5)
    # A^T A of four angles a right angle apart is diag(1, 1/2, 1/2)
    assert amplification(m) == pytest.approx(math.sqrt(5 / 3))
    rng = RNG(0)
    for _ in range(50):  # Malus: any state of light passes between 0 and all of it
        s = rng.standard_normal(2)
        s = np.array([1.0, *(s / np.hypot(*s))])
        shares = polarisers(rng.uniform(0, 180, (3, 3))).matrix @ s
        assert shares.min() >= -1e-12 and shares.max() <= 1 + 1e-12
    assert polarisers([[30.0]]).matrix @ [1, math.cos(math.pi / 3), math.sin(math.pi / 3)] == pytest.approx(1)
    assert polarisers([[math.nan, 0]]).matrix[0] == pytest.approx([1, 0, 0])
    weak = polarisers([[0.0]], extinction=9.0).matrix @ np.array([[1, 1, 0], [1, -1, 0]]).T
    assert weak[0, 0] / weak[0, 1] == pytest.approx(9) and weak.sum() == pytest.approx(1)


def test_circular_light_needs_a_retarder() -> None:
    m = polarisers([[45, 135, 0, 45]], retardance_deg=[[90, 90, 0, 0]])
    right = m.matrix @ [1, 0, 0, 1]
    assert right[:2] == pytest.approx([1, 0]) and right[2:] == pytest.approx([0.5, 0.5])
    assert m.rank() == 4 and polarisers([[45, 135, 0, 45]]).count == 3
    assert degree_of_polarisation(np.array([[2.0], [1.0], [0.0]])) == pytest.approx(0.5)


def test_stokes_are_recovered() -> None:
    light = np.array([1.0, 0.3, -0.2])[:, None, None] * np.ones((12, 12))
    m = polarisers(FOUR)
    np.testing.assert_allclose(demultiplex(multiplex(light, m), m), light, atol=1e-12)


# -- exposure, time, cameras ----------------------------------------------------------------------------
def test_moments_are_separated() -> None:
    light = RNG(1).random(3)[:, None, None] * np.ones((8, 8))
    np.testing.assert_allclose(demultiplex(multiplex(light, SHUTTER), SHUTTER), light, atol=1e-12)
    # the pixel that is open throughout adds up all moments
    assert multiplex(light, SHUTTER)[1, 1] == pytest.approx(light[:, 0, 0].sum())


def test_cameras_are_pixels_of_a_super_pixel() -> None:
    """Four cameras behind R, G, G and B of a distant scene are a Bayer mosaic; of a near one they see four views."""
    frames = [np.full((5, 6), value) for value in (1.0, 2.0, 2.0, 3.0)]
    mosaic = interleave(frames, (2, 2))
    colours = demultiplex(mosaic, cfa("RG/GB"), filter="cubic", samples=1)
    np.testing.assert_allclose(colours, np.array([1.0, 2, 3])[:, None, None] * np.ones((3, 5, 6)), atol=1e-12)
    views = demultiplex(interleave([RNG(k).random((5, 6)) for k in range(4)], (2, 2)), camera_array(2, 2))
    for k, view in enumerate(views):
        np.testing.assert_allclose(view, RNG(k).random((5, 6)) / 4, atol=1e-12)
    # cameras have their light to themselves, as lenslets: 10 log10 of sqrt(K) over a mask's pinhole at photon noise
    assert snr_gain(camera_array(2, 2), mask("pinhole", 2), math.inf) == pytest.approx(5 * math.log10(4))
    shuttered = camera_array(2, 1) * coded_shutter(np.eye(2)[None].transpose(1, 0, 2))
    assert shuttered.count == 4 and shuttered.rank() == 2, "each camera sees one moment only"


def test_products_are_products_of_transmissions() -> None:
    one, two = polarisers([[0, 60, 120]]), cfa("R/G/B")
    m = one * two
    assert m.side == (3, 3) and m.count == 9 and m.colours[:4] == ("S0 R", "S0 G", "S0 B", "S1 R")
    assert transmission(m) == pytest.approx(0.5 / 3) and m.rank() == 9
    np.testing.assert_allclose(m.matrix[4], np.kron(one.matrix[1], two.matrix[1]))
    field = mask("MURA", 3) * polarisers([[0], [60], [120]])
    assert field.views == (3, 3) and field.colours == ("S0", "S1", "S2")
    three = mask("pinhole", 2) * (SHUTTER * cfa("Bayer"))
    assert three.count == 4 * 9 and three.colours[1] == "t0 G"
    for first, second in ((mask("lenslet", 2), cfa("Bayer")), (cfa("Bayer"), mask("lenslet", 2))):
        assert (first * second).sample_names[:4] == ("view 0,0 R", "view 0,0 G", "view 0,0 B", "view 0,1 R")
    np.testing.assert_allclose((cfa("Bayer") * mask("MURA", 3)).matrix, (mask("MURA", 3) * cfa("Bayer")).matrix)
    for a, b in (
        (cfa("Bayer"), cfa("CYMG")),
        (SHUTTER, SHUTTER),
        (cfa("Bayer"), NINE),
        (mask("lenslet", 2), mask("MURA", 3)),
    ):
        with pytest.raises(InputError, match="product"):
            a * b


# -- tiles and files ------------------------------------------------------------------------------------
def test_tiles_of_any_shape() -> None:
    which = tile_pixels([(0, 0), (1, 0), (1, 1)], [(1, 2), (2, 1)])
    assert which.shape == (3, 3) and np.bincount(which.ravel()).tolist() == [3, 3, 3]
    plus = tile_pixels([(0, 1), (1, 0), (1, 1), (1, 2), (2, 1)], [(1, 2), (2, -1)])
    assert plus.shape == (5, 5) and set(plus[0]) == set(range(5))
    quincunx = tiled_modulator("quincunx", [(0, 0), (0, 1)], [(1, 1), (0, 2)], np.eye(2), colours=("a", "b"))
    np.testing.assert_allclose(quincunx.matrix[:, 0].reshape(quincunx.side), [[1, 0], [0, 1]])
    plain = modulator_from_matrix("stripes", (1, 2), np.eye(2), colours=("a", "b"))
    assert snr_gain(quincunx, plain, 1.0) == pytest.approx(0)
    for pixels, vectors in (
        ([(0, 0)], [(1, 1), (0, 2)]),
        ([(0, 0), (1, 1)], [(1, 1), (0, 2)]),
        ([(0, 0)], [(1, 1), (2, 2)]),
    ):
        with pytest.raises(InputError, match="tile"):
            tile_pixels(pixels, vectors)


def test_matrices_of_users(tmp_path: Path) -> None:
    np.save(tmp_path / "own.npy", cfa("CYMG").matrix.reshape(2, 2, 3))
    np.save(tmp_path / "flat.npy", cfa("CYMG").matrix)
    known = {"name": "mine", "side": [1, 4], "matrix": cfa("CYMG").matrix.tolist(), "colours": ["R", "G", "B"]}
    (tmp_path / "own.json").write_text(json.dumps(known), encoding="utf-8")
    (tmp_path / "bare.json").write_text(json.dumps(known["matrix"]), encoding="utf-8")
    for name in ("own.npy", "flat.npy", "own.json", "bare.json"):
        assert snr_gain(modulator_of(str(tmp_path / name)), cfa("Bayer"), 0.0) == pytest.approx(0.645, abs=1e-3)
    assert load_modulator(tmp_path / "own.json").name == "mine"
    assert modulator_of(f"lenslet:3*{tmp_path / 'own.npy'}").count == 27
    with pytest.raises(StorageError, match=r"none\.npy"):
        load_modulator(tmp_path / "none.npy")


def test_damaged_matrices_of_users_are_refused(tmp_path: Path) -> None:
    known = {"name": "mine", "side": [1, 4], "matrix": cfa("CYMG").matrix.tolist(), "colours": ["R", "G", "B"]}
    arrays = (np.ones((3, 2)), np.array([object()]), np.full((2, 2, 3), np.nan))
    for k, array in enumerate(arrays):
        np.save(tmp_path / f"{k}.npy", array, allow_pickle=True)
    texts = [
        "{}",
        "[1",
        json.dumps(known | {"sides": 1}),
        json.dumps(known | {"side": [2, 3]}),
        json.dumps({"matrix": [[1, 0], [0, 1], [1, 1], [0, 1]], "lenslets": "false"}),  # a word is not a truth value
        json.dumps({"matrix": [[1e308, -1e308]] * 4}),
        json.dumps({"matrix": [[-1.0, 0.0], [0.0, 1.0], [1, 1], [0, 1]]}),  # less than no light
        json.dumps({"matrix": [[255.0, 0.0], [0.0, 255.0], [255, 0], [0, 255]]}),  # counts, not shares
    ]
    for k, text in enumerate(texts):
        (tmp_path / f"{k}.json").write_text(text, encoding="utf-8")
    for name in (*(f"{k}.npy" for k in range(len(arrays))), *(f"{k}.json" for k in range(len(texts)))):
        with pytest.raises(FileFormatError, match=name):
            load_modulator(tmp_path / name)
    with pytest.raises(FileFormatError, match="got 3 pixels, which do not fill a square; give"):
        load_modulator(tmp_path / "0.npy")


def test_modulators_are_written_and_read(tmp_path: Path) -> None:
    for m in (mask("MURA", 5), mask("lenslet", 3) * cfa("CYMG"), polarisers(FOUR)):
        save_modulator(m, tmp_path / f"{m.count}.json")
        kept = load_modulator(tmp_path / f"{m.count}.json")
        for what in ("name", "side", "views", "colours", "cell", "lenslets"):
            assert getattr(kept, what) == getattr(m, what)
        np.testing.assert_array_equal(kept.matrix, m.matrix)
        np.testing.assert_array_equal(kept.light, m.light)
    with pytest.raises(InputError, match="end the name of the file"):
        save_modulator(m, tmp_path / "kept.txt")


WRONG = [
    *("MURA:²", "MURA:", "MURA:99999999999", "bands:RG/GB:²", "cameras:²x2", "masks:3", "shutter:", "nd:1,x", "nd:2"),
    *("polarisers:0,45/90", "bands:RG/GB", "bands:RG/QB:3", "bands:RG/GB:3:silicon", "bands:RG/GB:3:filters="),
    *("bands:RG/GB:3:illuminant=A,illuminant=D65", "bands:RG/GB:3:illuminant=illuminants"),
    *("shutter:10,0", "cameras:2", "cameras:0x2"),
]


def test_modulators_in_words() -> None:
    for text, count in (
        ("nd:1,0.5/0.25,0.1", 1),
        ("polarisers:0,45/135,90*RRGG/RRGG/GGBB/GGBB", 9),
        ("bands:RG/GB:3", 3),
        ("shutter:100,010/001,111", 3),
        ("cameras:2x2*Bayer", 12),
    ):
        assert modulator_of(text).count == count
    for text in WRONG:
        with pytest.raises(InputError):
            modulator_of(text)
            pytest.fail(f"accepted {text}")


def test_bands_in_words_use_tables_of_the_user(tmp_path: Path) -> None:
    filters = bandpass_filters([450, 550, 650], 80)
    own, bare = tmp_path / "own filters.csv", tmp_path / "bare.csv"
    columns = np.vstack([filters.wavelengths_nm, filters.values]).T
    rows = [",".join(repr(float(v)) for v in column) for column in columns]
    own.write_text("\n".join(["# mine", "wavelength_nm,F0,F1,F2", *rows]) + "\n", encoding="utf-8")
    bare.write_text("wavelength_nm,all\n300,1\n1100,1\n", encoding="utf-8")
    words = f"bands:F0,F1/F1,F2:3:filters={own},efficiency={bare}, illuminant=d65"
    d65 = shipped_spectra("illuminants").named("D65")
    expected = spectral_array("F0,F1/F1,F2", 3, filters=filters, illuminant=d65)
    np.testing.assert_allclose(modulator_of(words).matrix, expected.matrix, rtol=1e-12)
    assert modulator_of(f"bands:RG/GB:3:efficiency={bare}").matrix.sum() > modulator_of("bands:RG/GB:3").matrix.sum()
    np.testing.assert_array_equal(
        modulator_of("bands:RG/GB:3:efficiency=silicon").matrix, modulator_of("bands:RG/GB:3").matrix
    )
    with pytest.raises(StorageError, match=r"none\.csv"):
        modulator_of("bands:RG/GB:3:filters=none.csv")
