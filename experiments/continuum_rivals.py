"""The continuum as others would compute it: one wave by a matrix exponential, all by solve_ivp on nodes.

For work_precision and continuum_speed.
"""

from time import process_time
from typing import NamedTuple

import numpy as np
from discrete_ring import best
from scipy import integrate
from scipy.linalg import expm

from traffic_road.schemes.oscillator import settled

METHODS = ("RK45", "DOP853", "LSODA", "BDF", "Radau")
EXPLICIT = ("RK45", "DOP853")  # their steps are set by stability, whatever the tolerance


def one_wave(case) -> np.ndarray:
    """The road at the end, on 64 nodes: H, Z, P of exp(ikx), always in contact, by one matrix exponential."""
    k, damping = 2 * np.pi / case.road.length, case.fleet.damping
    alpha, delta = case.road.softness.value, case.road.diffusivity.value
    system = np.array([[-delta * k**2 - alpha, alpha, 0], [2 * damping, -2 * damping - 1j * k, 1], [1, -1, -1j * k]])
    start = np.array(
        [1, (1 + 2j * damping * k) / (1 - k**2 + 2j * damping * k), 1j * k / (1 - k**2 + 2j * damping * k)]
    )
    wave = (expm(case.duration * system) @ start)[0]
    nodes = 64
    first = np.fft.rfft(case.road.profile.sample(case.road.length, nodes))
    first[1] *= wave
    return np.fft.irfft(first, n=nodes)


class TooLong(Exception):
    pass


class Solved(NamedTuple):
    roads: np.ndarray  # (times, nodes), NaN where the integrator gave up
    calls: int  # of the right-hand side, those for Jacobians included
    steps: int  # accepted
    reason: str  # why the integrator gave up, or ""


def solver(case, method: str, nodes: int, rtol: float, times=None):
    """A function that runs solve_ivp and returns Solved; TooLong once that takes its `limit`, seconds of CPU time.

    times: of the roads, by default the end; solve_ivp starts anew from each, so that no interpolant is looked at.
    """
    rhs, start = faster_right_hand_side(case, nodes), state_at_start(case, nodes)
    times = [case.duration] if times is None else times
    atol = 0.1 * rtol * np.abs(start[:nodes]).max()
    counts = {}

    class Counted(getattr(integrate, method)):
        def step(self):
            counts["steps"] += 1
            return super().step()

    def call(limit: float = np.inf) -> Solved:
        counts.update(calls=0, steps=0)
        end = process_time() + limit

        def watched(t, state):
            counts["calls"] += 1
            if process_time() > end:
                raise TooLong
            return rhs(t, state)

        now, state, roads = 0.0, start, []
        for time in times:
            with np.errstate(all="ignore"):  # of steps that are refused
                done = integrate.solve_ivp(watched, (now, time), state, Counted, [time], rtol=rtol, atol=atol)
            if not done.success:
                return Solved(np.full((1, nodes), np.nan), *counts.values(), done.message)
            now, state = time, done.y[:, -1]
            roads.append(state[:nodes])
        return Solved(np.array(roads), *counts.values(), "")

    return call


def state_at_start(case, nodes: int) -> np.ndarray:
    """H, Z and P of the settled start, (3 nodes,)."""
    length = case.road.length
    height = case.road.profile.sample(length, nodes)
    sink = float(case.road.softness(height.mean()))
    return np.concatenate((height, *settled(height, length, 1.0, 1.0, case.fleet.damping, sink)))


def faster_right_hand_side(case, nodes: int):
    """Of derivatives by transforms and by a matrix the faster."""
    state = state_at_start(case, nodes)
    both = [right_hand_side(case, nodes, by_matrix) for by_matrix in (False, True)]
    times = [best(lambda f=f: [f(0.0, state) for _ in range(20)], 5)[0] for f in both]
    return both[int(np.argmin(times))]


def right_hand_side(case, nodes: int, by_matrix: bool):
    wave = 2j * np.pi / case.road.length * np.arange(nodes // 2 + 1)
    weights = np.array([(wave**2).real * case.road.diffusivity.value, -wave, -wave])
    if nodes % 2 == 0:
        weights[1:, -1] = 0.0
    # row j: derivative of node j's peak
    of_nodes = np.fft.irfft(np.fft.rfft(np.eye(nodes)) * weights[:, None], nodes).copy()
    (_, value, shape), damping = case.road.softness.kernel, case.fleet.damping

    def rhs(t, state):
        y = state.reshape(3, nodes)
        out = np.matmul(y[:, None], of_nodes)[:, 0] if by_matrix else np.fft.irfft(np.fft.rfft(y) * weights, nodes)
        compression = y[0] - y[1]
        out[0] -= (value * np.exp(shape * y[0]) if shape else value) * np.maximum(0.0, 1.0 + compression)
        out[1] += y[2] + 2 * damping * compression
        out[2] += compression
        return out.ravel()

    return rhs
