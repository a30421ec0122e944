"""One scene by cars, by the continuum and by theory, side by side in one Dataset."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import xarray as xr

from .analysis import coarse_grain, mean_rates, mode
from .errors import SceneError, shown
from .laws import Constant, finite
from .measures import fastest_wave, frozen_laws, linear_stage
from .models import model
from .profiles import whole_waves
from .run import simulate
from .scene import Scene
from .store import provenance, variable
from .theory.dispersion import dispersion, dispersion_leading, fleet_dispersion
from .theory.floquet import floquet

SOURCES = (
    "cars",
    "Floquet matrix of the cars scheme",
    "discrete closed form",
    "continuum run",
    "continuum dispersion relation",
    "leading order",
)


def compare(scene, *, wavenumber=None, tolerance=1e-3, samples=101, progress=None, **numerics) -> xr.Dataset:
    """Cars, continuum and dispersion relation on one scene.

    wavenumber: the wave whose growth is compared; None for the fastest growing one that the road has. numerics: nodes,
    hold, relax_every for the cars, step for the continuum; the other arguments as in `simulate`.

    Dataset: road_height, car_height, contact_force (model, time, x); amplitude, phase (model, time); car_position and the
    cars' own car_height_at_car, contact_force_at_car (time, car); growth_rate, phase_velocity and their relative
    differences from the cars' (source,), NaN where a theory does not apply. Rates are means over the linear stage, from
    10/(Gamma omega) until the first car is airborne: attributes window_begin and window_end.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    if wavenumber is None:
        wavenumber = fastest_wave(scene)
    wavenumber = finite("wavenumber", wavenumber, above=0)
    whole_waves("wavenumber", wavenumber, scene.road.length)
    step = {"step": numerics.pop("step")} if "step" in numerics else {}
    model("continuum").numerics(scene, step)  # refuse what it refuses before the cars have run
    cars = simulate(scene, "cars", tolerance, samples, progress=progress, **numerics)
    continuum = simulate(scene, "continuum", tolerance, cars.time.values, progress=progress, **step)
    common = min(cars.time.size, continuum.time.size)  # where one has diverged
    cars, continuum = cars.isel(time=slice(common)), continuum.isel(time=slice(common))
    fields = coarse_grain(cars)
    on_grid = {name: _on_grid(continuum[name].values, cars.x.size) for name in ("road_height", *fields.data_vars)}
    models = variable("model", "model", np.array(["cars", "continuum"]))
    both = {"road_height": cars.road_height.values} | {name: fields[name].values for name in fields.data_vars}
    variables = {name: variable(name, ("model", "time", "x"), np.stack([both[name], on_grid[name]])) for name in both}
    waves = [mode(ds, wavenumber) for ds in (cars, continuum)]
    for name in ("amplitude", "phase"):
        variables[name] = variable(name, ("model", "time"), np.stack([w[name].values for w in waves]))
    for name in ("car_height", "contact_force"):
        variables[f"{name}_at_car"] = variable(name, ("time", "car"), cars[name].values)
    variables["car_position"] = cars.car_position.variable
    begin, end = linear_stage(scene, cars)
    growth, velocity = _rates(scene, cars, continuum, wavenumber, begin, end)
    for name, values in (("growth_rate", growth), ("phase_velocity", velocity)):
        variables[name] = variable(name, "source", values)
        relative = values / values[0] - 1 if values[0] else np.full_like(values, np.nan)
        variables[f"{name}_difference"] = variable(f"{name}_difference", "source", relative)
    attributes = provenance(scene, "Corrugation of a road by cars, continuum and theory")
    for ds in (cars, continuum):
        for name in ("numerics", "error_estimate", "wall_time", "updates", "status"):
            attributes[f"{ds.attrs['model']}_{name}"] = ds.attrs[name]
    attributes |= {"model": "cars and continuum", "tolerance": tolerance, "wavenumber": wavenumber}
    attributes |= {"window_begin": begin, "window_end": end}
    coordinates = {"model": models, "time": cars.time, "x": cars.x, "car": cars.car}
    coordinates["source"] = variable("source", "source", np.array(SOURCES))
    return xr.Dataset(variables, coordinates, attributes)


def _rates(scene, cars, continuum, wavenumber, begin, end):
    middle = float(cars.road_height.sel(time=(begin + end) / 2, method="nearest").mean())
    softness, diffusivity, hardening_rate = frozen_laws(scene, middle)
    coefficients = {"softness": softness, "diffusivity": diffusivity, "hardening_rate": hardening_rate}
    fleet = scene.fleet
    columns = [np.unique(fleet.per_car(name)) for name in ("speed", "frequency", "damping", "mass")]
    reference = all(c.size == 1 for c in columns) and all(c[0] == 1 for c in (columns[0], columns[1], columns[3]))
    nothing = complex(np.nan, np.nan)
    sigma = {name: nothing for name in SOURCES}
    sigma["continuum dispersion relation"] = fleet_dispersion(wavenumber, fleet, **coefficients)
    if reference:
        sigma["leading order"] = dispersion_leading(wavenumber, damping=columns[2][0], **coefficients)
    frozen = replace(scene, road=replace(scene.road, softness=Constant(softness), diffusivity=Constant(diffusivity)))
    try:
        of_scheme = floquet(frozen, wavenumber, **json.loads(cars.attrs["numerics"]))
        if hardening_rate == 0:  # the matrix knows of no hardening
            sigma["Floquet matrix of the cars scheme"] = of_scheme
        if reference:
            sigma["discrete closed form"] = dispersion(
                wavenumber, damping=columns[2][0], headway=scene.headway, **coefficients
            )
    except SceneError:
        pass  # an uneven or mixed fleet: these theories do not apply, the table says so by NaN
    growth = np.array([sigma[name].real for name in SOURCES])
    velocity = np.array([-sigma[name].imag / wavenumber for name in SOURCES])
    for name, ds in (("cars", cars), ("continuum run", continuum)):
        i = SOURCES.index(name)
        guess = velocity[SOURCES.index("continuum dispersion relation")]
        growth[i], velocity[i] = mean_rates(ds, wavenumber, begin, end, velocity=guess)
    return growth, velocity


def _on_grid(values: np.ndarray, nodes: int) -> np.ndarray:
    """Fields (time, any grid) on `nodes` points of the same ring, wave by wave."""
    waves = np.fft.rfft(values, axis=-1)
    shared = min(waves.shape[-1], nodes // 2 + 1)
    out = np.zeros((values.shape[0], nodes // 2 + 1), dtype=complex)
    out[:, :shared] = waves[:, :shared] * (nodes / values.shape[-1])
    return np.fft.irfft(out, n=nodes, axis=-1)
