"""Compiled loops over the waves of the continuum: how they begin, their linear part, what is sure of a run without steps, and
the fields on the nodes."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from ..schemes.exponential import stays_below
from .continuum_kernels import on_nodes, on_waves

COMPILE = {"cache": True, "error_model": "numpy"}
EPS = float(np.finfo(float).eps)


@njit(**COMPILE)
def linear_part(k, speed, frequency, damping, weight, alpha, delta):
    """The linear part: the matrix of every wave, (modes, size, size), and where the remainder acts, (size,).

    k: (modes,); the cars: (kinds,), `weight` their share of the fleet times their mass.
    """
    kinds = speed.size
    size = 1 + 2 * kinds  # H, then Y of each kind, then P of each kind
    system = np.zeros((k.size, size, size), dtype=np.complex128)
    for m in range(k.size):
        A = system[m]
        A[0, 0] = -delta * k[m] ** 2
        for i in range(kinds):
            A[0, 1 + i] = alpha * weight[i] * frequency[i] ** 2
        for i in range(kinds):
            Y, P, along = 1 + i, 1 + kinds + i, -1j * k[m] * speed[i]
            for j in range(1 + kinds):
                A[Y, j] = -A[0, j]
            A[Y, Y] += along - 2 * damping[i] * frequency[i]
            A[Y, 0] += along
            A[Y, P] = 1.0
            A[P, Y] = -(frequency[i] ** 2)
            A[P, P] = along
    source = np.zeros(size)  # what moves the road moves it relative to the cars
    source[0], source[1 : 1 + kinds] = 1.0, -1.0
    return system, source


@njit(**COMPILE)
def highest_of(wave, first):
    """The largest amplitude of these waves (modes,) from one on."""
    highest = 0.0
    for m in range(first, wave.size):
        highest = max(highest, abs(wave[m]))
    return highest


@njit(**COMPILE)
def beginning(spectrum, k, speed, frequency, damping, weight, alpha, delta, settled):
    """The state at the start, (size, modes), if it can be, if it is finite, what waves there are, and `linear_part`.

    settled: if cars are. What waves: `profile_of`.
    """
    state = np.zeros((1 + 2 * speed.size, k.size), np.complex128)
    for m in range(k.size):  # numba compiles slices, and arrays in formulas, for seconds
        state[0, m] = spectrum[m]
    possible = not settled or settle(state, k, speed, frequency, damping, alpha * weight.sum())
    system, source = linear_part(k, speed, frequency, damping, weight, alpha, delta)
    total = alpha + delta
    for i in range(state.shape[0]):
        for m in range(k.size):
            total += abs(state[i, m])
    return state, possible, math.isfinite(total), *profile_of(spectrum), system, source


@njit(**COMPILE)
def profile_of(spectrum):
    """The highest wave of a profile that is more than rounding, and of what number all are multiples, 1 for a flat one."""
    least, highest, base = 1e-14 * highest_of(spectrum, 0), 0, 0
    for m in range(spectrum.size):
        if abs(spectrum[m]) > least:
            highest, base = m, math.gcd(base, m)
    return highest, max(1, base)


@njit(**COMPILE)
def settle(state, k, speed, frequency, damping, sink_rate):
    """Give the cars of `state` (size, modes) their periodic response to its road; False where one is in resonance with it.

    Wave by wave that of `schemes.oscillator.settled`, with Y = kappa^2/D h; waves that are rounding are left out.
    """
    road, kinds = state[0], speed.size
    least = 1e-14 * highest_of(road, 0)
    for i in range(kinds):
        for m in range(k.size):
            kappa = k[m] * speed[i] / frequency[i]
            denominator = 1 - kappa**2 + 2j * damping[i] * kappa
            if abs(road[m]) > least:
                if abs(denominator) < 1e-9:
                    return False
                state[1 + i, m] = kappa**2 / denominator * road[m]
                state[1 + kinds + i, m] = 1j * frequency[i] * kappa / denominator * road[m]
        state[1 + kinds + i, 0] -= sink_rate  # the road sinks steadily under the car
    return True


@njit(**COMPILE)
def moving(state, square, sink_rate):
    """Whether a wave of `state` (size, modes) lifts cars off the road all by itself; if not, the numbers of those that are
    there at all: a profile of one wave has no other, and the mean counts where cars do not rest on a road that sinks.

    square: omega^2 of each kind, (kinds,).
    """
    count, found = 0, np.zeros(state.shape[1], np.int64)
    for m in range(state.shape[1]):
        for i in range(square.size):
            if square[i] * abs(state[1 + i, m]) >= 1.0:
                return True, found[:0]
        for i in range(0 if m > 0 else 1, state.shape[0]):
            if state[i, m] != (-sink_rate if m == 0 and i > square.size else 0.0):
                found[count] = m
                count += 1
                break
    return False, found[:count]


@njit(**COMPILE)
def keep_contact(state, sink_rate, square, moving, rate, shape, inverse, duration):
    """Whether cars are sure to stay in contact for `duration`, by those waves of `state` (1 + 2 kinds, modes) that move.

    moving: their numbers; rate, shape, inverse: their `schemes.exponential.eigenvectors`.
    """
    size, kinds = state.shape[0], square.size
    kept, share, limit = np.empty((size, moving.size), np.complex128), np.empty(moving.size), np.empty(kinds)
    for i in range(kinds):
        limit[i] = 1 / square[i]
    for n in range(moving.size):
        mean = moving[n] == 0  # about cars at rest on a road that sinks
        share[n] = 1.0 if mean else 2.0
        for i in range(size):
            kept[i, n] = state[i, moving[n]] + (sink_rate if mean and i > kinds else 0.0)
        if mean:
            kept[0, n] = 0.0
    return stays_below(limit, rate, shape, inverse, kept, share, 1, duration)


@njit(**COMPILE)
def leap(state, full, rest, record):
    """`state` (size, modes) `schemes.exponential.exact` steps `full` on, while the remainder is `rest`, of the mean.

    After each step the first rows of the state go into record (steps, rows, modes).
    """
    size, modes = state.shape
    for n in range(record.shape[0]):
        after = np.zeros_like(state)
        for i in range(size):
            for j in range(size):
                for m in range(modes):
                    after[i, m] += full[i, j, m] * state[j, m]
            after[i, 0] += full[i, size, 0] * rest
        for i in range(record.shape[1]):
            for m in range(modes):
                record[n, i, m] = after[i, m]
        state = after
    return state


@njit(**COMPILE)
def fields(values, square, share, weight, lift_off):
    """Road height, mean car height and mean force on the nodes, (3, times, nodes), from `values`, H and Y (times, 1 + kinds,
    nodes)."""
    times, nodes = values.shape[0], values.shape[2]
    out = np.zeros((3, times, nodes))
    for n in range(times):
        height, car, force = out[0, n], out[1, n], out[2, n]
        for j in range(nodes):
            height[j] = car[j] = values[n, 0, j]
        for i in range(weight.size):
            for j in range(nodes):
                car[j] += share[i] * values[n, 1 + i, j]
                load = 1.0 - square[i] * values[n, 1 + i, j]
                force[j] += weight[i] * (0.0 if lift_off and load < 0.0 else load)
    return out


@njit(**COMPILE)
def fields_of(states, nodes, square, share, weight, lift_off):
    """The same of H and Y as waves, (times, 1 + kinds, modes), on few nodes."""
    return fields(on_nodes(states, nodes), square, share, weight, lift_off)


@njit(**COMPILE)
def left_by_rounding(wave, begin, system, time):
    """Root mean square error of `wave` (modes,), the road at `time` by one exponential of `system` for each of its waves.

    begin: the state at the start, (size, modes). Waves that the profile has not are nothing but rounding, grown. The others
    begin with the profile's, relative to them, and the exponential of L t is off as if L were by a rounding of its norm,
    which acts on a car's state, too.
    """
    highest = highest_of(begin[0], 1)
    total = 0.0
    for m in range(1, wave.size):
        first, error = abs(begin[0, m]), abs(wave[m])
        if first > 1e-14 * highest:
            norm = state = 0.0
            for i in range(begin.shape[0]):
                norm = max(norm, np.abs(system[m, i]).sum())
                state += abs(begin[i, m]) ** 2
            error *= min(1.0, EPS * (highest + time * norm * math.sqrt(state)) / first)
        total += error**2
    return math.sqrt(2 * total)


@njit(**COMPILE)
def grown_from(heights, modes, base):
    """Root mean square of the waves of a road on few nodes whose numbers are no multiples of `base`."""
    series, total = on_waves(heights, modes), 0.0
    for m in range(modes):
        if m % base != 0:
            total += series[0, m] ** 2 + series[1, m] ** 2
    return math.sqrt(2 * total)


@njit(**COMPILE)
def apart(heights, other):
    """Root mean square difference of two roads of one ring on few nodes each, mean removed; `heights` has as many or more."""
    series, less = on_waves(heights, heights.size // 2 + 1), on_waves(other, other.size // 2 + 1)
    total = 0.0
    for m in range(1, series.shape[1]):
        a, b = series[0, m], series[1, m]
        if m < less.shape[1]:
            a, b = a - less[0, m], b - less[1, m]
        total += a**2 + b**2
    return math.sqrt(2 * total)


@njit(**COMPILE)
def left_on_few(heights, begin, system, time):
    """`left_by_rounding` of road heights on few nodes, (nodes,)."""
    series, wave = on_waves(heights, begin.shape[1]), np.empty(begin.shape[1], np.complex128)
    for m in range(wave.size):
        wave[m] = complex(series[0, m], series[1, m])
    return left_by_rounding(wave, begin, system, time)
