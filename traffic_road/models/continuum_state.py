"""The state of the continuum, wave by wave, and how it moves on: the equations of `continuum`, step by step."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.fft import irfft, rfft  # less overhead a call than scipy.fft on the short transforms of one wave

from ..laws import Constant
from ..schemes.exponential import doubled, eigenvectors, exact, krogstad
from ..schemes.oscillator import settled_waves
from . import continuum_kernels as kernels
from . import continuum_waves as waves

OVERSAMPLING = 4
FEW_NODES = 512  # up to which compiled sums over the waves take the place of transforms, and the clip is exact
FEW_NODES_VARYING = 128  # the same where laws vary, so that all waves of the fine grid take part
SHORT = 64  # nodes up to which compiled sums take less time than the call of a transform
DRIFT = 0.1  # of a reference value, at which the matrices are rebuilt
RESOLVED = 1e-3  # drift in one step below which the remainder, fifth power of it, is below rounding: no need to rebuild
EPS = float(np.finfo(float).eps)
TOO_LARGE = 1e100  # a law on its way to overflow: the matrices of the last sane one will do


class Kinds(NamedTuple):
    """The distinct kinds of car and their shares of the fleet, each (kinds,).

    weight: share times mass, so that a sum over kinds is the mean force over the cars; square: omega^2; load: the sum of
    the weights; quickest: wavenumber omega/u of the shortest wave that any of them answers to.
    """

    speed: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    mass: np.ndarray
    share: np.ndarray
    weight: np.ndarray
    square: np.ndarray
    load: float
    quickest: float

    @classmethod
    @lru_cache(maxsize=2)
    @np.errstate(all="ignore")  # here and below: what overflows stays non-finite, without a warning
    def of(cls, fleet) -> Kinds:
        cars = [getattr(fleet, name) for name in cls._fields[:4]]
        if not any(isinstance(values, tuple) for values in cars):
            cars, share = np.array(cars)[:, None], np.ones(1)
        else:
            kinds, count = np.unique(
                np.column_stack([fleet.per_car(name) for name in cls._fields[:4]]), axis=0, return_counts=True
            )
            cars, share = np.ascontiguousarray(kinds.T), count / fleet.count
        quickest = float(np.max(cars[1] / cars[0]))
        return cls(*cars, share, share * cars[3], cars[1] ** 2, float(share @ cars[3]), quickest)


def modes(nodes: int) -> int:
    """Waves 0, 1, ... that the grid resolves; the wave of two nodes is not one."""
    return (nodes + 1) // 2


def constant(road) -> bool:
    return isinstance(road.softness, Constant) and isinstance(road.diffusivity, Constant)


class Start(NamedTuple):
    """What a scene on a grid begins with; not to be changed."""

    kinds: Kinds
    k: np.ndarray  # wavenumbers, (modes,)
    state: np.ndarray  # H, then Y of each kind, then P of each kind, shape (1 + 2 kinds, modes)
    alpha: float
    delta: float
    finite: bool  # whether no number has overflowed
    highest: int  # wave of the profile
    base: int  # of what number of waves on the ring all that the profile has are multiples
    linear: list[np.ndarray]  # `waves.linear_part`


@lru_cache(maxsize=2)  # asked for by `numerics`, and again by the run that follows
@np.errstate(all="ignore")
def start(scene, nodes: int) -> Start:
    road, kinds = scene.road, Kinds.of(scene.fleet)
    spectrum = road.profile.spectrum(road.length, nodes)
    k = 2 * np.pi / road.length * np.arange(modes(nodes))
    alpha, delta = references(road, spectrum[: k.size], nodes)
    settled = scene.fleet.start == "settled"
    state, possible, finite, highest, base, *linear = waves.beginning(
        spectrum, k, *kinds[:3], kinds.weight, alpha, delta, settled
    )
    if not possible:
        settled_waves(
            state[0], np.arange(k.size), road.length, *(value[:, None] for value in kinds[:3])
        )  # says why not
    return Start(kinds, k, state, alpha, delta, finite, highest, base, linear)


def references(road, wave, nodes: int) -> tuple[float, float]:
    """Softness at the mean height of the road of these waves, (modes,), and the largest diffusivity on it (laws do not
    decrease with H)."""
    if constant(road):
        return road.softness.value, road.diffusivity.value
    varies = not isinstance(road.diffusivity, Constant)
    highest = irfft(wave, n=OVERSAMPLING * nodes, norm="forward").max() if varies else 0.0
    return float(road.softness(wave[0].real)), float(road.diffusivity(highest))


@lru_cache(maxsize=2)  # asked for by the run, and again by its error estimate
def linear_throughout(scene, nodes: int, duration: float) -> bool:
    """Whether it is certain from the start that no law varies and no car takes off: then the run takes no steps."""
    return Continuum(scene, nodes).stays_linear(duration)


def left_by_rounding(scene, road_height, time: float) -> float:
    """Root mean square error, mean removed, at `time` of a run without steps, exact but for the rounding of numbers."""
    nodes = road_height.size
    begin = start(scene, nodes)
    if nodes <= SHORT:
        return waves.left_on_few(road_height, begin.state, begin.linear[0], time)
    return waves.left_by_rounding(rfft(road_height, norm="forward")[: modes(nodes)], begin.state, begin.linear[0], time)


def grown_from_rounding(scene, road_height) -> float:
    """Root mean square of the waves that a road of equal periods, as the profile is, has not: rounding, grown since.

    It is of nothing else, however the run has bounced or hardened, and all that is left where the profile's waves decay.
    """
    nodes = road_height.size
    base = start(scene, nodes).base
    if nodes <= SHORT:
        return waves.grown_from(road_height, modes(nodes), base)
    wave = np.abs(rfft(road_height, norm="forward")[: modes(nodes)])
    return float(np.sqrt(2 * np.sum(wave[np.arange(wave.size) % base != 0] ** 2)))


_table = lru_cache(maxsize=4)(kernels.table)  # of a grid, whatever the scene; a large one would fill the memory


class Continuum:
    """The state of cars and road, (1 + 2 kinds, modes), and how it moves on."""

    def __init__(self, scene, nodes: int):
        begin = start(scene, nodes)
        self.kinds, self.k, self.alpha, self.delta, self.linear = (
            begin.kinds,
            begin.k,
            begin.alpha,
            begin.delta,
            begin.linear,
        )
        kinds, self.road = self.kinds, scene.road
        self.constant = constant(scene.road)
        self.lift_off = scene.lift_off
        self.nodes, self.fine = nodes, OVERSAMPLING * nodes
        self.count = len(kinds.speed)
        self.square, self.weight = kinds.square, kinds.weight
        self.state, self.step = begin.state.copy(), 0.0
        self.frozen = np.array([self.alpha, self.delta])  # for compiled loops
        self.built = 0.0  # the step for which the matrices were made, before they were doubled to `step`
        self.few = nodes <= (FEW_NODES if self.constant else FEW_NODES_VARYING)
        self.steady = self.few and self.constant  # whether the matrices stay as they are while the step does
        self.decay = self.half = None  # made when needed
        self.once = np.empty((1, 1 + self.count, self.k.size), complex)

    @cached_property
    def laws(self) -> np.ndarray:
        """Of softness and of diffusivity, for compiled loops: kind, value and shape, one after the other."""
        return np.array([*self.road.softness.kernel, *self.road.diffusivity.kernel], dtype=float)

    @cached_property
    def terms(self) -> tuple:
        """What the compiled remainder needs to know, beside the state."""
        rows = self.k.size if self.constant else self.fine // 2
        table = _table(rows, self.fine) if self.nodes <= SHORT else kernels.table(rows, self.fine)
        switches = not self.constant, self.lift_off
        return -(self.k**2), self.square, self.weight, self.laws, self.frozen, switches, *table

    def refer(self, alpha: float, delta: float) -> None:
        """Take these for the reference values."""
        self.alpha, self.delta = self.frozen[:] = alpha, delta
        self.linear = waves.linear_part(self.k, *self.kinds[:3], self.weight, alpha, delta)

    @np.errstate(all="ignore")
    def build(self, step: float) -> None:
        """Solve the linear part, of every wave, over `step` and half of it."""
        self.half = exact(*self.linear, step / 2)
        self.step, self.full, self.built = step, doubled(self.half), step

    def double(self) -> None:
        """Go on to steps twice as long."""
        self.step, self.half, self.full = 2 * self.step, self.full, doubled(self.full)

    def as_before(self, step: float, most: float) -> float:
        """The step that is known, or twice that, where `step` is the same but for the rounding of a time `most`."""
        for known in (self.step, 2 * self.step):
            if abs(step - known) <= 8 * EPS * most:
                return known
        return step

    def leave(self) -> dict:
        """All that is needed to go on as if nothing had been."""
        leapt = self.half is None
        now = {"state": self.state.copy(), "step": self.step, "alpha": self.alpha, "delta": self.delta}
        return now | {"leapt": leapt, "built": self.built}

    @np.errstate(all="ignore")
    def take_up(self, left: dict) -> None:
        """Be as `leave` left it."""
        self.state = left["state"].copy()
        self.refer(left["alpha"], left["delta"])
        if left["leapt"]:
            self.step, self.half, self.full = left["step"], None, exact(*self.linear, left["step"])
        else:
            self.build(left["built"])
            while self.step < left["step"]:  # as it was come to: another way differs by roundings
                self.double()

    def stays_linear(self, duration: float) -> bool:
        """Whether it is certain that for `duration` no law varies and no car takes off."""
        if not self.constant or not self.lift_off:
            return self.constant
        rest = self.alpha * self.kinds.load
        # most often the largest wave alone decides at once
        lifted, moving = waves.moving(self.state, self.square, rest)
        if lifted or not moving.size:
            return not lifted
        if self.decay is None or not np.array_equal(self.decay[0], moving):
            self.decay = moving, *eigenvectors(self.linear[0][moving])
        return waves.keep_contact(self.state, rest, self.square, *self.decay, duration)

    def remainder(self, state: np.ndarray) -> np.ndarray:
        """N of every wave, the weight <m> of the cars included in the mean; shape (modes,)."""
        if self.few:
            *terms, cosine, sine = self.terms
            work = kernels.workspace(self.k.size, self.count, cosine, not self.constant)
            series = np.empty((2, kernels.padded(self.k.size)))
            kernels.remainder(kernels.parts(state), *terms, cosine, sine, work, series)
            return (series[0] + 1j * series[1])[: self.k.size]
        out = self.at_rest()
        # |Y| <= the sum of its waves' amplitudes: where that says contact, nothing is left to clip
        clip = self.lift_off and not np.all(self.square * 2 * np.abs(state[1 : 1 + self.count]).sum(axis=1) <= 1)
        if clip or not self.constant:
            series = np.concatenate((state[: 1 + self.count], -(self.k**2) * state[:1]))
            height, *Y, bend = irfft(series, n=self.fine, norm="forward")
            over = self.square[:, None] * Y - 1
            rate, excess = np.empty_like(height), np.empty_like(over)
            kernels.at_points(height, bend, over, self.weight, self.laws, self.frozen, rate, excess)
            if clip:
                rate -= np.maximum(0.0, excess).sum(axis=0)
            out += rfft(rate, norm="forward")[: self.k.size]
        return out

    def at_rest(self) -> np.ndarray:
        """The remainder where laws are constant and no car is airborne: the weight of the cars."""
        out = np.zeros(self.k.size, dtype=complex)
        out[0] = -self.alpha * self.kinds.load
        return out

    def renew(self, step: float) -> None:
        """Rebuild the matrices for a new step, or where a reference value has drifted."""
        alpha, delta = references(self.road, self.state[0], self.nodes)
        drift, spread = abs(alpha - self.alpha), abs(delta - self.delta)
        drifted = (drift > DRIFT * self.alpha and drift * step > RESOLVED) or (
            spread > DRIFT * self.delta and spread * self.k[-1] ** 2 * step > RESOLVED
        )
        drifted = drifted and max(alpha, delta) < TOO_LARGE
        if drifted:
            self.refer(alpha, delta)
            self.build(step)
        self.prepare(step)

    def prepare(self, step: float) -> None:
        """Have the matrices of steps of this length."""
        if self.half is None or step not in (self.step, 2 * self.step):
            self.build(step)
        elif step != self.step:
            self.double()

    def leap(self, duration: float, times: int = 1) -> np.ndarray:
        """Take `duration` in one step, exact where N is constant, so many times; the state after each, as `record`."""
        if duration != self.step:
            self.step, self.half, self.full = duration, None, exact(*self.linear, duration)
        record = self.record(times)
        self.state = waves.leap(self.state, self.full, -self.alpha * self.kinds.load, record)
        return record

    def record(self, times: int) -> np.ndarray:
        """Room for H and Y, (times, 1 + kinds, modes)."""
        return self.once if times == 1 else np.empty((times, 1 + self.count, self.k.size), complex)

    def advance(self, step: float, steps: int, times: int = 1) -> np.ndarray:
        """Take `steps` steps of length `step`, so many times; the state after each, as `record`.

        A state that overflows becomes and stays NaN. More than one time only where `steady` says so, and maybe fewer than were
        asked for: up to where one has to see whether contact is certain.
        """
        if self.steady:
            self.prepare(step)
            record = self.record(times)
            return record[: kernels.advance(self.state, self.half, self.full, steps, record, *self.terms)]
        with np.errstate(all="ignore"):
            for _ in range(steps):
                if not np.isfinite(self.state[0, 0]):
                    self.state[:] = np.nan
                    break
                self.renew(step)
                if self.few:
                    kernels.advance(self.state, self.half, self.full, 1, self.once, *self.terms)
                else:
                    self.state = krogstad(self.state, self.remainder, self.half, self.full)
        return self.now()

    def now(self) -> np.ndarray:
        """The state as it is, as a `record` of one time."""
        return self.state[None, : 1 + self.count]

    def fields(self, record: np.ndarray) -> np.ndarray:
        """Road height, mean car height, mean of mass times contact force, on the nodes: (3, times, nodes)."""
        cars = self.square, self.kinds.share, self.weight, self.lift_off
        if self.nodes <= SHORT:
            return waves.fields_of(record, self.nodes, *cars)
        # one by one: several together may round otherwise
        values = [irfft(state, n=self.nodes, norm="forward") for state in record]
        return waves.fields(np.array(values), *cars)
