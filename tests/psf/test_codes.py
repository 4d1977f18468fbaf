"""H for one code: read back in the layout of that code, by its own projection."""

from __future__ import annotations

import itertools
import shutil
import subprocess
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageSequence
from scipy.io import loadmat

from lfcal.base import InputError
from lfcal.camera import preset
from lfcal.psf import CODES, PSFMatrix, export, export_notes, iter_export, lens_centre_of, open_psf
from lfcal.psf._export import ExportOptions
from lfcal.psf.codes import codes_for
from lfcal.psf.lens_centre import lens_centred
from lfcal.reconstruct import Projector
from lfcal.records import CODE_NAMES
from tests.psf.test_matlab import conv2_same, forward_project, matlab, square_camera

Array = NDArray[Any]
N = 3
SNIPPET = (Path(__file__).parents[2] / "docs" / "matlab.md").read_text(encoding="utf-8")


def matrix() -> PSFMatrix:
    values = np.random.default_rng(0).random((2, N, N, 5, 5), np.float32)
    return PSFMatrix(values, camera=square_camera(N, 31), anchor=(4, 6), depths=[1.0, 2.0])


def expected(volume: Array) -> Array:
    """Return the image of a volume ``(rows, columns, z)`` by lfcal, with a lens on pixel ceil(N/2) of each period."""
    H = matrix()
    lens = lens_centre_of(H)
    assert lens is not None and not lens.agrees
    seen: Array = Projector(lens_centred(H, lens), volume.shape[:2], anchor=(0.0, 0.0)).forward(
        volume.transpose(2, 0, 1)
    )
    return seen


@pytest.mark.parametrize("code", CODE_NAMES)
def test_a_cancelled_export_leaves_nothing_and_the_file_before(code: str, tmp_path: Path) -> None:
    H = matrix() if CODES[code].one_lens else PSFMatrix(np.ones((2, 1, 1, 5, 5), np.float32))
    out = tmp_path / f"H{CODES[code].suffix}"
    steps = sum(1 for _ in iter_export(H, out, code=code))
    whole = out.read_bytes()
    for earlier in (None, b"earlier"):
        for taken in range(1, steps):
            out.unlink(missing_ok=True)
            if earlier is not None:
                out.write_bytes(earlier)
            work = iter_export(H, out, code=code)
            for _ in range(taken):
                next(work)
            work.close()
            left = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
            assert left in ({} if earlier is None else {out.name: earlier}, {out.name: whole}), taken


def volume() -> Array:
    return np.random.default_rng(1).random((9, 9, 2))


def project(H: Array, light: Array) -> Array:
    """LFM_forwardProject.m of oLaF, range 'full': ``H[aa, bb, cc]`` is a pattern, lenses about the middle pixel."""
    half, middle = (N + 1) // 2, (light.shape[0] + 1) // 2
    lenses = middle + N * np.arange(-2, 3)
    total = np.zeros(light.shape[:2])
    for cc in range(light.shape[2]):
        for aa, bb in np.ndindex(N, N):
            rows, columns = (lenses - half + k + 1 - 1 for k in (aa, bb))
            rows, columns = (at[(at >= 0) & (at < light.shape[0])] for at in (rows, columns))
            space = np.zeros(light.shape[:2])
            space[np.ix_(rows, columns)] = light[np.ix_(rows, columns)][..., cc]
            total += conv2_same(space, np.asarray(H[aa, bb, cc]))
    return total


def sparse_cell(group: Any) -> Array:
    """Return a sparse matrix as MATLAB stores it: column by column, with the rows of its values from 0."""
    rows, ends = int(group.attrs["MATLAB_sparse"]), group["jc"][...].tolist()
    found = np.zeros((rows, len(ends) - 1))
    for column, (first, end) in enumerate(itertools.pairwise(ends)):
        for k in range(first, end):
            found[int(group["ir"][k]), column] = group["data"][k]
    return found


def cells(path: Path, name: str) -> Array:
    """Return a cell array as MATLAB sees it."""
    with h5py.File(path) as file:
        assert file[name].attrs["MATLAB_class"] == b"cell"
        stored = file[name][...].T
        found = np.empty(stored.shape, object)
        for at in np.ndindex(stored.shape):
            cell = file[stored[at]]
            if "MATLAB_sparse" in cell.attrs:
                found[at] = sparse_cell(cell)
                continue
            assert cell.attrs["MATLAB_class"] == b"single" and cell.dtype == np.float32
            found[at] = cell[...].T
        return found


def text(path: Path, name: str) -> str:
    with h5py.File(path) as file:
        return bytes(file[name][:, 0].tolist()).decode()


def test_every_code_is_named_by_the_task_too_and_says_how_its_file_is_used() -> None:
    assert tuple(CODES) == CODE_NAMES and all(code.source.startswith("https://") for code in CODES.values())
    notes = export_notes(matrix(), "H.mat", ExportOptions(code="olaf"))
    assert notes == ("call the projections of oLaF with range 'full', because a measured H has no exact symmetry",)
    assert not export_notes(matrix(), "H.mat", ExportOptions(code="prevedel"))


def assert_adjoint(Ht: Array) -> None:
    """Compare the back projection with the cells of a file with lfcal's forward projection."""
    light, image = volume(), np.random.default_rng(2).random((9, 9))
    back = np.stack([project(Ht[..., z : z + 1], image[..., None]) for z in range(2)], -1)
    assert (expected(light) * image).sum() == pytest.approx((light * back).sum())


def test_olaf_projects_with_the_cells_of_its_file(tmp_path: Path) -> None:
    path = export(matrix(), tmp_path / "H.mat", code="olaf", quality="good")
    H, Ht, light = cells(path, "H"), cells(path, "Ht"), volume()
    assert H.shape == Ht.shape == (N, N, 2)
    np.testing.assert_allclose(project(H, light), expected(light), rtol=1e-5)
    assert_adjoint(Ht)
    assert text(path, "quality") == "good"
    with h5py.File(path) as file:
        assert "CAindex" not in file and file["Nnum"][()] == N


@pytest.mark.parametrize("sparse", [False, True])
def test_cells_of_olaf_are_read_back(tmp_path: Path, sparse: bool) -> None:
    """Also without the variables of lfcal, as oLaF itself saves them, and with patterns that are dark."""
    values = np.asarray(matrix()).copy()
    values[0, 1, 2] = 0
    values[:, :, :, 0] = 0
    H = PSFMatrix(values, camera=square_camera(N, 31), anchor=(4, 6), depths=[1.0, 2.0])
    path = export(H, tmp_path / "H.mat", code="olaf", sparse=sparse)
    H_of, Ht_of = cells(path, "H"), cells(path, "Ht")
    lens = lens_centre_of(H)
    assert lens is not None
    written = np.asarray(lens_centred(H, lens))
    for y, x, z in np.ndindex(N, N, 2):
        np.testing.assert_array_equal(H_of[y, x, z], written[z, y, x])
    np.testing.assert_allclose(
        np.array([[[Ht_of[y, x, z] for x in range(N)] for y in range(N)] for z in range(2)]),
        np.asarray(lens_centred(H, lens).T),
    )
    np.testing.assert_array_equal(np.asarray(open_psf(path)), written)
    with h5py.File(path, "r+") as file:
        assert sparse == isinstance(file["#refs#/H_0_0_0"], h5py.Group)
        for name in list(file):
            if name not in ("H", "#refs#"):
                del file[name]
    bare = open_psf(path)
    np.testing.assert_array_equal(np.asarray(bare), written)
    assert lens_centre_of(bare).agrees  # type: ignore[union-attr]
    assert any("oLaF's cell array" in note for note in bare.provenance["notes"])


def point() -> Array:
    light = np.zeros((9, 9, 2))
    light[4, 5, 1] = 100.0
    return light


def assert_point(found: Array) -> None:
    assert np.unravel_index(found.argmax(), found.shape) == (4, 5, 1) and found[4, 5, 1] > 50


OCTAVE = """
1;
function image = forward(H, pattern, light, n)
  image = zeros(size(light)(1:2));
  for z = 1:size(light, 3)
    for y = 1:n
      for x = 1:n
        plane = zeros(size(image));
        plane(y:n:end, x:n:end) = light(y:n:end, x:n:end, z);
        image += conv2(plane, pattern(H, y, x, z), "same");
      end
    end
  end
end
function volume = back(Ht, pattern, image, n, planes)
  volume = zeros([size(image), planes]);
  for z = 1:planes
    for y = 1:n
      for x = 1:n
        plane = zeros(size(image));
        plane(y:n:end, x:n:end) = image(y:n:end, x:n:end);
        volume(:, :, z) += conv2(plane, pattern(Ht, y, x, z), "same");
      end
    end
  end
end
image = load("image.txt");
normal = back(Ht, pattern, ones(size(image)), n, 2);
found = ones(size(normal));
for step = 1:60
  found .*= back(Ht, pattern, image ./ forward(H, pattern, found, n), n, 2) ./ normal;
end
save -6 found.mat found
"""
"""A deconvolution in Octave; a lens is centred on pixel ceil(n / 2) of each period."""

IN_OCTAVE = {
    "olaf": "n = file.Nnum; pattern = @(H, y, x, z) double(H{y, x, z});",
    # Octave has the rows, columns and values of a sparse matrix as a structure
    "olaf, sparse": """
n = file.Nnum; ends = @(p) double(p.jc(:)'); of = @(p) numel(p.jc) - 1;
unpacked = @(p) full(sparse(double(p.ir(:)) + 1, repelem(1:of(p), diff(ends(p))), p.data(:), of(p), of(p)));
pattern = @(H, y, x, z) unpacked(H{y, x, z});""",
    "prevedel": """
file = load("H.mat"); H = file.H; Ht = file.Ht; n = size(H, 3);
pattern = @(H, y, x, z) double(H(:, :, y, x, z));""",
}


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
@pytest.mark.few(1)
@pytest.mark.parametrize("layout", IN_OCTAVE)
def test_octave_finds_a_point_with_the_file_of_a_code(tmp_path: Path, layout: str) -> None:
    code, _, sparse = layout.partition(", ")
    export(matrix(), tmp_path / "H.mat", code=code, sparse=bool(sparse))
    np.savetxt(tmp_path / "image.txt", expected(point()))
    cells = next(part.partition("```")[0] for part in SNIPPET.split("```octave\n")[1:]) if code == "olaf" else ""
    (tmp_path / "loop.m").write_text(cells + IN_OCTAVE[layout] + OCTAVE)
    command = ["octave-cli", "--norc", "--quiet", "loop.m"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert_point(loadmat(tmp_path / "found.mat")["found"])


def test_a_deconvolution_in_the_layout_of_flfm_finds_a_point(tmp_path: Path) -> None:
    """Its forward projection multiplies the Fourier transforms of planes and patterns, which have one size."""
    values = np.random.default_rng(0).random((2, 1, 1, 21, 21), np.float32) ** 8
    path = export(PSFMatrix(values, depths=[1.0, 2.0]), tmp_path / "psf.tif", code="flfm")
    spectra = np.fft.rfft2(np.fft.ifftshift(tifffile.imread(path).astype(float), axes=(1, 2)))
    light = np.zeros((2, 21, 21))
    light[1, 8, 13] = 100.0
    # lfcal's own image of the point
    seen = Projector(PSFMatrix(values, depths=[1.0, 2.0]), (21, 21), anchor=(0.0, 0.0)).forward(light)

    def turned(image: Array, by: Array) -> Array:
        return np.fft.irfft2(np.fft.rfft2(image) * by, (21, 21))

    np.testing.assert_allclose(turned(light, spectra).sum(0)[3:16, 3:18], seen[3:16, 3:18], atol=1e-3)
    image, found = turned(light, spectra).sum(0), np.ones_like(light)
    for _ in range(60):
        ratio = image / np.maximum(turned(found, spectra).sum(0), 1e-9)
        found *= np.maximum(turned(ratio, spectra.conj()) / values.sum((1, 2, 3, 4))[:, None, None], 0)
    assert np.unravel_index(found.argmax(), found.shape) == (1, 8, 13)


def test_prevedels_code_projects_with_its_file(tmp_path: Path) -> None:
    path = export(matrix(), tmp_path / "H.mat", code="prevedel", quality="good")
    found = matlab(path)
    assert found["H"].dtype == np.float32 and text(path, "axisOrder") == "tsyxz" and text(path, "quality") == "good"
    np.testing.assert_allclose(forward_project(found["H"], volume(), found["CAindex"]), expected(volume()), rtol=1e-5)


def made_by_the_manual() -> dict[str, Any]:
    """Return what the manual's conversion for pyolaf makes of the file in the working folder."""
    snippet = next(part.partition("```")[0] for part in SNIPPET.split("```python\n") if "H_pyolaf.npz" in part)
    made: dict[str, Any] = {}
    exec(compile(snippet, "matlab.md", "exec"), made)
    return made


def test_pyolaf_projects_with_the_patterns_that_the_manual_makes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(matrix(), tmp_path / "H_pyolaf.npz", code="pyolaf", quality="good")
    monkeypatch.chdir(tmp_path)
    made = made_by_the_manual()
    H, Ht = (np.empty(made[name].shape, object) for name in ("H", "Ht"))
    for at in np.ndindex(H.shape):
        H[at], Ht[at] = made["H"][at].todense(), made["Ht"][at].todense()
    np.testing.assert_allclose(project(H, volume()), expected(volume()), rtol=1e-5)
    assert_adjoint(Ht)
    with np.load("H_pyolaf.npz") as file:
        assert file["quality"] == "good" and file["depths_um"].tolist() == [1.0, 2.0] and file["H"].dtype == np.float32


def test_pyolaf_itself_projects_with_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = pytest.importorskip("pyolaf.project", reason="pip install pyolaf==0.2.1")
    export(matrix(), tmp_path / "H_pyolaf.npz", code="pyolaf")
    monkeypatch.chdir(tmp_path)
    H, Ht = (made_by_the_manual()[name] for name in ("H", "Ht"))
    steps = N * np.arange(-2, 3)
    centres = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1)
    period, middle = np.array([N, N]), np.array([(N + 1) // 2] * 2)
    resolution = {"Nnum": period, "TexNnum": period, "Nnum_half": middle, "TexNnum_half": middle}
    resolution |= {name: np.ones((N, N), int) for name in ("sensMask", "texMask")} | {"texScaleFactor": np.ones(2)}
    rest = {"px": centres, "vox": centres}, resolution, np.array([9, 9]), "full"

    def forward(light: Array) -> Array:
        # as the manual says, pyolaf's volumes lie a pixel off its images
        shifted = np.roll(light, (1, 1), (0, 1))
        return np.asarray(project.LFM_forwardProject(H, shifted, *rest))

    def back(image: Array) -> Array:
        return np.asarray(project.LFM_backwardProject(Ht, image, *rest))

    light = volume()
    light[:, [0, -1]] = light[[0, -1]] = 0
    np.testing.assert_allclose(forward(light)[1:-1, 1:-1], expected(light)[1:-1, 1:-1], rtol=1e-4)
    image = np.zeros((9, 9))
    image[2:-2, 2:-2] = np.random.default_rng(2).random((5, 5))
    assert (expected(light) * image).sum() == pytest.approx((light * back(image)).sum(), rel=1e-5)


def test_flfm_reads_a_pattern_for_each_plane(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 1, 1, 5, 7), np.float32)
    path = export(PSFMatrix(values, depths=[1.0, 2.0, 3.0]), tmp_path / "psf.tif", code="flfm", quality="good")
    with Image.open(path) as image:  # as its JaxIO.open does
        pages = [np.asarray(page) for page in ImageSequence.Iterator(image)]
    np.testing.assert_array_equal(np.stack(pages), values[:, 0, 0])
    with tifffile.TiffFile(path) as file:
        assert file.imagej_metadata is not None and "quality: good" in file.imagej_metadata["Info"]
    chosen = export(matrix(), tmp_path / "one.tif", code="flfm", position=(1, 2))
    np.testing.assert_array_equal(tifffile.imread(chosen), np.asarray(matrix())[:, 1, 2])


def test_what_a_code_cannot_use_is_refused_in_a_line(tmp_path: Path) -> None:
    for shape, code, words in (
        ((1, 4, 4, 5, 5), "olaf", "a square period of an odd number of pixels, got 4 x 4"),
        ((1, 3, 5, 5, 5), "prevedel", "a square period of an odd number of pixels, got 3 x 5"),
        ((1, 3, 5, 5, 5), "pyolaf", "a square period of an odd number of pixels, got 3 x 5"),
        ((1, 3, 3, 5, 5), "flfm", "one pattern for each plane, got 3 x 3 positions"),
    ):
        H = PSFMatrix(np.ones(shape, np.float32))
        assert CODES[code] not in codes_for(H)
        with pytest.raises(InputError, match=words) as raised:
            export(H, tmp_path / f"H{CODES[code].suffix}", code=code)
        assert "\n" not in str(raised.value) and not list(tmp_path.iterdir())


def test_hexagonal_arrays_other_numbers_and_other_files_are_refused(tmp_path: Path) -> None:
    H, ones = matrix(), np.ones((1, N, N, 5, 5), np.float32)
    assert [code.name for code in codes_for(H)] == ["olaf", "prevedel", "pyolaf"] and not codes_for(H.T)
    hexagonal = PSFMatrix(ones, camera=preset("bench"), depths=[5.0])
    for psf, name, how, words in (
        (hexagonal, "H.mat", {"code": "olaf"}, "lenses on a square grid, got a hexagonal array"),
        (PSFMatrix(ones.astype(np.uint16)), "H.mat", {"code": "olaf"}, "float32 values, got uint16"),
        (H, "H.npz", {}, r"code of an \.npz file"),
        (H, "H.mat", {"code": "pyolaf"}, r"file for pyolaf: expected \.npz, got \.mat"),
    ):
        with pytest.raises(InputError, match=words):
            export(psf, tmp_path / name, **how)  # type: ignore[arg-type]
