"""What a scene will come to, before any run: whether cars take off, and what part of a long road stands for all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .laws import Constant
from .models import linear
from .profiles import Noise, Sine
from .scene import Fleet, Road
from .theory.dispersion import fleet_dispersion, response
from .theory.settling import settle

STRONGEST = 12  # waves of the profile whose growth is followed
LOOKS = 25  # times at which the settling road is asked for its growth rates
OF_HEADWAY = 5000  # matrices that one of a whole headway, and its powers, count for
PEAK = 3.0  # of a noisy road, in root mean squares
PIECE_CARS, PIECE_WAVES = 48, 8  # a piece of a long noisy road that stands for all of it has at least so many


def constant_laws(scene) -> bool:
    return all(isinstance(law, Constant) for law in (scene.road.softness, scene.road.diffusivity))


def matrices(scene) -> int:
    """Of how many waves and moments `takes_off` asks for a matrix."""
    waves = scene.road.profile.highest_wave(scene.road.length)
    if not scene.lift_off:
        return 0
    if constant_laws(scene):
        return (waves + 1) * (OF_HEADWAY if linear.sparse(scene) else 1)
    return LOOKS * min(STRONGEST, waves)


def takes_off(scene) -> float | None:
    """When small waves will have grown until cars take off, by linear theory; None if not within the duration.

    Constant laws: the linear model's own. Else the growth rates of the settling road, its softness, diffusivity and
    hardening rate as they are at each moment (Both, Hong and Kurtze, Eqs. (12), (20)), summed over time.
    """
    if constant_laws(scene) or not scene.lift_off:
        return linear.takes_off(scene, scene.duration) if scene.lift_off else None
    from scipy.integrate import cumulative_trapezoid  # not at the top: 0.2 s, and every run would wait for it

    road, fleet = scene.road, scene.fleet
    nodes = 2 * road.profile.highest_wave(road.length) + 1
    profile = road.profile.sample(road.length, nodes)
    wave = 2 * np.abs(np.fft.rfft(profile, norm="forward"))[1:]
    strongest = np.flatnonzero(wave > 0)[np.argsort(-wave[wave > 0])[:STRONGEST]]
    k, wave = 2 * np.pi / road.length * (strongest + 1), wave[strongest]
    load = float(np.mean(fleet.per_car("mass")))
    times = np.linspace(0.0, scene.duration, LOOKS)
    damping = max(float(np.mean(fleet.per_car("damping"))), 1e-3)
    settled = settle(road.softness, damping, load * times, height=float(profile.mean()), full=False)
    rates = []
    for height, softness in zip(settled.road_height.values, settled.softness.values, strict=True):
        rate = load * float(road.softness.derivative(height))
        terms = {"softness": float(softness), "diffusivity": float(road.diffusivity(height)), "hardening_rate": rate}
        rates.append(fleet_dispersion(k, fleet, **terms).real)
    grown = cumulative_trapezoid(np.array(rates), times, axis=0, initial=0.0)
    pressed = np.abs(response(1j * k * np.mean(fleet.per_car("speed") / fleet.per_car("frequency")), damping))
    with np.errstate(over="ignore"):
        stretch = wave * pressed * np.exp(grown)
    peak = np.minimum(stretch.sum(axis=1), PEAK * np.sqrt(np.sum(stretch**2, axis=1) / 2))
    lost = np.flatnonzero(peak * float(np.mean(fleet.per_car("frequency"))) ** 2 >= 1)
    return float(times[lost[0]]) if lost.size else None


def whole_headways(scene) -> int:
    """The duration in headways, at least one."""
    return max(1, round(scene.duration / scene.headway_time))


def piece(scene):
    """A shorter ring that stands for the scene: one period of a periodic one, or a part of a long noisy one."""
    road, fleet, count = scene.road, scene.fleet, scene.fleet.count
    if fleet.position is not None or any(isinstance(getattr(fleet, n), tuple) for n in ("speed", "frequency", "mass")):
        return scene
    if isinstance(fleet.damping, tuple):
        return scene
    waves = road.profile.highest_wave(road.length)
    parts = 1
    if isinstance(road.profile, Sine):
        parts = int(np.gcd(waves, count))
    elif isinstance(road.profile, Noise):
        most = min(count // PIECE_CARS, waves // PIECE_WAVES)
        parts = max((n for n in range(1, most + 1) if count % n == 0), default=1)
    if parts == 1:
        return scene
    shorter = Road(road.length / parts, road.softness, road.diffusivity, road.profile)
    one = Fleet(count // parts, fleet.damping, fleet.speed, fleet.frequency, fleet.mass, start=fleet.start)
    return replace(scene, road=shorter, fleet=one)
