"""Measure depth from one light-field frame."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import FileFormatError, InputError, Work, note
from lfcal.records import opt, read_range, record, required, show_pair
from lfcal.tasks._scan_frames import origin_field
from lfcal.tasks.cameras import is_camera_file, load_camera, preset_names
from lfcal.tasks.matrices import open_matrix
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.lattice import DepthMap, FrameLattice, LatticeFit, TypeOf
    from lfcal.multiplex import ColourReading
    from lfcal.psf import PSFMatrix

__all__ = ["DEPTH", "Depth", "DepthForecast", "MeasuredDepth"]

BYTES_PER_PIXEL = 70
"""Memory of a depth map per pixel of its frame (bytes)."""


@dataclass(frozen=True, kw_only=True)
class MeasuredDepth(TaskResult):
    """A measured depth map, ``found``.

    ``lattice`` states the source of the lattice, and ``scale`` that of the depths in µm; ``scale`` is empty if the map
    contains only slopes.

    ``out`` and ``cloud`` are the files of the map and the point cloud, None before `written` or without a cloud.
    ``points`` is the number of points in the cloud, and ``seconds`` the duration (s).
    """

    found: DepthMap
    lattice: str
    scale: str
    seconds: float
    out: Path | None = None
    cloud: Path | None = None
    points: int | None = None

    def written(self, out: Path, cloud: Path | None) -> MeasuredDepth:
        """Write the map and, if ``cloud`` is not None, the point cloud; return the result with its files."""
        from lfcal.lattice import save_depth, save_points

        start = time.perf_counter()
        save_depth(out, self.found)
        points = None if cloud is None else save_points(cloud, self.found)
        seconds = self.seconds + time.perf_counter() - start
        return replace(self, out=out, cloud=cloud, points=points, seconds=seconds)

    def _values(self) -> dict[str, Any]:
        import numpy as np

        known = self.found.known
        values = self.found.slope if self.found.z_um is None else self.found.z_um
        near = values[known & np.isfinite(values)]
        return {
            "out": self.out,
            "cloud": self.cloud,
            "points": self.points,
            "method": self.found.method,
            "lattice": self.lattice,
            "scale": self.scale,
            "shape": known.shape,
            "known": float(known.mean()),
            "unit": "slope" if self.found.z_um is None else "um",
            "depths": [] if not near.size else [float(v) for v in np.quantile(near, (0.02, 0.5, 0.98))],
            "seconds": self.seconds,
        }


@record
class Depth(Task):
    """Measure a depth and confidence map from one light-field frame of any plenoptic camera.

    The depth is known only where the image has texture; elsewhere, it is NaN. With a camera or H, depths are in µm;
    otherwise, the map contains dimensionless slopes.

    Examples
    --------
    >>> from lfcal.tasks import Depth
    >>> (made,) = Depth(frame="session/white/white_0.png", camera="session/camera.json", out="made.tif").run()
    >>> print(made.found.method, f"{made.found.known.mean():.0%} known: a white image has no texture")
    micro-images 0% known: a white image has no texture
    """

    name: ClassVar[str] = "depth"

    frame: Path = required("Light-field frame: TIFF, PNG, NPY or camera RAW.", argument=True, file="in")
    out: Path = required(
        "Depth map to write (.tif): depth, standard error, confidence, light and disparity as float pages.",
        label="Depth map",
        short="-o",
        file="out",
    )
    cloud: Path | None = opt(
        None, "Point cloud to write (.ply), with the brightness of each point.", label="Point cloud", file="out"
    )
    camera: str = opt(
        "",
        "Preset or camera file, for the lattice, the lens types, and depths in µm.",
        file="in",
        is_path=is_camera_file,
        examples=preset_names,
        empty="the camera of H, if H is given",
    )
    lattice: Path | None = opt(
        None, "Measured lattice (lattice.json of lfcal white).", file="in", empty="from the white image or the camera"
    )
    white: Path | None = opt(
        None, "White image of the same camera, or a folder of them to average.", label="White image", file="in"
    )
    dark: Path | None = opt(
        None,
        "Dark frame, or a folder of them to average. It is subtracted from the frame and the white image.",
        label="Dark frame",
        file="in",
    )
    psf: Path | None = opt(
        None,
        "H of the same camera. The known depths of its planes correct the depth scale.",
        label="H",
        file="in",
        empty="none",
    )
    method: str = opt(
        "auto",
        "Matching method. micro-images: match neighbouring micro-images, for lenslets focused on the scene. "
        "views: compare views, for lenslets focused at infinity. auto: decide by the focus of the lenslets; "
        "without a camera, choose the method that explains more of the frame.",
        choices=("auto", "micro-images", "views"),
        more=True,
    )
    slopes: tuple[float, float] | None = opt(
        None,
        "Range of slopes (approximately virtual depths) to search: MIN,MAX.",
        read=read_range,
        show=show_pair,
        empty="the whole range of the lenslets",
        more=True,
    )
    mask: Path | None = opt(
        None,
        "Pixels to leave out: an image that is not 0 at these pixels, or a list with one ROW,COLUMN per line. "
        "Pixels that are NaN are always left out.",
        label="Mask of pixels",
        file="in",
        empty="none",
        more=True,
    )
    channel: str = opt("", "Colour to use.", choices=("", "R", "G", "B"), empty="the mean of all colours", more=True)
    cfa: str = opt(
        "",
        "Colour filters of a mosaic in row-major order, such as GRBG.",
        label="Colour filters",
        empty="as the file states",
        more=True,
    )
    origin: str = origin_field("the whole sensor")

    def __post_init__(self) -> None:
        """Check every field."""
        super().__post_init__()
        for what, path, suffixes in (("out", self.out, (".tif", ".tiff")), ("cloud", self.cloud, (".ply",))):
            if path is not None and path.suffix.lower() not in suffixes:
                raise InputError.expected(
                    what, f"a {suffixes[0]} file", path.name, f"end the name of the file with {suffixes[0]}"
                )
        if not (self.camera or self.lattice or self.white or self.psf):
            raise InputError.expected(
                "lattice of the micro-images",
                "a camera, a measured lattice, a white image or H",
                "none",
                "give one of them",
            )

    def work(self, run: RunSettings | None = None) -> Work[tuple[MeasuredDepth, ...]]:
        """Read the frame, measure its depths, and write them."""
        measured = yield from self.iter_measured(workers=run.workers if run else None)
        return (measured.written(self.out, self.cloud),)

    def iter_measured(self, camera: Camera | None = None, workers: int | None = None) -> Work[MeasuredDepth]:
        """Read the frame, and measure its depths without writing them; ``camera`` replaces that of the settings."""
        start = time.perf_counter()
        camera = self._known(camera)
        scene = self._scene(camera)
        measured: Sequence[tuple[float, float]] = ()
        if self.psf is not None:
            with open_matrix(self.psf) as matrix:
                measured = yield from _measured(matrix, camera, workers)
        found = yield from scene.iter_map(self.method, self.slopes, workers)
        found, scale = self._calibrated(found, camera, measured)
        return MeasuredDepth(found=found, lattice=scene.source, scale=scale, seconds=time.perf_counter() - start)

    def forecast(self, camera: Camera | None = None) -> DepthForecast:
        """Return the predicted time and memory. The frame is read, to find problems with it in advance.

        ``camera`` replaces that of the settings.
        """
        scene = self._scene(self._known(camera))
        return DepthForecast(scene.seconds(self.method, self.slopes), BYTES_PER_PIXEL * scene.light.size)

    def _known(self, camera: Camera | None) -> Camera | None:
        """Return ``camera``; if it is None, the camera of the file, or else that of H."""
        if camera is not None or self.camera:
            return camera or load_camera(self.camera, light=False)
        if self.psf is None:
            return None
        with open_matrix(self.psf) as matrix:
            if matrix.camera is None:
                raise InputError.expected(
                    "camera for the depths", "an H with its camera", "an H without one", "give the camera as well"
                )
            return matrix.camera

    def _calibrated(
        self, found: DepthMap, camera: Camera | None, measured: Sequence[tuple[float, float]]
    ) -> tuple[DepthMap, str]:
        """Return the map with depths in µm if there is a camera, and the source of the scale."""
        from lfcal.frames import parse_origin
        from lfcal.lattice import metric_depth

        if camera is None:
            return found, ""
        found = metric_depth(found, camera, origin=parse_origin(self.origin) or (0, 0), measured=measured)
        if not measured:
            return found, f"camera {camera.name}"
        return found, f"camera {camera.name}, corrected by {len(measured)} planes of H"

    def _scene(self, camera: Camera | None) -> _Scene:
        """Read the frames, and find the lattice."""
        from lfcal.frames import parse_origin
        from lfcal.frames.corrections import frame_map
        from lfcal.lattice import cropped, first_pixel, fit_lattice, lattice_of, load_lattice
        from lfcal.multiplex import ColourReading

        few = camera is not None and not camera.has_lattice
        if few and (self.lattice is not None or self.method == "micro-images"):
            name = "lattice" if self.lattice is not None else "method"
            wanted, found = "none for a Fourier light-field microscope", getattr(self, name)
            raise InputError.expected(name, wanted, found, f"leave --{name} out")
        place = parse_origin(self.origin)
        reading = ColourReading(self.channel, self.cfa, self.dark, place)
        light = _grey(self.frame, reading)
        lost = None
        if self.mask is not None:
            lost = frame_map(self.mask, "mask", (light.shape[0], light.shape[1]), place or (0, 0))
        if few:
            assert camera is not None
            shape = (light.shape[0], light.shape[1])
            first = first_pixel(camera.sensor.shape, shape, place)
            white = None if self.white is None else _part(_grey(self.white, reading), shape, place)
            return _Scene(light, white, lost, first, f"camera {camera.name}", None, camera)
        if self.white is None and self.lattice is None:
            assert camera is not None  # one of the three is given
            types: TypeOf | None = camera.lattice.type_of if len(camera.lattice.types) == 3 else None
            return _Scene(
                light, None, lost, lattice_of(camera, light.shape, place), f"camera {camera.name}", types, camera
            )
        white = None if self.white is None else _grey(self.white, reading)
        if self.lattice is not None:
            fit, source = load_lattice(self.lattice), self.lattice.name
        else:
            assert white is not None and self.white is not None
            fit, source = fit_lattice(white, kind=camera.lattice.kind if camera else None), self.white.name
        types = None if white is None else _types(white, fit, camera)
        white = None if white is None else _part(white, (light.shape[0], light.shape[1]), place)
        return _Scene(light, white, lost, cropped(fit, light.shape, place), source, types, camera)


@dataclass(frozen=True)
class DepthForecast:
    """Predicted CPU time (s) and memory (bytes) for computing a depth map."""

    seconds: float
    memory: int


@dataclass(frozen=True)
class _Scene:
    """Frame and white image without their dark level, masked pixels, lattice and its source, lens types, and camera.

    For a Fourier light-field microscope, which has no lattice, `lattice` is the sensor position of the first pixel.
    """

    light: NDArray[np.float32]
    white: NDArray[np.float32] | None
    mask: NDArray[np.bool_] | None
    lattice: FrameLattice | tuple[int, int]
    source: str
    type_of: TypeOf | None
    camera: Camera | None

    def iter_map(self, method: str, slopes: tuple[float, float] | None, workers: int | None) -> Work[DepthMap]:
        """Return the depth map."""
        from lfcal.lattice import iter_depth_map, iter_elemental_depth

        if not isinstance(self.lattice, tuple):
            return (yield from iter_depth_map(**self._given(), method=method, slopes=slopes, workers=workers))
        assert self.camera is not None
        shown: dict[str, Any] = {"origin": self.lattice, "white": self.white, "mask": self.mask}
        return (yield from iter_elemental_depth(self.light, self.camera, **shown, slopes=slopes, workers=workers))

    def seconds(self, method: str, slopes: tuple[float, float] | None) -> float:
        """Return the predicted processor time of the map (s)."""
        from lfcal.lattice import depth_seconds, elemental_seconds

        if not isinstance(self.lattice, tuple):
            return depth_seconds(**self._given(), method=method, slopes=slopes)
        assert self.camera is not None
        return elemental_seconds(self.light, self.camera, origin=self.lattice, slopes=slopes)

    def _given(self) -> dict[str, Any]:
        """Return arguments for `lfcal.lattice.depth_map`."""
        frame = {"frame": self.light, "lattice": self.lattice, "white": self.white, "mask": self.mask}
        return {**frame, "camera": self.camera, "type_of": self.type_of}


def _part(white: NDArray[np.float32], shape: tuple[int, int], place: tuple[int, int] | None) -> NDArray[np.float32]:
    """Return the part of a white image of the whole sensor that a frame of ``shape`` from ``place`` shows."""
    if place is None:
        return white
    return white[place[0] : place[0] + shape[0], place[1] : place[1] + shape[1]]


def _grey(path: Path, reading: ColourReading) -> NDArray[np.float32]:
    """Return a frame minus its dark frame, averaged over its colours."""
    from lfcal.multiplex import mean_plane, read_planes

    try:
        return mean_plane(read_planes(path, reading))
    except FileFormatError as error:
        if "--channel each" not in str(error):
            raise
        return mean_plane(read_planes(path, replace(reading, channel="each")))


def _types(white: NDArray[np.float32], fit: LatticeFit, camera: Camera | None) -> TypeOf | None:
    """Return the lens types in a white image of a camera with three lens types; None for any other camera."""
    from lfcal.lattice import classify_lens_types, expected_blur

    if camera is None or len(camera.lattice.types) != 3:
        return None
    return classify_lens_types(white, fit, expected_blur(camera)).type_of


def _measured(matrix: PSFMatrix, camera: Camera | None, workers: int | None) -> Work[tuple[tuple[float, float], ...]]:
    """Return depth (µm) and slope of each plane of H whose virtual depth can be measured in its patterns."""
    from lfcal.judge import iter_inspect
    from lfcal.lattice import slope_of_virtual_depth

    if camera is not None and not camera.has_lattice:
        return (yield from _measured_points(matrix, camera, workers))
    report = yield from iter_inspect(matrix.T if matrix.is_transposed else matrix, workers=workers)
    pairs = zip(matrix.depths, report.virtual_depths, strict=True)
    # the patterns were judged by the camera of H, if it has one
    known = matrix.camera or camera
    assert known is not None  # the task has looked for it
    found = tuple((float(z), slope_of_virtual_depth(known, float(v))) for z, v in pairs if math.isfinite(v))
    if not found:
        note(
            f"{Path(matrix.path).name}: the virtual depths cannot be measured in the patterns; the depths follow from "
            "the camera alone"
        )
    return found


def _measured_points(matrix: PSFMatrix, camera: Camera, workers: int | None) -> Work[tuple[tuple[float, float], ...]]:
    """Return depth (µm) and slope of the planes of the H of a Fourier light-field microscope.

    The slope is measured in the pattern of position (0, 0); planes without a measurable slope are left out.
    """
    import numpy as np

    from lfcal.base import centre
    from lfcal.lattice import iter_elemental_depth

    # the pixel of a pattern in which its chief ray meets the sensor
    anchor, shape = np.array(matrix.anchor), matrix.shape[-2:]
    source = np.array([centre(n) for n in shape]) + anchor - np.floor(anchor + 0.5)
    axis = np.array(camera.sensor.centre_px) + np.array(camera.lattice.offset_um)[::-1] / camera.sensor.pixel_um
    first = axis - source
    found = []
    for z, depth in enumerate(matrix.depths):
        pattern = np.asarray((matrix.T if matrix.is_transposed else matrix)[z, 0, 0], np.float32)
        at = yield from iter_elemental_depth(pattern, camera, origin=(first[0], first[1]), workers=workers)
        bright = at.known & (at.image >= 0.5 * at.image.max())
        if bright.any():
            found.append((float(depth), float(np.average(at.slope[bright], weights=at.image[bright]))))
    if not found:
        note(
            f"{Path(matrix.path).name}: the patterns of a point show no disparity; the depths follow from the camera "
            "alone"
        )
    return tuple(found)


DEPTH = TaskSet(
    "depth", (Depth,), lambda given: Depth, "lfcal depth frame.tif --camera camera.json -o depth.tif --cloud points.ply"
)
