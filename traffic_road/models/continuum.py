"""The continuum of cars and road, Eqs. (4)-(5) of Both, Hong and Kurtze, *Corrugation of Roads*: fields on a ring.

For every kind of car (speed u, frequency omega, damping Gamma, mass m), in first-order form, free of road derivatives,

    (d/dt + u d/dx) Z = P - 2 Gamma omega (Z - H)
    (d/dt + u d/dx) P = -omega^2 (Z - H)
    dH/dt = Delta(H) d2H/dx2 - alpha(H) < m max(0, 1 + omega^2 (H - Z)) >,        < > the mean over the cars.

Fourier in x. The state of a wave is H, then Y = Z - H and P of each kind: with Y instead of Z nothing that acts on the
road depends on how far it has sunk, and precision stays. With alpha and Delta frozen at reference values, and without
the clip, the system of each wave is linear and small; `schemes.exponential` solves it exactly and steps what is left,

    N = (Delta(H) - Delta_ref) d2H/dx2 - (alpha(H) - alpha_ref) < m (1 - omega^2 Y) >
        - alpha(H) < m max(0, omega^2 Y - 1) >,

formed on a grid four times as fine and truncated. N vanishes, and any step is exact, where the laws are constant and no
car is airborne; else the error of a step is of order 4, or about 2 where cars take off and land.
alpha_ref is the softness at the mean height. Delta_ref is the largest Delta on the road, because a remainder that takes
diffusion back is stable and one that adds more than two thirds of the reference is not. Both are renewed after a drift
of 10 %.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.fft import irfft, rfft  # less overhead a call than scipy.fft on the short transforms of one wave

from ..errors import SceneError
from ..laws import Constant, finite
from ..schemes.exponential import exact, krogstad
from ..schemes.oscillator import settled
from . import Sample

KEYWORDS = ("nodes", "step")
OVERSAMPLING = 4
PAIR_RATIO = 2.0  # a pair of runs differs by 3 times the error of the better one at order 2, by more at order 4
DRIFT = 0.1  # of a reference value, at which the matrices are rebuilt
RESOLVED = 1e-3  # drift in one step below which the remainder, fifth power of it, is below rounding: no need to rebuild
LARGEST = 2e9  # multiplications in one product of all matrices: about a minute for a rebuild
MOST_STEPS = 1e10
TOO_LARGE = 1e100  # a law on its way to overflow: the matrices of the last sane one will do


def numerics(scene, given: dict) -> dict:
    """`nodes` (road nodes) and `step` (longest time step, default 0.5), with defaults filled in.

    The default of `nodes` is 16 a wave for a profile of one wave (room for seven harmonics), 4 for the shortest wave of
    any other, and at least 32; where harmonics cannot arise (constant laws, lift_off=False), what the profile needs
    and at least 16.
    SceneError: an unknown keyword, a value out of range, nodes that do not resolve the profile, more work than can be
    done, laws that overflow, an undamped car in resonance with the road it is to be settled on.
    """
    unknown = sorted(set(given) - set(KEYWORDS))
    if unknown:
        raise SceneError(f"unknown keyword {unknown[0]!r} for the continuum; allowed are {', '.join(KEYWORDS)}")
    step = finite("step", given.get("step", 0.5), above=0)
    if scene.duration / step > MOST_STEPS:
        raise SceneError(
            f"step = {step:g}: more than {MOST_STEPS:.0e} steps in a duration of {scene.duration:g}; use a longer step"
        )
    nodes = given["nodes"] if "nodes" in given else _default_nodes(scene)
    if isinstance(nodes, (bool, np.bool_)) or not isinstance(nodes, (int, np.integer)) or nodes < 1:
        raise SceneError(f"nodes = {nodes!r}: must be a whole number >= {_least_nodes(scene)} for this profile")
    nodes, kinds = int(nodes), _Kinds.of(scene.fleet)
    if _modes(nodes) * (2 * len(kinds.speed) + 4) ** 3 > LARGEST:
        raise SceneError(
            f"nodes = {nodes} with {len(kinds.speed)} distinct kinds of car: too large for the continuum; "
            f"use fewer of either, or model='cars'"
        )
    height = scene.road.profile.sample(scene.road.length, nodes)
    wave = np.abs(rfft(height, norm="forward"))
    if nodes % 2 == 0 and wave[-1] > 1e-14 * wave.max():  # a wave of two nodes: where it moves cannot be told
        raise SceneError(f"nodes = {nodes}: the profile has {nodes // 2} waves on the ring; use nodes >= {nodes + 1}")
    start = _Continuum(scene, nodes)
    if not np.isfinite([start.alpha, start.delta, np.abs(start.state).sum()]).all():
        raise SceneError(
            f"Road: softness {start.alpha:g} and diffusivity {start.delta:g} at the start are too large; "
            f"use a lower value or hardening, or a lower profile"
        )
    return {"nodes": nodes, "step": step}


def coarser(scene, numerics: dict) -> dict:
    """Twice the step and half the nodes, but no fewer nodes than the profile needs."""
    return {"nodes": max(numerics["nodes"] // 2, _least_nodes(scene)), "step": 2 * numerics["step"]}


def finer(scene, numerics: dict, given: dict) -> dict:
    """Half the step and twice the nodes, but for what was given."""
    finest = {"nodes": 2 * numerics["nodes"], "step": numerics["step"] / 2}
    return numerics | {name: value for name, value in finest.items() if name not in given}


def sample_times(scene, times, numerics: dict) -> np.ndarray:
    """Samples are taken at exactly the times asked for."""
    return np.asarray(times, dtype=float)


def samples(scene, times, numerics: dict):
    """Yield a Sample at each of `times` (increasing, from 0); fields on x = j length/nodes, shape (nodes,).

    With several kinds of car `car_height` is the mean over the cars and `contact_force` the mean of mass times force.
    Equal steps, none longer than `step`, lead from one sample to the next. An overflowed state is yielded as it is.
    """
    continuum = _Continuum(scene, numerics["nodes"])
    step, now, updates = numerics["step"], 0.0, 0
    for time in map(float, times):
        if time > now:
            steps = max(1, int(np.ceil((time - now) / step * (1 - 1e-12))))
            length = (time - now) / steps
            if abs(length - continuum.step) * steps <= 8 * np.finfo(float).eps * time:
                length = continuum.step  # the same but for the rounding of `times`: keep the matrices
            continuum.advance(length, steps)
            now += steps * length
            updates += steps * numerics["nodes"]
        yield Sample(time, *continuum.fields(), None, updates)


class _Kinds(NamedTuple):
    """The distinct kinds of car and their shares of the fleet, each (kinds, 1)."""

    speed: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    mass: np.ndarray
    share: np.ndarray

    @classmethod
    def of(cls, fleet) -> _Kinds:
        cars = np.column_stack([fleet.per_car(name) for name in cls._fields[:-1]])
        kinds, count = np.unique(cars, axis=0, return_counts=True)
        return cls(*kinds.T[..., None], count[:, None] / fleet.count)

    @property
    def weight(self) -> np.ndarray:
        """Share times mass, so that a sum over kinds is the mean force over the cars."""
        return self.share * self.mass


def _modes(nodes: int) -> int:
    """Waves 0, 1, ... that the grid resolves; the wave of two nodes is not one."""
    return (nodes + 1) // 2


def _highest_wave(scene) -> int:
    """Waves on the ring of the shortest wave that the profile really has."""
    length, profile = scene.road.length, scene.road.profile
    wave = np.abs(rfft(profile.sample(length, 2 * profile.highest_wave(length) + 3), norm="forward"))
    return int(np.flatnonzero(wave >= 1e-14 * wave.max())[-1]) if wave.max() > 0 else 0


def _least_nodes(scene) -> int:
    return 2 * _highest_wave(scene) + 1


def _default_nodes(scene) -> int:
    road, waves = scene.road, _highest_wave(scene)
    if _constant(road) and not scene.lift_off:
        return max(16, 2 * waves + 2)
    wave = np.abs(rfft(road.profile.sample(road.length, 2 * waves + 1))[1:])
    single = np.count_nonzero(wave > 1e-14 * wave.max(initial=0)) == 1
    return max(32, (16 if single else 4) * waves)


def _constant(road) -> bool:
    return isinstance(road.softness, Constant) and isinstance(road.diffusivity, Constant)


def _start(scene, kinds: _Kinds, nodes: int) -> np.ndarray:
    """The state at the start: H, then Y of each kind, then P of each kind, shape (1 + 2 kinds, modes)."""
    road, fleet = scene.road, scene.fleet
    height = road.profile.sample(road.length, nodes)
    Y = P = np.zeros((len(kinds.speed), nodes))
    if fleet.start == "settled":
        sink_rate = float(road.softness(height.mean()) * kinds.weight.sum())
        cars = zip(*(value[:, 0] for value in kinds[:3]), strict=True)
        Z, P = np.moveaxis([settled(height, road.length, *car, sink_rate) for car in cars], 1, 0)
        Y = Z - height
    return rfft(np.concatenate((height[None], Y, P)), norm="forward")[:, : _modes(nodes)]


class _Continuum:
    """The state of cars and road, (1 + 2 kinds, modes), and how it moves on."""

    @np.errstate(all="ignore")  # here and below: what overflows stays non-finite, without a warning
    def __init__(self, scene, nodes: int):
        self.kinds = kinds = _Kinds.of(scene.fleet)
        self.softness, self.diffusivity = scene.road.softness, scene.road.diffusivity
        self.varying = not isinstance(self.softness, Constant), not isinstance(self.diffusivity, Constant)
        self.lift_off = scene.lift_off
        self.nodes, self.fine = nodes, OVERSAMPLING * nodes
        self.k = 2 * np.pi / scene.road.length * np.arange(_modes(nodes))
        self.curvature = -(self.k**2)
        self.count = len(kinds.speed)
        self.square, self.weight = kinds.frequency**2, kinds.weight[:, 0]
        self.state = _start(scene, kinds, nodes)
        self.step, self.alpha, self.delta = 0.0, *self.references()

    def references(self) -> tuple[float, float]:
        """Softness at the mean height of the road, and the largest diffusivity on it (laws do not decrease with H)."""
        highest = irfft(self.state[0], n=self.fine, norm="forward").max() if self.varying[1] else 0.0
        return float(self.softness(self.state[0, 0].real)), float(self.diffusivity(highest))

    def build(self, step: float) -> None:
        """Solve the linear part, of every wave, over `step` and half of it."""
        kinds, n = self.kinds, self.count
        speed, omega, damping, mass, share = (value[:, 0] for value in kinds)
        H, Y, P = 0, np.arange(1, n + 1), np.arange(n + 1, 2 * n + 1)
        ik = 1j * self.k[:, None]
        road = np.zeros((self.k.size, 1 + 2 * n), dtype=complex)  # dH/dt, a row of the system
        road[:, H] = self.delta * self.curvature
        road[:, Y] = self.alpha * share * mass * omega**2
        system = np.zeros((*road.shape, 1 + 2 * n), dtype=complex)
        system[:, Y, Y] = -ik * speed - 2 * damping * omega
        system[:, Y, P] = 1.0
        system[:, Y, H] = -ik * speed
        system[:, Y] -= road[:, None]
        system[:, P, Y] = -(omega**2)
        system[:, P, P] = -ik * speed
        system[:, H] = road
        source = np.zeros(1 + 2 * n)  # what moves the road moves it relative to the cars
        source[H], source[Y] = 1.0, -1.0
        self.step = step
        self.half, self.full = exact(system, source, step / 2), exact(system, source, step)

    def remainder(self, state: np.ndarray) -> np.ndarray:
        """N of every wave, the weight <m> of the cars included in the mean; shape (modes,)."""
        soft, diffuse = self.varying
        weight, Y = self.weight, state[1 : 1 + self.count]
        out = np.zeros(self.k.size, dtype=complex)
        # |Y| <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        clip = self.lift_off and not np.all(self.square[:, 0] * 2 * np.abs(Y).sum(axis=1) <= 1)
        if soft or diffuse or clip:
            waves = np.concatenate((state[: 1 + self.count], self.curvature * state[:1]))
            height, *Y, bend = irfft(waves, n=self.fine, norm="forward")
            alpha, unloading, rate = self.softness(height), self.square * Y, 0.0
            if soft:
                rate -= (alpha - self.alpha) * (weight @ (1 - unloading))
            if clip:
                rate -= alpha * (weight @ np.maximum(0.0, unloading - 1))
            if diffuse:
                rate += (self.diffusivity(height) - self.delta) * bend
            out += rfft(rate, norm="forward")[: self.k.size]
        out[0] -= self.alpha * weight.sum()
        return out

    def renew(self, step: float) -> None:
        """Rebuild the matrices for a new step, or where a reference value has drifted."""
        alpha, delta = self.references() if any(self.varying) else (self.alpha, self.delta)
        drift, spread = abs(alpha - self.alpha), abs(delta - self.delta)
        drifted = (drift > DRIFT * self.alpha and drift * step > RESOLVED) or (
            spread > DRIFT * self.delta and spread * self.k[-1] ** 2 * step > RESOLVED
        )
        drifted = drifted and max(alpha, delta) < TOO_LARGE
        if drifted:
            self.alpha, self.delta = alpha, delta
        if drifted or step != self.step:
            self.build(step)

    @np.errstate(all="ignore")
    def advance(self, step: float, steps: int) -> None:
        """Take `steps` steps of length `step`; a state that overflows becomes and stays NaN."""
        for _ in range(steps):
            if not np.isfinite(self.state[0, 0]):
                self.state[:] = np.nan
                return
            self.renew(step)
            self.state = krogstad(self.state, self.remainder, self.half, self.full)

    @np.errstate(all="ignore")
    def fields(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Road height, mean car height, mean of mass times contact force, on the nodes."""
        height, *Y = irfft(self.state[: 1 + self.count], n=self.nodes, norm="forward")
        force = 1 - self.square * Y
        if self.lift_off:
            force = np.maximum(0.0, force)
        return height, height + self.kinds.share[:, 0] @ Y, self.weight @ force
