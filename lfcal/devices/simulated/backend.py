"""The simulator: a plenoptic camera and a stage without hardware; the default backend."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

from lfcal import __version__
from lfcal.base import InputError, check_choice
from lfcal.camera import ScanPlan, StageAxes
from lfcal.devices.checked import CheckedCamera, CheckedStage
from lfcal.devices.protocols import SystemTime, TimeSource
from lfcal.devices.registry import limits_option, number_option
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._camera import AUTOMATIC, Renderer, SimCamera, SimLight
from lfcal.devices.simulated._optics import FramesRenderer, PatternRenderer, simulated_optics
from lfcal.devices.simulated._stage import SimStage, StageModel, VirtualTime
from lfcal.devices.simulated.faults import DeviceFault, FaultSchedule, parse_faults
from lfcal.frames import FrameSource

__all__ = ["SimBackend", "SimGauge", "inject", "simulated_gauges", "simulated_rig", "with_defaults"]

OPTICS = ("pattern", "auto", "geometric", "wave", "grid", "microscope")
CLOCKS = ("virtual", "real")


def simulated_rig(
    plan: ScanPlan,
    *,
    model: StageModel | None = None,
    faults: Iterable[DeviceFault] = (),
    axes: StageAxes | None = None,
    optics: Renderer | FrameSource | None = None,
    time: TimeSource | None = None,
    automatic: Collection[str] = (),
    seed: int = 0,
) -> Rig:
    """Return a rig with a simulated camera, stage, light and gauges for ``plan``.

    Parameters
    ----------
    plan
        Plan of the scan, with camera, period and exposure times.
    model, faults
        Motion of the stage (None: `StageModel`, with its defaults), and faults of the devices.
    axes
        Actual directions and origin of the stage's axes. None: as planned.
    optics
        A `Renderer`, or a `FrameSource` of frames of the whole sensor, such as `lfcal.simulate.SimulatedCamera`. None:
        a quick pattern without lenslets.
    time
        Clock of the rig. None: a virtual clock that advances without waiting.
    automatic
        Settings that the camera keeps automatic, from ``"ExposureAuto"``, ``"GainAuto"`` and ``"Gamma"``.
    seed
        Seed of the camera's noise.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> with simulated_rig(plan) as rig:
    ...     rig.stage.move(tuple(plan.stage_um([0, 9, 16]).tolist()))
    ...     frame = rig.camera.grab(1.0)
    >>> print(frame.data.shape, frame.data.dtype)
    (320, 320) uint16
    """
    faults = tuple(faults)
    clock = time or VirtualTime()
    # slips by the plan's step, so that a frame is displaced by whole pixels
    stage = SimStage(clock, model, faults, slip_um=min(plan.step_um(0)))
    light = SimLight()
    if optics is None:
        renderer: Renderer = PatternRenderer(plan)
    else:
        renderer = FramesRenderer(plan, optics) if isinstance(optics, FrameSource) else optics
    camera = SimCamera(
        plan.camera,
        axes or plan.stage,
        stage,
        clock,
        light,
        renderer,
        faults=faults,
        automatic=automatic,
        seed=seed,
    )
    return Rig(camera, stage, light, clock, gauges=simulated_gauges(faults), switches=True)


def inject(rig: Rig, fault: DeviceFault) -> None:
    """Add a fault to a simulated rig in use; the next call is affected if ``fault.at`` is 0, the one after it if 1.

    Raises
    ------
    InputError
        If the device of the fault is not simulated.
    """
    for device in (CheckedCamera.of(rig.camera).device, CheckedStage.of(rig.stage).device, *rig.gauges):
        if isinstance(device, SimCamera | SimStage | SimGauge) and fault.kind in device.faults.kinds:
            device.faults.inject(fault)
            return
    raise InputError.expected("device for a simulated fault", "the simulator", rig.camera.name, "connect the simulator")


class SimBackend:
    """Backend for the simulator."""

    name = "sim"
    title = "simulated camera and stage"
    has_stage = True
    options: Mapping[str, str] = {
        "optics": "auto (default), geometric, wave, grid (finest, for fits), microscope: the plan's camera as lfcal "
        "simulate computes it; or pattern: a quick blur without lenslets, the default with a target",
        "effects": "auto: those that the camera needs; or a JSON file of effects on the optics, as for lfcal simulate "
        "--effect; by default auto, but none if the option optics is given",
        "time": "virtual (waits take no time) or real",
        "velocity": "speed of the stage (µm/s)",
        "backlash": "backlash of each axis (µm)",
        "drift": "creep of each axis after arrival (µm/s)",
        "limits": "travel of the stage, x0:x1,y0:y1,z0:z1 (µm)",
        "axes": "actual stage axes for image right, down and away, such as -x,+y,+z",
        "faults": "faults to inject: kind@call[*times] separated by ';', such as 'times out@5*2;stale@9'",
        "automatic": "settings of the camera that cannot be switched off: any of ExposureAuto, GainAuto, Gamma",
        "seed": "random seed of the camera's noise",
        "target": "JSON file of a target, or of a target's plan, in front of the camera instead of a point",
        "brightness": "relative spread of the brightness of the target's holes, such as 0.1",
    }

    def probe(self) -> str:
        """Return the version of lfcal; the simulator needs no driver library."""
        return __version__

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return a simulated rig for ``plan`` with ``options`` (texts by name); raise `InputError` for invalid ones."""
        options = with_defaults(options)
        clock = options.get("time", "virtual")
        check_choice("option time", clock, CLOCKS)
        level = options["optics"]
        check_choice("option optics", level, OPTICS)
        return simulated_rig(
            plan,
            model=_stage_model(plan, options),
            faults=parse_faults(options.get("faults", "")),
            axes=_axes(plan, options.get("axes")),
            optics=_target(plan, level, options) or _optics(plan, level, options.get("effects", "")),
            automatic=_automatic(options.get("automatic", "")),
            seed=int(number_option(options, "seed", 0, low=0)),
            time=SystemTime() if clock == "real" else VirtualTime(),
        )


def with_defaults(options: Mapping[str, str]) -> dict[str, str]:
    """Return a copy of ``options``; without ``optics``, the simulator's defaults for optics and effects are added.

    The plan's camera is simulated with the effects that it needs. Ideal optics would focus a point into single pixels,
    which cannot be distinguished from hot pixels. A target has the quick pattern at every hole, because simulating all
    holes takes seconds per frame.
    """
    if "optics" in options:
        return dict(options)
    return {"optics": "pattern", **options} if "target" in options else {"optics": "auto", "effects": "auto", **options}


def _target(plan: ScanPlan, level: str, options: Mapping[str, str]) -> Renderer | None:
    """Return the optics of the target in ``options``; None if there is none."""
    if "target" not in options:
        if "brightness" in options:
            raise InputError.expected("option brightness", "a target with holes", "no target", "give target=FILE")
        return None
    # imported here, so that a single point does not load the simulator
    from lfcal.devices.simulated._targets import simulated_target

    spread = number_option(options, "brightness", 0.0, low=0.0, high=1.0)
    seed = int(number_option(options, "seed", 0, low=0))
    return simulated_target(plan, options["target"], level, options.get("effects", ""), spread=spread, seed=seed)


def _optics(plan: ScanPlan, level: str, effects: str) -> Renderer | None:
    if level != "pattern":
        return simulated_optics(plan, level, effects)
    if effects:
        raise InputError.expected("option effects", "a level of the simulator", "optics pattern", "give optics=auto")
    return None


def _automatic(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        check_choice("option automatic", name, tuple(AUTOMATIC))
    return names


def _stage_model(plan: ScanPlan, options: Mapping[str, str]) -> StageModel:
    model = StageModel()
    backlash = number_option(options, "backlash", model.backlash_um[0], low=0)
    drift = number_option(options, "drift", 0.0)
    return StageModel(
        velocity_um_s=number_option(options, "velocity", model.velocity_um_s, low=1e-3),
        backlash_um=(backlash,) * 3,
        drift_um_s=(drift,) * 3,
        limits=limits_option(options) or _around(plan),
    )


def _around(plan: ScanPlan) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """Return the travel of the stage: the plan's positions with a wide margin."""
    # a thousand positions show the extent; a large plan has millions
    places = plan.stage_um(plan.order_indices()[:: max(1, plan.n_positions // 1000)])
    (x0, y0, z0), (x1, y1, z1) = (places.min(axis=0) - 5e5).tolist(), (places.max(axis=0) + 5e5).tolist()
    return (x0, x1), (y0, y1), (z0, z1)


def _axes(plan: ScanPlan, text: str | None) -> StageAxes | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 3:
        raise InputError.expected(
            "option axes",
            "three stage axes, for image right, down and away",
            repr(text),
            "write them like +x,+y,+z",
        )
    return replace(plan.stage, right=names[0], down=names[1], away=names[2])


class SimGauge:
    """Gauge with a constant reading, and with another one during a fault.

    Parameters
    ----------
    name, unit
        Name of the quantity, and unit of the readings.
    values
        The constant reading, and the reading during the fault.
    fault
        Kind of the fault, one of `lfcal.devices.simulated.faults.GAUGE_FAULTS`.
    faults
        Faults to inject; faults of other kinds are ignored.
    """

    def __init__(
        self, name: str, unit: str, values: tuple[float, float], fault: str, faults: Iterable[DeviceFault]
    ) -> None:
        self.name, self.unit = name, unit
        self._usual, self._off = values
        self._fault = fault
        self.faults = FaultSchedule(faults, (fault,))

    def read(self) -> float:
        """Return the current reading."""
        return self._off if self._fault in self.faults.next_call() else self._usual


def simulated_gauges(faults: Iterable[DeviceFault] = ()) -> tuple[SimGauge, SimGauge]:
    """Return a thermometer (21 °C) and a photodiode (100 %).

    A fault "too warm" changes the reading to 27 °C, and "lamp low" to 60 %.
    """
    faults = tuple(faults)
    return (
        SimGauge("temperature", "°C", (21.0, 27.0), "too warm", faults),
        SimGauge("lamp", "%", (100.0, 60.0), "lamp low", faults),
    )
