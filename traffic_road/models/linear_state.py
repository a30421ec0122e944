"""The state of linear cars and road: every wave of the profile evolves by itself, and no time step is taken.

Even fleet: the discrete scene itself. Sweep, shift and relaxation of one headway are linear in the road of a block and the
car at its start (`theory.floquet`); a transform over the blocks parts the waves, and the n-th power of each one's matrix
leads over n headways at once, from sample to sample. The ripple that passages leave is part of the uniform wave.
Quintic hold, relaxation every headway; grid of its own, the cars halfway between two nodes: there the step that a wheel
rolls down at the end of a block is where it belongs, and the error is of order 2 in the spacing, not 1.

Any other fleet: the mean field, one small matrix exponential per wave of the profile and sample. Passages are as many as
there are cars, but spread evenly in time; steps between nodes passed a different number of times are left out.
"""

from __future__ import annotations

import numpy as np

from ..schemes.exponential import exponentials
from ..schemes.oscillator import settled
from ..theory.dispersion import mode_matrix
from ..theory.floquet import relaxation_matrix, sweep_map
from .cars_state import kinds

HOLD = 5
NOTHING = 1e-14  # of the largest wave: rounding


class Blocks:
    """An even fleet and its road, wave by wave: y (waves, rows + 3 + hold), and the matrix of one relaxation interval.

    y: the road of a block, Z, P and contact heights of the car at its start, and 1 for the uniform wave (its load).
    offset: of the nodes behind the cars, in node spacings. The linear model takes a half; the cars model itself has 0.
    classes: the waves (modulo the cars) to keep, the uniform one 0 among them; None for all that the road has.
    """

    def __init__(self, scene, rows: int, hold: int = HOLD, relax_every: int = 1, offset: float = 0.5, classes=None):
        road, fleet, count = scene.road, scene.fleet, scene.fleet.count
        self.length, self.count, self.rows, nodes = road.length, count, rows, count * rows
        car = [float(fleet.per_car(name)[0]) for name in ("speed", "frequency", "damping", "mass")]
        first = float(np.min(fleet.positions(road.length)))
        self.shift = first - offset * road.length / nodes  # of the grid
        height = _moved(road.profile.sample(road.length, nodes), road.length, self.shift)
        Z, P = height[:: self.rows], np.zeros(count)
        if fleet.start == "settled":
            sink = road.softness.value * car[3]
            Z, P = (field[::rows] for field in settled(height, road.length, *car[:3], sink))
        here = rows * np.arange(count)
        past = [height[(here - q) % nodes] for q in range(hold)]
        block = [height[(here + r) % nodes] for r in range(1, rows + 1)]
        wave = np.fft.rfft(np.array([*block, Z, P, *past]), axis=1, norm="forward").T
        self.size, self.mass, self.square = rows + 2 + hold, car[3], car[1] ** 2
        strength = np.abs(wave[:, :rows]).max(axis=1)
        strength[0] = np.inf
        self.waves = np.flatnonzero(strength > NOTHING * strength[1:].max(initial=0.0))
        if classes is not None:
            self.waves = np.intersect1d(self.waves, classes)
        self.y = np.concatenate((wave[self.waves], np.zeros((self.waves.size, 1))), axis=1)
        self.y[0, -1] = 1.0
        self.softness = road.softness.value * scene.headway / car[0]  # of a passage
        self.matrix = self._interval(scene, car, hold, relax_every)
        self.headway_time, self.powers = scene.headway_time, {}

    def _interval(self, scene, car, hold, relax_every):
        rows, size, waves = self.rows, self.size, self.waves
        sweep = np.zeros((waves.size, size + 1, size + 1), dtype=complex)
        sweep[:, :size] = sweep_map(
            headway=scene.headway, rows=rows, hold=hold, softness=scene.road.softness.value, car=car
        )
        sweep[:, rows:size] *= np.exp(-2j * np.pi * waves / self.count)[:, None, None]  # the next car comes from behind
        sweep[0, size, size] = 1.0
        self.sweep, self.half = sweep[:, :rows].copy(), None
        if relax_every > 1:
            sweep = np.linalg.matrix_power(sweep, relax_every)
        diffusion = scene.road.diffusivity.value * relax_every * scene.headway_time / 2
        if diffusion > 0:
            half = np.array(
                [
                    relaxation_matrix(
                        2 * np.pi * n / self.length, headway=scene.headway, rows=rows, diffusion=diffusion
                    )
                    for n in waves
                ]
            )
            sweep[:, :, :rows] = sweep[:, :, :rows] @ half
            sweep[:, :rows] = half @ sweep[:, :rows]
            self.half = half
        return sweep

    def after(self, y, intervals: int) -> np.ndarray:
        """y after so many relaxation intervals."""
        if intervals and intervals not in self.powers:
            self.powers[intervals] = np.linalg.matrix_power(self.matrix, intervals)
        return (self.powers[intervals] @ y[..., None])[..., 0] if intervals else y

    def advance(self, y, now: float, time: float):
        """y at `time`, a whole number of headways after `now`, and that time."""
        return self.after(y, round((time - now) / self.headway_time)), time

    def forces(self, y) -> np.ndarray:
        """Those of all passages of the headway to come, in loads of a car, (cars, rows): by what the road sinks."""
        before = y.copy()
        if self.half is not None:
            before[:, : self.rows] = (self.half @ y[:, : self.rows, None])[..., 0]
        sunk = np.zeros((self.count // 2 + 1, self.rows), dtype=complex)
        sunk[self.waves] = before[:, : self.rows] - (self.sweep @ before[..., None])[..., 0]
        return np.fft.irfft(sunk, n=self.count, axis=0, norm="forward") / (self.softness * self.mass)

    def fields(self, y, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Road height, car height and contact force, each (nodes,)."""
        Z = y[:, self.rows]
        force = self.mass * self.square * (y[:, self.rows + 2] - Z)
        force[0] += self.mass
        return self.road(y, nodes), self.at_cars(Z, nodes), self.at_cars(force, nodes)

    def road(self, y, nodes: int) -> np.ndarray:
        """Heights at x = j length/nodes."""
        wave = np.zeros((self.count // 2 + 1, self.rows), dtype=complex)
        wave[self.waves] = y[:, : self.rows]
        blocks = np.fft.irfft(wave, n=self.count, axis=0, norm="forward")
        # the last node of block b is the first of block b + 1: row r is r + 1 spacings from the car
        return _moved(np.roll(blocks.ravel(), 1), self.length, -self.shift)[:: self.count * self.rows // nodes]

    def at_cars(self, values, nodes: int) -> np.ndarray:
        """A field through the values (waves,) that belong to the cars."""
        wave = np.zeros(nodes // 2 + 1, dtype=complex)
        wave[self.waves] = values * np.exp(-2j * np.pi * self.waves * self.shift / self.length)
        if self.count % 2 == 0 and nodes > self.count:
            wave[self.count // 2] /= 2  # the shortest wave that cars show stands for a pair
        return np.fft.irfft(wave, n=nodes, norm="forward")


def _moved(height, length, shift):
    """A periodic function, given at the nodes, at the nodes + shift."""
    if shift == 0:
        return height
    wave = np.fft.rfft(height)
    return np.fft.irfft(wave * np.exp(2j * np.pi / length * shift * np.arange(wave.size)), n=height.size)


class MeanField:
    """The mean field of any fleet: y (waves, 2 kinds + 2) of H, then Z, P of each kind, then 1 for the uniform wave."""

    def __init__(self, scene):
        road, fleet = scene.road, scene.fleet
        distinct, kind_of = kinds(fleet)
        _, frequency, _, self.mass = distinct.T
        self.share = np.bincount(kind_of) / fleet.count
        self.square = frequency**2
        nodes = 2 * road.profile.highest_wave(road.length) + 1
        height = road.profile.sample(road.length, nodes)
        sink = road.softness.value * float(self.share @ self.mass)
        if fleet.start == "settled":
            cars = [settled(height, road.length, *car[:3], sink) for car in distinct]
        else:
            cars = [(height, np.zeros(nodes))] * len(distinct)
        fields = np.array([height, *(field for car in cars for field in car)])
        wave = np.fft.rfft(fields, axis=1, norm="forward").T
        strength = np.abs(wave[:, 0])
        strength[0] = np.inf
        self.waves = np.flatnonzero(strength > NOTHING * strength[1:].max(initial=0.0))
        self.y = np.concatenate((wave[self.waves], np.zeros((self.waves.size, 1))), axis=1)
        self.y[0, -1] = 1.0
        laws = {"softness": road.softness.value, "diffusivity": road.diffusivity.value}
        zero, plus, minus = (mode_matrix(k, fleet, **laws) for k in (0.0, 1.0, -1.0))
        k = 2 * np.pi / road.length * self.waves[:, None, None]
        size = len(zero) + 1
        self.rates = np.zeros((self.waves.size, size, size), dtype=complex)
        self.rates[:, :-1, :-1] = zero + k * (plus - minus) / 2 + k**2 * ((plus + minus) / 2 - zero)
        self.rates[0, 0, -1] = -sink
        self.propagators: dict = {}

    def after(self, y, span: float) -> np.ndarray:
        if span not in self.propagators:
            self.propagators[span] = exponentials(span * self.rates)
        return (self.propagators[span] @ y[..., None])[..., 0]

    def advance(self, y, now: float, time: float):
        """y at `time`, and that time but for rounding, so that equal spans are equal to the last bit."""
        span = float(f"{time - now:.12g}")
        return (self.after(y, span), now + span) if span > 0 else (y, now)

    def by_kind(self, y, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Road height (nodes,), car height and contact force of each kind, (kinds, nodes)."""
        wave = np.zeros((y.shape[1], nodes // 2 + 1), dtype=complex)
        wave[:, self.waves] = y.T
        height, *rest = np.fft.irfft(wave[:-1], n=nodes, axis=1, norm="forward")
        Z = np.array(rest[::2])
        return height, Z, self.mass[:, None] * (1 + self.square[:, None] * (height - Z))

    def fields(self, y, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Road height, and the means over the cars of height and contact force, each (nodes,)."""
        height, Z, force = self.by_kind(y, nodes)
        return height, self.share @ Z, self.share @ force
