"""The simulated lab: a thermometer and a photodiode at the lamp."""

from __future__ import annotations

from collections.abc import Iterable

from lfcal.devices.simulated.faults import DeviceFault, FaultBook

__all__ = ["SimGauge", "simulated_gauges"]


class SimGauge:
    """A gauge with one reading, and another while its fault lasts."""

    def __init__(
        self, name: str, unit: str, values: tuple[float, float], fault: str, faults: Iterable[DeviceFault]
    ) -> None:
        self.name, self.unit = name, unit
        self._usual, self._off = values
        self._fault = fault
        self.faults = FaultBook(faults, (fault,))

    def read(self) -> float:
        """Return the reading."""
        return self._off if self._fault in self.faults.next_call() else self._usual


def simulated_gauges(faults: Iterable[DeviceFault] = ()) -> tuple[SimGauge, SimGauge]:
    """Return thermometer (21 °C, 27 when too warm) and photodiode (100 %, 60 when the lamp is low)."""
    faults = tuple(faults)
    return (
        SimGauge("temperature", "°C", (21.0, 27.0), "too warm", faults),
        SimGauge("lamp", "%", (100.0, 60.0), "lamp low", faults),
    )
