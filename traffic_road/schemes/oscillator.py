"""How a car crosses the interval between two road nodes: exactly, for a road that is a polynomial under it.

Following the car, Z' = P - 2 Gamma omega (Z - h), P' = -omega^2 (Z - h). Between nodes j and j+1 the contact height h is
the polynomial of degree p through the contact heights at j+1, j, ..., j+1-p (the hold: p = 1, 3, 5), so that

    (Z, P)_{j+1} = A (Z, P)_j + sum_q B[:, q] h_{j+1-q},    q = 0..p

with A and B from one matrix exponential of the oscillator augmented with the polynomial (Van Loan 1978; Nigam and
Jennings 1969 for p = 1). Order p + 1 in the spacing; no stability limit for a given road, and 4 + 2(p+1) multiply-adds.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from ..errors import SceneError

HOLDS = (1, 3, 5)


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
    exact = expm(system)
    # h(theta) = sum_r c_r theta^r / r! through theta = 1, 0, -1, ...; c from the heights by the inverse of this matrix
    theta = 1.0 - np.arange(size)
    factorial = np.cumprod(np.concatenate(([1.0], np.arange(1.0, size))))
    powers = theta[:, None] ** np.arange(size) / factorial
    # the chain runs y_r' = y_{r+1}: its initial values are the derivatives of h at theta = 0, the c_r themselves
    return exact[..., :2, :2], exact[..., :2, 2:] @ np.linalg.inv(powers)


def least_response(A: np.ndarray, B: np.ndarray, phase) -> np.ndarray:
    """The least real part of (h - Z)/h of the discrete car over the grid's waves well above its resonance; shape (...).

    `phase` (...) is omega dx/u. A true car presses every such wave down, Re R(ik) > 0; a grid on which it would pull one
    up makes that wave grow. Waves from k = 1.5 omega/u (where R cannot be mistaken) to the shortest, two nodes long.
    """
    phase = np.asarray(phase, dtype=float)
    share = np.linspace(0.0, 1.0, 33)
    low = np.minimum(1.5 * phase, np.pi)
    turn = np.exp(1j * (low[..., None] + share * (np.pi - low[..., None])))
    # h_j = turn^j and Z_j = Z turn^j: (turn - A) (Z, P) = sum_q B_q turn^(1 - q)
    forcing = (B[..., None, :, :] * turn[..., None, None] ** (1 - np.arange(B.shape[-1]))).sum(axis=-1)
    state = np.linalg.solve(turn[..., None, None] * np.eye(2) - A[..., None, :, :], forcing[..., None])
    return (1.0 - state[..., 0, 0]).real.min(axis=-1)


def settled(road_height, length: float, speed: float, frequency: float, damping: float, sink_rate: float):
    """Car height and P, the periodic forced response to a frozen road, as functions of position: each (nodes,).

    Wave by wave, with kappa = k u / omega: Z = (1 + 2i Gamma kappa)/D h and P = i omega kappa / D h,
    D = 1 - kappa^2 + 2i Gamma kappa. P has the mean -sink_rate: the road sinks steadily under the car.
    SceneError where an undamped car meets a wave at resonance.
    """
    nodes = len(road_height)
    wave = np.fft.rfft(road_height)
    kappa = 2 * np.pi * np.fft.rfftfreq(nodes, length / nodes) * speed / frequency
    denominator = 1 - kappa**2 + 2j * damping * kappa
    present = np.abs(wave) > 1e-14 * np.abs(wave).max()
    resonant = present & (np.abs(denominator) < 1e-9)
    if np.any(resonant):
        raise SceneError(
            f"Fleet.damping = {damping:g}: an undamped car of speed {speed:g} and frequency {frequency:g} has no settled "
            f"response to the road's wavenumber {frequency / speed:g}; use damping > 0 or start='rest'"
        )
    response = np.where(present, wave / np.where(resonant | ~present, 1.0, denominator), 0.0)
    height = np.fft.irfft((1 + 2j * damping * kappa) * response, n=nodes)
    momentum = np.fft.irfft(1j * frequency * kappa * response, n=nodes)
    return height, momentum - sink_rate
