"""The state of the continuum, wave by wave, and how it moves on: the equations of `continuum`, step by step."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.fft import irfft, rfft  # less overhead a call than scipy.fft on the short transforms of one wave

from ..laws import Constant
from ..schemes.exponential import doubled, eigenvectors, exact, krogstad, stays_below
from ..schemes.oscillator import settled
from . import continuum_kernels as kernels

OVERSAMPLING = 4
FEW_NODES = 512  # up to which compiled sums over the waves take the place of transforms, and the clip is exact
FEW_NODES_VARYING = 128  # the same where laws vary, so that all waves of the fine grid take part
DRIFT = 0.1  # of a reference value, at which the matrices are rebuilt
RESOLVED = 1e-3  # drift in one step below which the remainder, fifth power of it, is below rounding: no need to rebuild
TOO_LARGE = 1e100  # a law on its way to overflow: the matrices of the last sane one will do


class Kinds(NamedTuple):
    """The distinct kinds of car and their shares of the fleet, each (kinds, 1)."""

    speed: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    mass: np.ndarray
    share: np.ndarray

    @classmethod
    def of(cls, fleet) -> Kinds:
        cars = [getattr(fleet, name) for name in cls._fields[:-1]]
        if not any(isinstance(values, tuple) for values in cars):
            return cls(*np.array(cars)[:, None, None], np.ones((1, 1)))
        cars = np.column_stack([fleet.per_car(name) for name in cls._fields[:-1]])
        kinds, count = np.unique(cars, axis=0, return_counts=True)
        return cls(*kinds.T[..., None], count[:, None] / fleet.count)

    @property
    def weight(self) -> np.ndarray:
        """Share times mass, so that a sum over kinds is the mean force over the cars."""
        return self.share * self.mass


def modes(nodes: int) -> int:
    """Waves 0, 1, ... that the grid resolves; the wave of two nodes is not one."""
    return (nodes + 1) // 2


def constant(road) -> bool:
    return isinstance(road.softness, Constant) and isinstance(road.diffusivity, Constant)


@lru_cache(maxsize=2)  # asked for by `numerics`, and again by the run that follows
def _start(scene, nodes: int) -> np.ndarray:
    """The state at the start: H, then Y of each kind, then P of each kind, shape (1 + 2 kinds, modes)."""
    road, fleet, kinds = scene.road, scene.fleet, Kinds.of(scene.fleet)
    height = road.profile.sample(road.length, nodes)
    Y = P = np.zeros((len(kinds.speed), nodes))
    if fleet.start == "settled":
        sink_rate = float(road.softness(height.mean()) * kinds.weight.sum())
        cars = zip(*(value[:, 0] for value in kinds[:3]), strict=True)
        Z, P = np.moveaxis([settled(height, road.length, *car, sink_rate) for car in cars], 1, 0)
        Y = Z - height
    return rfft(np.concatenate((height[None], Y, P)), norm="forward")[:, : modes(nodes)]


class Continuum:
    """The state of cars and road, (1 + 2 kinds, modes), and how it moves on."""

    @np.errstate(all="ignore")  # here and below: what overflows stays non-finite, without a warning
    def __init__(self, scene, nodes: int):
        self.kinds = kinds = Kinds.of(scene.fleet)
        self.softness, self.diffusivity = scene.road.softness, scene.road.diffusivity
        self.constant = constant(scene.road)
        self.lift_off = scene.lift_off
        self.nodes, self.fine = nodes, OVERSAMPLING * nodes
        self.k = 2 * np.pi / scene.road.length * np.arange(modes(nodes))
        self.count = len(kinds.speed)
        self.square, self.weight = kinds.frequency[:, 0] ** 2, kinds.weight[:, 0]
        self.state = _start(scene, nodes).copy()
        self.step, self.alpha, self.delta = 0.0, *self.references()
        self.few = nodes <= (FEW_NODES if self.constant else FEW_NODES_VARYING)
        self.laws = np.array([*self.softness.kernel, *self.diffusivity.kernel], dtype=float)
        self.linear = self.linear_part()
        self.decay = self.table = self.half = None  # made when needed

    def references(self) -> tuple[float, float]:
        """Softness at the mean height of the road, and the largest diffusivity on it (laws do not decrease with H)."""
        varies = not isinstance(self.diffusivity, Constant)
        highest = irfft(self.state[0], n=self.fine, norm="forward").max() if varies else 0.0
        return float(self.softness(self.state[0, 0].real)), float(self.diffusivity(highest))

    def linear_part(self) -> tuple[np.ndarray, np.ndarray]:
        """The linear part: the matrix of every wave, (modes, size, size), and where the remainder acts, (size,)."""
        kinds, n = self.kinds, self.count
        speed, omega, damping = (value[:, 0] for value in kinds[:3])
        H, Y, P = 0, np.arange(1, n + 1), np.arange(n + 1, 2 * n + 1)
        ik = 1j * self.k[:, None]
        road = np.zeros((self.k.size, 1 + 2 * n), dtype=complex)  # dH/dt, a row of the system
        road[:, H] = -self.delta * self.k**2
        road[:, Y] = self.alpha * self.weight * self.square
        system = np.zeros((*road.shape, 1 + 2 * n), dtype=complex)
        system[:, Y, Y] = -ik * speed - 2 * damping * omega
        system[:, Y, P] = 1.0
        system[:, Y, H] = -ik * speed
        system[:, Y] -= road[:, None]
        system[:, P, Y] = -self.square
        system[:, P, P] = -ik * speed
        system[:, H] = road
        source = np.zeros(1 + 2 * n)  # what moves the road moves it relative to the cars
        source[H], source[Y] = 1.0, -1.0
        return system, source

    def build(self, step: float) -> None:
        """Solve the linear part, of every wave, over `step` and half of it."""
        self.step = step
        self.half = exact(*self.linear, step / 2)
        self.full = doubled(self.half)

    def leave(self) -> dict:
        """All that is needed to go on as if nothing had been."""
        leapt = self.half is None
        return {"state": self.state.copy(), "step": self.step, "alpha": self.alpha, "delta": self.delta, "leapt": leapt}

    @np.errstate(all="ignore")
    def take_up(self, left: dict) -> None:
        """Be as `leave` left it."""
        self.state = left["state"].copy()
        self.alpha, self.delta = left["alpha"], left["delta"]
        self.linear = self.linear_part()
        if left["leapt"]:
            self.step, self.half, self.full = left["step"], None, exact(*self.linear, left["step"])
        else:
            self.build(left["step"])

    @np.errstate(all="ignore")
    def stays_linear(self, duration: float) -> bool:
        """Whether it is certain that for `duration` no law varies and no car takes off."""
        if not self.constant or not self.lift_off:
            return self.constant
        Y = slice(1, 1 + self.count)
        # most often the largest wave alone decides at once
        if np.any(self.square[:, None] * np.abs(self.state[Y]) >= 1):
            return False
        if self.decay is None:
            self.decay = eigenvectors(self.linear[0])
        waves = self.state.copy()
        waves[1 + self.count :, 0] += self.alpha * self.weight.sum()  # about cars at rest on a road that sinks
        waves[0, 0] = 0.0
        return stays_below(1 / self.square, self.decay, waves, Y, duration)

    def remainder(self, state: np.ndarray) -> np.ndarray:
        """N of every wave, the weight <m> of the cars included in the mean; shape (modes,)."""
        if self.few:
            *terms, cosine, sine = self.terms()
            work = kernels.workspace(self.k.size, self.count, cosine, not self.constant)
            series = np.empty((2, self.k.size))
            kernels.remainder(kernels.parts(state), *terms, cosine, sine, work, series)
            return series[0] + 1j * series[1]
        out = self.at_rest()
        # |Y| <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        clip = self.lift_off and not np.all(self.square * 2 * np.abs(state[1 : 1 + self.count]).sum(axis=1) <= 1)
        if clip or not self.constant:
            waves = np.concatenate((state[: 1 + self.count], -(self.k**2) * state[:1]))
            height, *Y, bend = irfft(waves, n=self.fine, norm="forward")
            over = self.square[:, None] * Y - 1
            rate, excess = np.empty_like(height), np.empty_like(over)
            kernels.at_points(height, bend, over, self.weight, self.laws, self.frozen(), rate, excess)
            if clip:
                rate -= np.maximum(0.0, excess).sum(axis=0)
            out += rfft(rate, norm="forward")[: self.k.size]
        return out

    def at_rest(self) -> np.ndarray:
        """The remainder where laws are constant and no car is airborne: the weight of the cars."""
        out = np.zeros(self.k.size, dtype=complex)
        out[0] = -self.alpha * self.weight.sum()
        return out

    def frozen(self) -> np.ndarray:
        """The reference values, for compiled loops."""
        return np.array([self.alpha, self.delta])

    def terms(self) -> tuple:
        """What the compiled remainder needs to know, beside the state."""
        if self.table is None:
            self.table = kernels.table(self.k.size if self.constant else self.fine // 2, self.fine)
        switches = not self.constant, self.lift_off
        return -(self.k**2), self.square, self.weight, self.laws, self.frozen(), switches, *self.table

    def renew(self, step: float) -> None:
        """Rebuild the matrices for a new step, or where a reference value has drifted."""
        alpha, delta = (self.alpha, self.delta) if self.constant else self.references()
        drift, spread = abs(alpha - self.alpha), abs(delta - self.delta)
        drifted = (drift > DRIFT * self.alpha and drift * step > RESOLVED) or (
            spread > DRIFT * self.delta and spread * self.k[-1] ** 2 * step > RESOLVED
        )
        drifted = drifted and max(alpha, delta) < TOO_LARGE
        if drifted:
            self.alpha, self.delta = alpha, delta
            self.linear = self.linear_part()
        if drifted or step != self.step or self.half is None:
            self.build(step)

    @np.errstate(all="ignore")
    def leap(self, duration: float) -> None:
        """Take `duration` in one step: exact where the remainder is constant."""
        if duration != self.step:
            self.step, self.half, self.full = duration, None, exact(*self.linear, duration)
        self.state = np.einsum("ijk,jk->ik", self.full[:, :-2], np.concatenate((self.state, self.at_rest()[None])))

    @np.errstate(all="ignore")
    def advance(self, step: float, steps: int) -> None:
        """Take `steps` steps of length `step`; a state that overflows becomes and stays NaN."""
        if self.few and self.constant:
            self.renew(step)
            kernels.advance(self.state, self.half, self.full, steps, *self.terms())
            return
        for _ in range(steps):
            if not np.isfinite(self.state[0, 0]):
                self.state[:] = np.nan
                return
            self.renew(step)
            if self.few:
                kernels.advance(self.state, self.half, self.full, 1, *self.terms())
            else:
                self.state = krogstad(self.state, self.remainder, self.half, self.full)

    @np.errstate(all="ignore")
    def fields(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Road height, mean car height, mean of mass times contact force, on the nodes."""
        height, *Y = irfft(self.state[: 1 + self.count], n=self.nodes, norm="forward")
        force = 1 - self.square[:, None] * Y
        if self.lift_off:
            force = np.maximum(0.0, force)
        return height, height + self.kinds.share[:, 0] @ Y, self.weight @ force
