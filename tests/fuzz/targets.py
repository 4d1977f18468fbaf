"""Which command reads which kind of file, and what it may write."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["TARGETS", "Target"]

FRAMES = ("--plan", "plan.json", "--keep-pedestal", "-o", "out.h5")
VIEWS = ("views", "white.tif", "--white", "white.png", "--slopes", "0", "-o", "out")


@dataclass(frozen=True, slots=True)
class Target:
    """A file to spoil and the command that is given it.

    Attributes
    ----------
    kind
        Kind of file, as `lfcal` documents them.
    file
        The file, below the folder of good files.
    family
        Which mutators fit it.
    arguments
        The command line.
    output
        The one file or folder it writes; empty: nothing.
    whole
        Folder that the command changes itself, so that it is copied anew for every input; empty: none.
    """

    kind: str
    file: str
    family: str
    arguments: tuple[str, ...]
    output: str = ""
    whole: str = ""

    @property
    def name(self) -> str:
        """The kind and the command, one word."""
        words = [a.strip("-").replace(".", "") for a in self.arguments if not a.startswith("/")]
        return "-".join([self.kind, words[0], *(w for w in words if w.startswith("out"))]).replace(" ", "_")


def _matrix(kind: str, file: str, family: str = "h5") -> list[Target]:
    commands = {
        "out.npy": ("export", file, "-o", "out.npy"),
        "out.mat": ("export", file, "-o", "out.mat"),
        "out.tif": ("export", file, "-o", "out.tif", "--position", "0,0"),
        "out.h5": ("transpose", file, "-o", "out.h5"),
        "volume.npy": ("reconstruct", file, "light.tif", "-o", "volume.npy", "-n", "2"),
        "": ("inspect", file, "--seconds", "0.01"),
    }
    return [Target(kind, file, family, arguments, output) for output, arguments in commands.items()]


def _stack(kind: str, file: str, family: str) -> Target:
    return Target(kind, file, family, ("assemble", file, "--order", "raster", *FRAMES), "out.h5")


def _image(kind: str, file: str, family: str) -> list[Target]:
    dark = ("assemble", "frames", "--dark", file, "--plan", "plan.json", "-o", "out.h5")
    light = ("reconstruct", "H.h5", file, "-o", "volume.npy", "-n", "1", "--anchor", "8,9")
    return [
        Target(kind, file, family, dark, "out.h5"),
        Target(kind, file, family, light, "volume.npy"),
        Target(kind, file.replace("dark", "white"), family, ("white", file.replace("dark", "white"), "--no-types")),
    ]


def _session(kind: str, folder: str, file: str, family: str) -> list[Target]:
    return [
        Target(kind, f"{folder}/{file}", family, ("assemble", folder, "-o", "out.h5"), "out.h5"),
        Target(kind, f"{folder}/{file}", family, ("inspect", "H.h5", "--session", folder, "--seconds", "0.01")),
    ]


def _described(kind: str, file: str, family: str, *options: str) -> list[Target]:
    return [Target(kind, file, family, ("camera", "import", file, *options, "-o", "out.json"), "out.json")]


def _acquire(kind: str, file: str, family: str, *options: str, folder: str = "open") -> Target:
    # the sessions were recorded with the quick pattern
    words = ("acquire", "record.json", "--out", folder, "--option", "optics=pattern", *options)
    return Target(kind, file, family, words, folder, folder)


TARGETS: tuple[Target, ...] = (
    *_matrix("H.h5 gzip", "H.h5"),
    *_matrix("H.h5 zstd", "Hz.h5"),
    *_matrix("H.h5 version 1", "H1.h5"),
    Target("H.h5 regions", "Hr.h5", "h5", ("export", "Hr.h5", "-o", "out.npy", "--region", "edge"), "out.npy"),
    *_matrix("HT.h5", "HT.h5"),
    *_matrix("mat", "H.mat"),
    *_matrix("npy H", "H.npy", "npy"),
    Target("H.h5 reference", "Hz.h5", "h5", ("inspect", "H.h5", "--reference", "Hz.h5", "--seconds", "0.01")),
    _stack("npy stack", "stack.npy", "npy"),
    _stack("h5 stack", "stack.h5", "h5"),
    *(_stack(f"tiff {name}", f"{name}.tif", "tiff") for name in ("plain", "lzw", "deflate", "big", "ome", "imagej")),
    Target("png frame", "frames/z1_y1_x2.png", "png", ("assemble", "frames", *FRAMES), "out.h5"),
    *_image("png", "dark.png", "png"),
    *_image("png 8 bit", "dark8.png", "png")[:1],
    *_image("pgm", "dark.pgm", "pgm"),
    *_image("tiff", "dark.tif", "tiff"),
    *_image("npy frame", "dark.npy", "npy"),
    *_image("npy float frame", "fdark.npy", "npy")[:2],
    *_image("tiff float", "fdark.tif", "tiff")[:2],
    *_image("raw", "dark.dng", "tiff"),
    Target("white image", "white.png", "png", VIEWS, "out"),
    Target("light field", "white.tif", "tiff", VIEWS, "out"),
    Target("manifest csv", "frames/manifest.csv", "csv", ("assemble", "frames/manifest.csv", *FRAMES), "out.h5"),
    Target("manifest json", "frames/list.json", "json", ("assemble", "frames/list.json", *FRAMES), "out.h5"),
    Target("plan", "plan.json", "json", ("assemble", "frames", *FRAMES), "out.h5"),
    Target("plan", "plan.json", "json", ("simulate", "plan.json", "--plan-only")),
    Target("plan", "record.json", "json", ("acquire", "record.json", "--out", "new", "--dry-run")),
    Target(
        "camera", "camera.json", "json", ("plan", "camera.json", "--virtual-depths", "3", "-o", "out.json"), "out.json"
    ),
    Target("camera", "camera.json", "json", ("simulate", "camera.json", "--virtual-depths", "3", "--plan-only")),
    Target("camera", "camera.json", "json", ("white", "white.png", "--no-types", "--camera", "camera.json")),
    Target("xml", "camera.xml", "xml", ("plan", "camera.xml", "--virtual-depths", "3", "-o", "out.json"), "out.json"),
    *_session("session.json", "packed", "session.json", "json"),
    *_session("recording packed", "packed", "recording.h5", "h5"),
    *_session("recording in place", "raw", "recording.h5", "h5")[:1],
    *_session("checks", "packed", "checks.h5", "h5"),
    *_session("darks", "packed", "darks.h5", "h5")[:1],
    _acquire("session.json resumed", "open/session.json", "json", "--resume"),
    _acquire("recording resumed", "open/recording.h5", "h5", "--resume"),
    _acquire("darks resumed", "open/darks.h5", "h5", "--resume"),
    _acquire("checks resumed", "open/checks.h5", "h5", "--resume"),
    _acquire("redo", "redo.json", "json", "--redo", "redo.json", folder="raw"),
    *_matrix("lfc", "c.lfc")[:1],
    *_matrix("lfc", "c.lfc")[3:5],
    *_described("yaml", "olaf.yaml", "yaml"),
    *_described("Micro-Manager cfg", "mm.cfg", "csv", "--resolution", "Res10x"),
    *_described("napari-LF metadata", "napari.json", "json"),
    *_described("Micro-Manager metadata", "metadata.txt", "json", "--set", "optics.magnification=20"),
    Target("npz", "stack.npz", "bytes", ("assemble", "stack.npz", "--order", "raster", *FRAMES), "out.h5"),
    Target("journal", "H.h5.parts/run.jsonl", "lines", ("status", "H.h5.parts")),
    Target("record", "unit.record", "pickle", ("record", "unit.record")),
    Target("project", "work.lfcal", "json", ("project", "work.lfcal")),
)
