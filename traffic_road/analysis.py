"""From a run's Dataset to what theory speaks of: the amplitude, growth rate and velocity of a wave, fields from cars."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .errors import SceneError, shown
from .laws import finite
from .profiles import whole_waves
from .store import variable

HUGE = 1e100  # beyond any road: squares of it do not overflow


def mode(ds: xr.Dataset, wavenumber: float, *, velocity: float = 0.0) -> xr.Dataset:
    """amplitude (time) and phase (time, unwrapped, rad) of the wave amplitude * cos(wavenumber x + phase) of the road.

    The wavenumber must fit the ring (SceneError). Unwrapping is sure while the wave moves less than half a wavelength
    from sample to sample, relative to a point of the given `velocity`: a guess helps where samples are far apart.
    """
    _refuse_without(ds, road_height=("time", "x"))
    wavenumber = finite("wavenumber", wavenumber, above=0)
    velocity = finite("velocity", velocity)
    length = _ring(ds)
    whole_waves("wavenumber", wavenumber, length)
    projection = np.exp(-1j * wavenumber * ds.x.values) * (2 / ds.x.size)
    # the mean is taken off first: a road that has sunk far leaves fewer digits for the wave
    height = ds.road_height.values - ds.road_height.values.mean(axis=-1, keepdims=True)
    coefficient = height @ projection
    turned = -wavenumber * velocity * ds.time.values  # phase of a wave of that velocity
    turn = np.exp(-1j * turned)
    return xr.Dataset(
        {
            "amplitude": variable("amplitude", "time", np.abs(coefficient)),
            "phase": variable("phase", "time", np.unwrap(np.angle(coefficient * turn)) + turned),
        },
        {"time": ds.time},
        {"wavenumber": wavenumber},
    )


def _refuse_without(ds, **variables) -> None:
    """SceneError unless `ds` has these variables on these dimensions, with their coordinates, and numbers throughout."""
    if not isinstance(ds, xr.Dataset):
        raise SceneError(f"{shown(ds)}: must be the Dataset of a run")
    for name, dims in variables.items():
        if name not in ds or ds[name].dims != dims or not all(d in ds.coords for d in dims if d != "car"):
            raise SceneError(
                f"the Dataset has no {name} ({', '.join(dims)}): of a comparison take one model, ds.sel(model='cars')"
            )
        if not ds[name].size:
            raise SceneError(f"{name}: is empty; give a run with samples, nodes and cars")
        for part in (name, *(d for d in dims if d != "car")):
            values = ds[part].values
            if values.dtype.kind not in "iuf" or not np.all(np.abs(values) < HUGE):
                raise SceneError(f"{part}: must hold finite numbers < {HUGE:g} in size; the file or Dataset is damaged")
        if "time" in dims and not np.all(np.diff(ds.time.values) > 0):
            raise SceneError("time: must increase from sample to sample; sort it, or drop what is there twice")


def _ring(ds) -> float:
    """Length of the ring, in the units of x."""
    spacing = np.diff(ds.x.values)
    if not spacing.size or not np.allclose(spacing, spacing[0], rtol=1e-6, atol=0) or not spacing[0] > 0:
        raise SceneError("x: must hold two or more equally spaced nodes; give the whole road of a run")
    return ds.x.size * float(spacing[0])


def _changes(values, times) -> np.ndarray:
    """d(values)/dt by differences over neighbouring samples, NaN where there is nothing to differ from."""
    if times.size < 2:
        raise SceneError(f"time: a rate needs two samples or more, there are {times.size}")
    return np.gradient(values, times)


def growth_rate(ds: xr.Dataset, wavenumber: float) -> xr.DataArray:
    """d ln(amplitude)/dt of one wave (time,), by differences over neighbouring samples; exact for an exponential.

    NaN next to a sample where the wave is not there at all.
    """
    amplitude = mode(ds, wavenumber).amplitude.values
    with np.errstate(all="ignore"):
        rate = _changes(np.log(np.where(amplitude > 0, amplitude, np.nan)), ds.time.values)
    return xr.DataArray(variable("growth_rate", "time", rate), {"time": ds.time}, name="growth_rate")


def phase_velocity(ds: xr.Dataset, wavenumber: float) -> xr.DataArray:
    """-d(phase)/dt / wavenumber of one wave (time,), positive with the traffic; as `growth_rate`."""
    phase = mode(ds, wavenumber).phase.values
    velocity = -_changes(phase, ds.time.values) / wavenumber
    return xr.DataArray(variable("phase_velocity", "time", velocity), {"time": ds.time}, name="phase_velocity")


def mean_rates(
    ds: xr.Dataset, wavenumber: float, begin: float, end: float, *, velocity: float = 0.0
) -> tuple[float, float]:
    """Growth rate and phase velocity of one wave from the sample nearest `begin` to that nearest `end`.

    NaN where these are the same sample, or the wave is not there at one of them. `velocity` as in `mode`.
    """
    wave = mode(ds, wavenumber, velocity=velocity)
    i, j = (int(np.argmin(np.abs(ds.time.values - t))) for t in (begin, end))
    span = float(ds.time[j] - ds.time[i])
    if span == 0:
        return np.nan, np.nan
    first, last = float(wave.amplitude[i]), float(wave.amplitude[j])
    if not min(first, last) > 0:
        return np.nan, np.nan
    growth = (np.log(last) - np.log(first)) / span
    return growth, -float(wave.phase[j] - wave.phase[i]) / span / wavenumber


def coarse_grain(ds: xr.Dataset) -> xr.Dataset:
    """car_height and contact_force as fields (time, x) on the road's grid.

    From discrete cars by the periodic cubic spline through them, which resolves waves of about four cars or more; a
    Dataset that has them as fields already is returned with these variables only.
    """
    if not isinstance(ds, xr.Dataset) or "car_position" not in ds:
        _refuse_without(ds, car_height=("time", "x"), contact_force=("time", "x"))
        return ds[["car_height", "contact_force"]]
    on = ("time", "car")
    _refuse_without(ds, road_height=("time", "x"), car_height=on, contact_force=on, car_position=on)
    length = _ring(ds)
    where = ds.car_position.values
    if not np.all((where >= 0) & (where < length)):
        raise SceneError(
            f"car_position: must lie from 0 to below the ring's length {length:g}; the result is damaged, run it again"
        )
    fields = {}
    for name in ("car_height", "contact_force"):
        values = np.empty((ds.time.size, ds.x.size))
        for i, (where, value) in enumerate(zip(ds.car_position.values, ds[name].values, strict=True)):
            values[i] = _periodic_spline(where, value, length, ds.x.values)
        fields[name] = variable(name, ("time", "x"), values)
    return xr.Dataset(fields, {"time": ds.time, "x": ds.x}, ds.attrs)


def _periodic_spline(where, value, length, x):
    from scipy.interpolate import CubicSpline  # not at the top: 0.2 s, and every plot would wait for it

    place, index = np.unique(where, return_inverse=True)
    mean = np.bincount(index, value) / np.bincount(index)  # cars over the same node count as one
    if place.size == 1:
        return np.full(x.size, mean[0])
    spline = CubicSpline(np.append(place, place[0] + length), np.append(mean, mean[0]), bc_type="periodic")
    return spline(place[0] + np.mod(x - place[0], length))
