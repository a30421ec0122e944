"""SI units and the paper's units: time 1/omega_0, distance v/omega_0, height g/omega_0^2, force the static load.

A real road sees a car every few minutes, a simulated ring one every headway. What a passage does is the same: it sinks
the road by `sink_per_passage` under the static load and the road relaxes by `diffusion_per_passage` until the next one.
The ring thus runs the traffic of a day in quick motion, exact as long as a passage changes the road little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from .errors import SceneError, shown
from .laws import finite

SECONDS_PER_DAY = 86400.0
# the scale of a dimensionless value, as its variable's attribute names it
LENGTH, HEIGHT, TIME, RATE, VELOCITY = "v/omega_0", "g/omega_0^2", "1/omega_0", "omega_0", "v"
SINK_RATE = "g/omega_0"


@dataclass(frozen=True)
class Scales:
    """The reference car and its traffic in SI units.

    speed: m/s. frequency: natural frequency of the mass on its spring, Hz (not rad/s). vehicles_per_day: flux.
    gravity: m/s^2.
    """

    speed: float
    frequency: float
    vehicles_per_day: float
    gravity: float = 9.81

    def __post_init__(self):
        for name in ("speed", "frequency", "vehicles_per_day", "gravity"):
            object.__setattr__(self, name, finite(f"Scales.{name}", getattr(self, name), above=0))

    @property
    def angular_frequency(self) -> float:
        """omega_0 in rad/s."""
        return 2 * np.pi * self.frequency

    @property
    def length(self) -> float:
        """v/omega_0 in m."""
        return self.speed / self.angular_frequency

    @property
    def height(self) -> float:
        """g/omega_0^2 in m: the static compression of the spring."""
        return self.gravity / self.angular_frequency**2

    def softness(self, sink_per_passage: float, headway: float) -> float:
        """alpha, when one passage of the static load sinks the road by `sink_per_passage` (m); headway in v/omega_0."""
        return sink_per_passage / self.height / headway

    def diffusivity(self, diffusion_per_passage: float, headway: float) -> float:
        """Delta, when the road relaxes by D t = `diffusion_per_passage` (m^2) from one passage to the next.

        A road that relaxes by the weather, D (m^2/s), has D * SECONDS_PER_DAY / vehicles_per_day per passage.
        """
        return diffusion_per_passage / self.length**2 / headway


def to_si(ds: xr.Dataset, scales: Scales) -> xr.Dataset:
    """A result in metres, seconds of traffic and passages; forces stay in units of the static load.

    `time` becomes the seconds that the passages so far take at `vehicles_per_day`; the coordinate `passages(time)`
    counts them. Rates and velocities of a wave of the road are by that time, too. Every variable keeps its dimensions,
    attributes of the Dataset stay as they are. SceneError if the Dataset is in SI units already, or no result.
    """
    if not isinstance(scales, Scales):
        raise SceneError(f"to_si: scales = {shown(scales)}: must be Scales(speed, frequency, vehicles_per_day)")
    if not isinstance(ds, xr.Dataset):
        raise SceneError(f"to_si: {shown(ds)} is no Dataset; give the one that simulate returned")
    if ds.attrs.get("unit_system") == "SI":
        raise SceneError("to_si: the Dataset is in SI units already; give the one that simulate returned")
    if "passages_per_time" not in ds.attrs or "time" not in ds.coords or ds["time"].dtype.kind not in "iuf":
        raise SceneError(
            "to_si: attribute 'passages_per_time' or coordinate 'time' is missing; give a result of simulate or compare"
        )
    # passages at a fixed point per unit of time, from the scene that the Dataset carries
    rate = finite("passages_per_time", ds.attrs["passages_per_time"], above=0)
    passages = ds["time"].values * rate
    second = rate * SECONDS_PER_DAY / scales.vehicles_per_day
    units = {
        LENGTH: (scales.length, "m"),
        HEIGHT: (scales.height, "m"),
        TIME: (second, "s"),
        RATE: (1 / second, "s-1"),
        VELOCITY: (scales.length / second, "m s-1"),
        SINK_RATE: (scales.height / second, "m s-1"),
    }
    out = ds.copy()
    for name, values in ds.variables.items():
        if values.attrs.get("scale") in units:
            factor, unit = units[values.attrs["scale"]]
            attributes = {key: value for key, value in values.attrs.items() if key != "scale"} | {"units": unit}
            with np.errstate(all="ignore"):  # what is no number stays none
                out[name] = (values.dims, values.values * factor, attributes)
    out["time"].attrs["long_name"] = "time of traffic"
    out = out.assign_coords(passages=("time", passages, {"units": "1", "long_name": "passages at a fixed point"}))
    out.attrs["unit_system"] = "SI"
    return out
