"""Settings by which a camera changes pixel values: switched off, read back, reported under the names of each driver."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.devices.backends._common import UNREADABLE
from lfcal.devices.backends._pixels import PixelFormat
from lfcal.devices.backends.micromanager import _Camera as MicroManagerCamera
from lfcal.devices.errors import CameraError, DeviceLost
from lfcal.devices.protocols import Setting
from tests.devices.test_pixels import as_array, packed
from tests.devices.test_real_devices import ADDRESS, ARAVIS, GENTL, aravis, fake_camera, plan_for


def stays(settings: Mapping[str, Setting[str | None]]) -> dict[str, str | None]:
    """Return the settings that do not have the value asked for."""
    return {name: found.actual for name, found in settings.items() if found.requested not in (None, found.actual)}


# -- GenTL, with features and buffers of a camera that is not there ---------------------------------------
class Node:
    """A feature with its access mode (4: read and write, 3: read, 2: write, 1: not available)."""

    def __init__(self, value: str, mode: int = 4, stuck: str = "", broken: bool = False) -> None:
        self.value, self._mode, self._stuck, self._broken = value, mode, stuck, broken

    def get_access_mode(self) -> int:
        return self._mode

    def to_string(self) -> str:
        if self._broken:
            raise RuntimeError("register not answered")
        return self.value

    def from_string(self, text: str) -> None:
        if self._mode != 4:
            raise RuntimeError("not writable")
        self.value = self._stuck or text


class NodeMap:
    def __init__(self, nodes: dict[str, Node]) -> None:
        self.nodes = nodes

    def has_node(self, name: str) -> bool:
        return name in self.nodes

    def get_node(self, name: str) -> Node:
        return self.nodes[name]

    def __getattr__(self, name: str) -> Node:
        return self.nodes[name]


class Buffer:
    """A buffer of a producer, which need not say everything."""

    def __init__(self, data: bytes, **said: Any) -> None:
        self.raw_buffer, self.said = data, said
        self.parent = SimpleNamespace(queue_buffer=self.queue)
        self.queued = 0

    def queue(self, _: object) -> None:
        self.queued += 1

    def is_complete(self) -> bool:
        return True

    def __getattr__(self, name: str) -> Any:
        try:
            return self.said[name]
        except KeyError:
            raise RuntimeError(f"{name}: not implemented") from None


def gentl(nodes: dict[str, Node], buffer: Buffer | None = None, **options: str) -> Any:
    from lfcal.devices.backends.gentl import _Camera

    whole = {"PixelFormat": Node("Mono12p"), "Height": Node("3"), "Width": Node("5"), **nodes}
    device = SimpleNamespace(
        remote_device=SimpleNamespace(node_map=NodeMap(whole)),
        num_holding_filled_buffers=0,
        start=lambda: None,
        fetch=lambda timeout, is_raw: buffer,
    )
    info = SimpleNamespace(vendor="Maker", model="M1", serial_number="7")
    return _Camera(SimpleNamespace(device_info_list=[info], create=lambda _: device), 0, options)


@GENTL
def test_gentl_switches_off_what_it_can_and_reads_back() -> None:
    nodes = {
        "ExposureAuto": Node("Continuous"),
        "GainAuto": Node("Once", stuck="Continuous"),  # comes back
        "BlackLevelAuto": Node("Continuous", mode=3),  # read-only
        "BalanceWhiteAuto": Node("Continuous", mode=1),  # of a mono camera
        "Gamma": Node("0.4545"),
        "LUTEnable": Node("1"),
        "DenoiseEnable": Node("0", mode=3),
        "SharpeningEnable": Node("1", broken=True),
        "Gain": Node("6.02"),
    }
    settings = gentl(nodes).fixed_settings()
    assert stays(settings) == {
        "GainAuto": "Continuous",
        "BlackLevelAuto": "Continuous",
        "SharpeningEnable": UNREADABLE,
    }
    assert settings["Gamma"] == Setting("1", "1")
    assert settings["LUTEnable"] == settings["DenoiseEnable"] == Setting("False", "False")
    assert settings["Gain"] == Setting(None, "6.02")
    assert "BalanceWhiteAuto" not in settings


@GENTL
def test_gentl_keeps_and_reports_what_the_user_set() -> None:
    nodes = {"GainAuto": Node("Off"), "ExposureAuto": Node("Continuous")}
    camera = gentl(nodes, set="GainAuto=Continuous")
    assert stays(camera.fixed_settings()) == {"GainAuto": "Continuous"}
    nodes["ExposureAuto"].value = "Continuous"  # comes back later
    assert stays(camera.fixed_settings()) == {"GainAuto": "Continuous", "ExposureAuto": "Continuous"}


@GENTL
def test_gamma_is_left_alone_where_it_has_no_effect_or_another_scale() -> None:
    for nodes, gamma in (
        ({"GammaEnable": Node("1"), "Gamma": Node("2.2")}, "2.2"),  # of no effect once it is switched off
        ({"Gamma": Node("100")}, "100"),  # a straight line, in percent: 1 would not be one
    ):
        settings = gentl(nodes).fixed_settings()
        assert not stays(settings) and settings["Gamma"] == Setting(None, gamma)


SAMPLES = np.array([[0, 4095, 1, 2048, 77], [5, 6, 7, 8, 9], [4094, 16, 256, 255, 3]], np.uint16)
PFNC = {"12p": 0x010C0047, "12Packed": 0x010C0006, "": 0x01100005}


def buffer_of(layout: str, padding: int = 0, start: bytes = b"") -> bytes:
    lines = [bytes(packed(row, layout)) for row in SAMPLES] if padding else [bytes(packed(SAMPLES, layout))]
    return start + b"".join(line + b"\xff" * padding for line in lines)


@GENTL
def test_gentl_unpacks_buffers() -> None:
    for layout, (padding, start, more) in itertools.product(
        ("12p", "12Packed"),
        ((0, b"", {}), (4, b"", {"padding_x": 4}), (0, b"head", {"image_offset": 4, "size_filled": 999})),
    ):
        data = buffer_of(layout, padding, start)
        said = {"pixel_format": PFNC[layout], "width": 5, "height": 3, "data_size": len(data) - len(start), **more}
        buffer = Buffer(data + b"chunk data", **said)
        camera = gentl({"PixelFormat": Node(f"Mono{layout}")}, buffer)
        frame = camera.grab(1.0)
        np.testing.assert_array_equal(frame.data, SAMPLES, err_msg=f"{layout} {more}")
        assert (camera.bit_depth, camera.max_value, frame.data.dtype) == (12, 4095, np.uint16)
        assert buffer.queued  # it goes back to the producer
    # the first part of several, and a buffer without any description
    data = buffer_of("12p")
    part = SimpleNamespace(data_format=PFNC["12p"], data_offset=3, data_size=len(data), x_padding=0, width=5, height=3)
    for buffer in (Buffer(b"abc" + data, parts=(part,)), Buffer(data)):
        np.testing.assert_array_equal(gentl({}, buffer).grab(1.0).data, SAMPLES)


@GENTL
def test_gentl_follows_a_grabber_that_unpacks_and_refuses_one_that_changes_the_depth() -> None:
    plain = SAMPLES.astype("<u2").tobytes()
    unpacked = Buffer(plain, pixel_format=PFNC[""])
    np.testing.assert_array_equal(gentl({}, unpacked).grab(1.0).data, SAMPLES)
    for number, named in ((0x01100007, "Mono16"), (0x01080001, "Mono8"), (0x81100001, "0x81100001")):
        buffer = Buffer(plain, pixel_format=number)
        with pytest.raises(CameraError, match=f"frame: expected Mono12p, got .*{named}; set the device option format"):
            gentl({}, buffer).grab(1.0)
        assert buffer.queued
    with pytest.raises(CameraError, match="expected 23 bytes of Mono12p for 3 x 5 pixels, got 22"):
        gentl({}, Buffer(buffer_of("12p")[:22])).grab(1.0)


# -- Aravis: its own library, and a fake camera with further features --------------------------------------
def entry(name: str, value: int) -> str:
    return f'<EnumEntry Name="{name}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'


FEATURES = f"""
<Enumeration Name="ExposureAuto" NameSpace="Standard">{entry("Off", 0)}{entry("Continuous", 2)}<pValue>Two</pValue>
</Enumeration>
<IntSwissKnife Name="Two"><Formula>2</Formula></IntSwissKnife>
<Float Name="Gamma" NameSpace="Standard"><Value>2.2</Value><Min>0</Min><Max>4</Max></Float>
<Boolean Name="LUTEnable" NameSpace="Standard"><Value>true</Value></Boolean>
"""
"""Automatic exposure that cannot be switched off, gamma and table that can."""


@contextmanager
def camera_with_features(folder: Path) -> Iterator[None]:
    """Run Aravis's camera with its own description and more."""
    from lfcal.devices.backends._aravis_lib import NAMES, library

    lib = library()
    whole = ctypes.CDLL(NAMES[0])
    whole.arv_device_get_genicam_xml.restype = ctypes.c_void_p
    with fake_camera():
        camera, size = lib.camera_new(ADDRESS.encode()), ctypes.c_size_t()
        device = ctypes.c_void_p(lib.camera_get_device(camera))
        text = ctypes.string_at(whole.arv_device_get_genicam_xml(device, ctypes.byref(size)), size.value).decode()
        lib.unref(camera)
    formats = entry("Mono12p", PFNC["12p"]) + entry("Mono12Packed", PFNC["12Packed"])
    text = text.replace('<EnumEntry Name="Mono16"', f'{formats}<EnumEntry Name="Mono16"')
    path = folder / "camera.xml"
    path.write_text(text.replace('<Enumeration Name="GainAuto"', f'{FEATURES}<Enumeration Name="GainAuto"'))
    with fake_camera(description=path):
        yield


@ARAVIS
def test_aravis_switches_off_what_it_can_and_takes_packed_frames(tmp_path: Path) -> None:
    plan = plan_for((2048, 2048), 12)
    with camera_with_features(tmp_path):
        for layout in ("Mono12p", "Mono12Packed"):
            with aravis(plan, format=layout) as rig:
                camera: Any = rig.camera
                settings = camera.fixed_settings()
                assert stays(settings) == {"ExposureAuto": "Continuous"}
                for name, setting in (("GainAuto", ("Off", "Off")), ("Gamma", ("1", "1")), ("GainRaw", (None, "0"))):
                    assert settings[name] == Setting(*setting)
                assert settings["LUTEnable"] == Setting("False", "False")
                assert (camera.bit_depth, camera.max_value) == (12, 4095)
                frame = camera.grab(5.0)
                assert (frame.data.shape, frame.data.dtype, frame.status) == ((512, 512), np.uint16, "complete")
                camera.device._write("GainAuto", "Continuous")  # another program
                assert stays(camera.fixed_settings()) == {"ExposureAuto": "Continuous", "GainAuto": "Continuous"}


class Memory:
    """Functions of libaravis for one buffer in memory."""

    def __init__(self, data: NDArray[np.uint8], shape: tuple[int, int], number: int, padding: int) -> None:
        self._data, self._padding = data, padding
        for name, value in (("height", shape[0]), ("width", shape[1]), ("pixel_format", number)):
            setattr(self, f"buffer_get_image_{name}", lambda _, value=value: value)

    def buffer_get_image_data(self, _: object, size: Any) -> int:
        size._obj.value = len(self._data)
        return int(self._data.ctypes.data)

    def buffer_get_image_padding(self, _: object, x: Any, y: Any) -> None:
        x._obj.value, y._obj.value = self._padding, 0


def aravis_camera(**more: Any) -> Any:
    from lfcal.devices.backends.aravis import _Camera

    camera: Any = object.__new__(_Camera)
    vars(camera).update(name="camera", **more)
    return camera


def test_aravis_unpacks_buffers() -> None:
    for layout, padding in itertools.product(("12p", "12Packed"), (0, 2)):
        camera = aravis_camera(_format=PixelFormat.named(f"Mono{layout}", "camera"))
        data = as_array(buffer_of(layout, padding))
        camera._lib = Memory(data, SAMPLES.shape, PFNC[layout], padding)
        np.testing.assert_array_equal(camera._copy(None), SAMPLES)
        for part, number, words in (
            (data[:20], PFNC[layout], r"camera: expected .* bytes of Mono12.*, got 20"),
            (data, 0x01100007, f"frame: expected Mono{layout}, got 16 bits per pixel; set the device option format"),
        ):
            camera._lib = Memory(part, SAMPLES.shape, number, padding)
            with pytest.raises(CameraError, match=words):
                camera._copy(None)


def test_aravis_does_not_take_a_lost_camera_for_one_without_settings() -> None:
    from lfcal.devices.backends._aravis_lib import AravisError

    def silent(*_: object) -> None:
        raise AravisError("timeout", silent=True)

    camera = aravis_camera(_camera=None, _lib=SimpleNamespace(camera_is_feature_available=silent))
    with pytest.raises(DeviceLost, match=r"camera: no answer \(timeout\)"):
        camera.fixed_settings()


# -- Micro-Manager, whose drivers have names of their own --------------------------------------------------
class Core:
    """What a camera needs of a core; properties with their allowed values, and those that cannot be changed."""

    def __init__(self, properties: dict[str, tuple[str, tuple[str, ...]]], fixed: tuple[str, ...] = ()) -> None:
        self.values = {key: value for key, (value, _) in properties.items()}
        self._fixed = fixed
        answers = {
            "getDevicePropertyNames": lambda _: tuple(self.values),
            "getAllowedPropertyValues": lambda _, key: properties[key][1],
            "hasProperty": lambda _, key: key in self.values,
            "getProperty": lambda _, key: self.values[key],
            "hasPropertyLimits": lambda _, key: key == "Gamma",
            "getPropertyUpperLimit": lambda *_: 4.0,
            "getNumberOfComponents": lambda: 1,
            **dict.fromkeys(("getImageHeight", "getImageWidth", "getImageBitDepth"), lambda: 8),
            **dict.fromkeys(("getDeviceLibrary", "getDeviceName"), lambda _: "Driver"),
            **dict.fromkeys(("clearROI", "reset"), lambda: None),
        }
        vars(self).update(answers)

    def setProperty(self, _: str, key: str, value: str) -> None:
        if key in self._fixed:
            raise RuntimeError("read-only")
        self.values[key] = value


def test_micromanager_finds_the_properties_of_many_drivers() -> None:
    core = Core(
        {
            "Exposure Auto": ("Continuous", ("Continuous", "Off", "Once")),
            "AutoGain": ("1", ("0", "1")),
            "Auto White Balance": ("On", ("On", "Off")),
            "Gamma Enabled": ("1", ("0", "1")),
            "Gamma": ("2.2", ()),
            "Exposure Auto Upper Limit": ("15000", ()),
            "AutoFocus": ("On", ("On", "Off")),
            "Auto Shutter": ("On", ("On", "Off")),
            "Gain": ("3", ()),
            "CCDTemperature": ("-10.3", ()),
        },
        fixed=("Auto White Balance",),
    )
    camera = MicroManagerCamera(core, "Camera")
    settings = camera.fixed_settings()
    assert stays(settings) == {"Auto White Balance": "On"}
    assert core.values["AutoGain"] == core.values["Gamma Enabled"] == "0"
    assert core.values["AutoFocus"] == core.values["Auto Shutter"] == "On"
    assert {name for name, found in settings.items() if found.requested is None} == {"Gamma", "Gain"}
    assert "Exposure Auto Upper Limit" not in settings
    camera.close()
    # gamma is straightened where it can be, and what the user set is kept
    own = Core({"Gamma": ("2.2", ()), "GainAuto": ("On", ("On", "Off"))})
    camera = MicroManagerCamera(own, "Camera", {"GainAuto"})
    assert stays(camera.fixed_settings()) == {"GainAuto": "On"}
    assert camera.fixed_settings()["Gamma"] == Setting("1", "1")
    camera.close()
