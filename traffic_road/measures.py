"""What one run comes to, in a few numbers: the growth, velocity and amplitude of one wave, and how the road fares."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .analysis import mean_rates, mode
from .errors import SceneError
from .theory.dispersion import fleet_dispersion

# the cars' own oscillation decays as exp(-Gamma omega t); after this many times 1/(Gamma omega) it is gone
TRANSIENTS = 10.0
OF_A_WAVE = ("growth_rate", "phase_velocity", "amplitude")
MEASURES = (*OF_A_WAVE, "sink_rate", "airborne")


def measures(ds: xr.Dataset, scene, names, wavenumber: float) -> dict[str, float]:
    """The measures called `names` of a run of `scene`; those of a wave, of the wave of `wavenumber`.

    growth_rate: mean over the linear stage (`linear_stage`), that which theory speaks of. The others describe what the
    road has come to: phase_velocity, sink_rate (of the mean height) and airborne (share of the contact forces that are
    not above zero) are those of the second half of the run, amplitude that of its last sample. NaN where the run was too
    short to tell.
    """
    time = ds.time.values
    late = time >= time[-1] / 2
    begin = float(time[late][0])
    guess = 0.0 if np.isnan(wavenumber) else _drift(scene, wavenumber)
    found = {}
    for name in names:
        if name == "growth_rate":
            found[name], _ = mean_rates(ds, wavenumber, *linear_stage(scene, ds), velocity=guess)
        elif name == "phase_velocity":
            _, found[name] = mean_rates(ds, wavenumber, begin, float(time[-1]), velocity=guess)
        elif name == "amplitude":
            found[name] = float(mode(ds, wavenumber).amplitude[-1])
        elif name == "sink_rate":
            level = ds.road_height.values[late].mean(axis=-1)
            span = float(time[-1]) - begin
            found[name] = float(level[0] - level[-1]) / span if span > 0 else np.nan
        elif name == "airborne":
            found[name] = float(np.mean(ds.contact_force.values[late] <= 0))
    return found


def enough_samples(scene, wavenumber: float, least: int, most: int) -> int:
    """Samples of a run in which the wave turns by an eighth between two, by linear theory: its phase can be followed."""
    turns = abs(wavenumber * _drift(scene, wavenumber)) * scene.duration / (2 * np.pi)
    return int(np.clip(np.ceil(8 * turns) + 1, least, most))


def _drift(scene, wavenumber):
    """Phase velocity of a small wave on the road as it is at the start."""
    softness, diffusivity, rate = frozen_laws(scene, mean_height(scene))
    sigma = fleet_dispersion(wavenumber, scene.fleet, softness=softness, diffusivity=diffusivity, hardening_rate=rate)
    return float(-sigma.imag / wavenumber)


def mean_height(scene) -> float:
    """Mean height of the road at the start."""
    highest = scene.road.profile.highest_wave(scene.road.length)
    return float(np.mean(scene.road.profile.sample(scene.road.length, 2 * highest + 1)))


def waves(scene) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers and amplitudes of the waves that the road has at the start, but for rounding; empty if it is flat."""
    highest = scene.road.profile.highest_wave(scene.road.length)
    nodes = 2 * highest + 1
    wave = np.abs(np.fft.rfft(scene.road.profile.sample(scene.road.length, nodes)))[1:] * (2 / nodes)
    present = np.flatnonzero(wave > 1e-9 * wave.max(initial=0.0))
    return 2 * np.pi * (present + 1) / scene.road.length, wave[present]


def fastest_wave(scene) -> float:
    """The wavenumber that grows fastest by the continuum's theory, of those that the road has at the start.

    SceneError for a flat road.
    """
    k, _ = waves(scene)
    if not k.size:
        raise SceneError(
            "profile: a flat road has no wave to compare; give it one, for instance Sine(1e-3, wavenumber)"
        )
    if k.size == 1:
        return float(k[0])
    softness, diffusivity, _ = frozen_laws(scene, 0.0)
    sigma = fleet_dispersion(k, scene.fleet, softness=softness, diffusivity=diffusivity)
    return float(k[np.argmax(sigma.real)])


def frozen_laws(scene, height: float) -> tuple[float, float, float]:
    """Softness, diffusivity and hardening rate of the settling road at one mean height."""
    softness = float(scene.road.softness(height))
    rate = float(scene.road.softness.derivative(height)) * float(np.mean(scene.fleet.per_car("mass")))
    return softness, float(scene.road.diffusivity(height)), rate


def linear_stage(scene, ds) -> tuple[float, float]:
    """Begin and end of the stage of exponential growth: from 10/(Gamma omega) until the first car is airborne.

    Half of it at least; the whole run where cars are airborne from the start.
    """
    times = ds.time.values
    decay = float(np.min(scene.fleet.per_car("damping") * scene.fleet.per_car("frequency")))
    airborne = np.flatnonzero((ds.contact_force.values <= 0).any(axis=1)) if scene.lift_off else np.array([], int)
    end = times[airborne[0] - 1] if airborne.size and airborne[0] > 1 else times[-1]
    begin = min(TRANSIENTS / decay if decay > 0 else np.inf, 0.5 * end)
    return float(times[np.argmin(np.abs(times - begin))]), float(end)
