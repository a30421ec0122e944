"""The continuum as others would compute it: one wave by a matrix exponential, all by solve_ivp on nodes; for work_precision."""

from time import process_time

import numpy as np
from discrete_ring import best
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from traffic_road.schemes.oscillator import settled

LIMIT = 0.3  # seconds after which a run of solve_ivp is given up


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


def by_solve_ivp(case, method, nodes, rtol, limit=LIMIT):
    """CPU seconds, the road at the end and the calls of the right-hand side; the road None where it takes too long."""
    length, law, damping = case.road.length, case.road.softness, case.fleet.damping
    wave = 2j * np.pi / length * np.arange(nodes // 2 + 1)
    weights = np.array([(wave**2).real * case.road.diffusivity.value, -wave, -wave])
    if nodes % 2 == 0:
        weights[1:, -1] = 0.0
    of_nodes = np.fft.irfft(np.fft.rfft(np.eye(nodes)) * weights[:, None], nodes).copy()
    _, value, shape = law.kernel
    calls, end = 0, np.inf

    def rhs(t, state):
        nonlocal calls
        calls += 1
        if process_time() > end:
            raise TooLong
        y = state.reshape(3, nodes)
        # on few nodes a matrix differentiates faster than a transform
        out = np.matmul(y[:, None], of_nodes)[:, 0] if nodes <= 64 else np.fft.irfft(np.fft.rfft(y) * weights, nodes)
        compression = y[0] - y[1]
        out[0] -= (value * np.exp(shape * y[0]) if shape else value) * np.maximum(0.0, 1.0 + compression)
        out[1] += y[2] + 2 * damping * compression
        out[2] += compression
        return out.ravel()

    height = case.road.profile.sample(length, nodes)
    start = np.concatenate((height, *settled(height, length, 1.0, 1.0, damping, float(law(height.mean())))))
    atol = 0.1 * rtol * np.abs(height).max()

    def call():
        nonlocal calls, end
        calls, end = 0, process_time() + limit
        return solve_ivp(rhs, (0.0, case.duration), start, method=method, t_eval=[case.duration], rtol=rtol, atol=atol)

    try:
        with np.errstate(all="ignore"):  # of steps that are refused
            seconds, result = best(call, 5) if limit < np.inf else (np.nan, call())
    except TooLong:
        return np.nan, None, calls
    return seconds, result.y[:nodes, -1] if result.success else np.full(nodes, np.nan), calls
