"""How a car crosses the interval between two road nodes: exactly, for a road that is a polynomial under it.

Following the car, Z' = P - 2 Gamma omega (Z - h), P' = -omega^2 (Z - h). Between nodes j and j+1 the contact height h is
the polynomial of degree p through the contact heights at j+1, j, ..., j+1-p (the hold: p = 1, 3, 5), so that

    (Z, P)_{j+1} = A (Z, P)_j + sum_q B[:, q] h_{j+1-q},    q = 0..p

with A and B from one matrix exponential of the oscillator augmented with the polynomial (Van Loan 1978; Nigam and
Jennings 1969 for p = 1). Order p + 1 in the spacing; no stability limit for a given road, and 4 + 2(p+1) multiply-adds.
"""

from __future__ import annotations

import numpy as np

from ..errors import SceneError

HOLDS = (1, 3, 5)
TAYLOR = 14  # terms: 0.5^15/15! = 2e-17
MOST_TERMS = 1 << 20  # of a sum over cars and waves, held at once


def propagator(interval, frequency, damping, hold: int) -> tuple[np.ndarray, np.ndarray]:
    """A (..., 2, 2) and B (..., 2, hold + 1) for the time `interval` between nodes; arguments broadcast."""
    interval, omega, damping = np.broadcast_arrays(*np.atleast_1d(interval, frequency, damping))
    size = hold + 1
    # augmented state: Z, P, then the scaled powers theta^r / r! of theta = t / interval, each the derivative of the next
    system = np.zeros((*omega.shape, 2 + size, 2 + size))
    system[..., 0, 0] = -2 * damping * omega
    system[..., 0, 1] = 1.0
    system[..., 1, 0] = -(omega**2)
    system[..., 0, 2] = 2 * damping * omega
    system[..., 1, 2] = omega**2
    system *= interval[..., None, None]
    r = np.arange(size - 1)
    system[..., 2 + r, 3 + r] = 1.0
    exact = exponential(system)
    # h(theta) = sum_r c_r theta^r / r! through theta = 1, 0, -1, ...; c from the heights by the inverse of this matrix
    theta = 1.0 - np.arange(size)
    factorial = np.cumprod(np.concatenate(([1.0], np.arange(1.0, size))))
    powers = theta[:, None] ** np.arange(size) / factorial
    # the chain runs y_r' = y_{r+1}: its initial values are the derivatives of h at theta = 0, the c_r themselves
    return exact[..., :2, :2], exact[..., :2, 2:] @ np.linalg.inv(powers)


def exponential(systems: np.ndarray) -> np.ndarray:
    """exp of matrices (..., n, n), all at once: Taylor's polynomial, to rounding where the norm is 1/2, and squarings.

    Not scipy's, whose linear solver wakes the threads of its BLAS: they spin for a tenth of a second beside the run.
    """
    norm = np.abs(systems).sum(axis=-1).max(axis=-1)
    squarings = np.ceil(np.log2(np.maximum(norm, 0.5))).astype(int) + 1
    exact = np.empty_like(systems)
    for times in np.unique(squarings):
        mine = squarings == times
        scaled = systems[mine] / 2.0**times
        one = exponent = np.eye(systems.shape[-1])
        for n in range(TAYLOR, 0, -1):
            exponent = one + scaled @ exponent / n
        for _ in range(times):
            exponent = exponent @ exponent
        exact[mine] = exponent
    return exact


def least_response(A: np.ndarray, B: np.ndarray, phase) -> np.ndarray:
    """The least real part of (h - Z)/h of the discrete car over the grid's waves well above its resonance; shape (...).

    `phase` (...) is omega dx/u. A true car presses every such wave down, Re R(ik) > 0; a grid on which it would pull one
    up makes that wave grow. Waves from k = 1.5 omega/u (where R cannot be mistaken) to the shortest, two nodes long.
    """
    phase = np.asarray(phase, dtype=float)
    share = np.linspace(0.0, 1.0, 33)
    low = np.minimum(1.5 * phase, np.pi)
    turn = np.exp(1j * (low[..., None] + share * (np.pi - low[..., None])))
    # h_j = turn^j and Z_j = Z turn^j: (turn - A) (Z, P) = (z, p) = sum_q B_q turn^(1 - q)
    z = p = 0.0
    for q in reversed(range(B.shape[-1])):
        z, p = (B[..., row, q, None] + turn.conj() * later for row, later in ((0, z), (1, p)))
    a00, a01, a10, a11 = (A[..., row, column, None] for row in (0, 1) for column in (0, 1))
    Z = turn * ((turn - a11) * z + a01 * p) / ((turn - a00) * (turn - a11) - a01 * a10)
    return (1.0 - Z).real.min(axis=-1)


def settled(road_height, length: float, speed: float, frequency: float, damping: float, sink_rate: float):
    """Car height and P, the periodic forced response to a frozen road, as functions of position: each (nodes,).

    Wave by wave, with kappa = k u / omega: Z = (1 + 2i Gamma kappa)/D h and P = i omega kappa / D h,
    D = 1 - kappa^2 + 2i Gamma kappa. P has the mean -sink_rate: the road sinks steadily under the car.
    SceneError where an undamped car meets a wave at resonance.
    """
    nodes = len(road_height)
    wave, number = _waves(road_height)
    height, momentum = np.zeros((2, nodes // 2 + 1), dtype=complex)
    height[number], momentum[number] = settled_waves(wave, number, length, speed, frequency, damping)
    return np.fft.irfft(height, n=nodes), np.fft.irfft(momentum, n=nodes) - sink_rate


def settled_at(node, road_height, length: float, speed, frequency, damping, sink_rate: float):
    """`settled` of cars that may all differ, each at its own node only: node, speed, frequency, damping (cars,).

    A sum over the waves that the road has; where these are many and the cars alike, `settled` costs less.
    """
    nodes = len(road_height)
    wave, number = _waves(road_height)
    weight = np.where((number == 0) | (2 * number == nodes), 1.0, 2.0) / nodes  # of waves that have no mirror image, 1
    turn = np.exp(2j * np.pi / nodes * np.arange(nodes))
    height, momentum = np.empty((2, len(node)))
    at_once = MOST_TERMS // max(1, number.size) + 1
    for first in range(0, len(node), at_once):
        some = slice(first, first + at_once)
        Z, P = settled_waves(
            wave * weight, number, length, speed[some, None], frequency[some, None], damping[some, None]
        )
        phase = turn[node[some, None] * number % nodes]
        height[some], momentum[some] = (Z * phase).real.sum(axis=1), (P * phase).real.sum(axis=1)
    return height, momentum - sink_rate


def wave_count(road_height) -> int:
    """How many waves, of those that the grid holds, the road has."""
    return _waves(road_height)[1].size


def _waves(road_height):
    """The waves that are more than rounding, and their numbers, periods a length."""
    wave = np.fft.rfft(road_height)
    (number,) = np.nonzero(np.abs(wave) > 1e-14 * np.abs(wave).max())
    return wave[number], number


def settled_waves(wave, number, length, speed, frequency, damping):
    """Waves of Z, and of P less its mean, over the `wave` (waves,) of a road; the others are numbers or (cars, 1).

    SceneError where an undamped car meets a wave at resonance.
    """
    kappa = 2 * np.pi / length * number * speed / frequency
    denominator = 1 - kappa**2 + 2j * damping * kappa
    resonant = np.abs(denominator) < 1e-9
    if np.any(resonant):
        car = np.argwhere(np.atleast_2d(resonant))[0, 0]
        speed, frequency, damping = (float(np.ravel(values)[car]) for values in (speed, frequency, damping))
        raise SceneError(
            f"Fleet.damping = {damping:g}: an undamped car of speed {speed:g} and frequency {frequency:g} has no settled "
            f"response to the road's wavenumber {frequency / speed:g}; use damping > 0 or start='rest'"
        )
    response = wave / denominator
    return (1 + 2j * damping * kappa) * response, 1j * frequency * kappa * response
