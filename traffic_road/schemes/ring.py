"""A ring road with an even fleet as a plain numpy loop: any stepper, passage and relaxation together, for the study.

The cars model is faster and takes any fleet; here every piece can be exchanged for a worse one. Speed 1, constant softness,
relaxation once a headway. All arrays may carry further axes: a whole chart of parameters runs at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .passage import midpoint


class Ring(NamedTuple):
    """`cars` blocks of `rows` nodes; the rest as in `schemes`. Trailing axes ... of the arrays: runs side by side."""

    cars: int
    rows: int
    A: np.ndarray  # (2, 2, ...)
    B: np.ndarray  # (2, hold + 1, ...)
    push: float | np.ndarray  # delta m, (...)
    passage: Callable = midpoint
    factor: np.ndarray | None = None  # of one relaxation, (cars * rows // 2 + 1, ...)
    frequency: float = 1.0

    def headway(self, road, state, weight=1.0, lift_off=False):
        """One headway on: road (cars, rows, ...) and state (2 + hold, cars, ...), rows Z, P, contact heights, newest first.

        weight = 0: the perturbation of a sinking road, without the sinking.
        """
        road, (Z, P, *past) = road.copy(), state
        A, B, omega2 = self.A, self.B, self.frequency**2
        for r in range(self.rows):
            z_star, p_star = A[0, 0] * Z, A[1, 0] * Z
            term = np.empty_like(z_star)  # in place: new arrays at every step cost more than the sums
            for weights, values in zip((A[:, 1], *B.swapaxes(0, 1)[1:]), (P, *past), strict=True):
                z_star += np.multiply(weights[0], values, out=term)
                p_star += np.multiply(weights[1], values, out=term)
            before = road[:, r].copy()
            contact, road[:, r] = self.passage(before, z_star, B[0, 0], self.push, omega2, weight, lift_off)
            z_star += np.multiply(B[0, 0], contact, out=term)
            p_star += np.multiply(B[1, 0], contact, out=term)
            Z, P = z_star, p_star
            past = [contact, *past[:-1]]
        if self.factor is not None:
            nodes = self.cars * self.rows
            wave = np.fft.rfft(road.reshape(nodes, *road.shape[2:]), axis=0)
            road = np.fft.irfft(self.factor * wave, n=nodes, axis=0).reshape(road.shape)
        # the car that enters a block next comes from the block behind
        return road, np.roll([Z, P, *past], 1, axis=1)

    def matrix(self) -> np.ndarray:
        """One headway as a matrix (..., size, size) on (road, Z, P, past), without lift-off."""
        nodes, held = self.cars * self.rows, 2 + self.B.shape[1] - 1
        runs = np.broadcast_shapes(self.A.shape[2:], np.shape(self.push))
        size = nodes + held * self.cars
        unit = np.eye(size).reshape(size, size, *(1 for _ in runs)) * np.ones(runs)
        inner = self._replace(
            A=self.A[:, :, None], B=self.B[:, :, None], factor=None if self.factor is None else self.factor[:, None]
        )
        road, state = inner.headway(
            unit[:nodes].reshape(self.cars, self.rows, size, *runs),
            unit[nodes:].reshape(held, self.cars, size, *runs),
            weight=0.0,
        )
        whole = np.concatenate((road.reshape(nodes, size, *runs), state.reshape(-1, size, *runs)))
        return np.moveaxis(whole, (0, 1), (-2, -1))

    def radius(self) -> np.ndarray:
        """Spectral radius of one headway, the eigenvalue 1 of a road raised with its cars left out; shape (...)."""
        matrix = self.matrix()
        bad = ~np.isfinite(matrix).all(axis=(-2, -1))
        values = np.linalg.eigvals(np.where(bad[..., None, None], 0.0, matrix))
        raised = np.abs(values - 1).argmin(axis=-1)[..., None]
        np.put_along_axis(values, raised, 0.0, axis=-1)
        return np.where(bad, np.inf, np.abs(values).max(axis=-1))

    def grows(self, headways: int, seed: int = 0) -> np.ndarray:
        """Whether a rough perturbation of size 1 is larger, by a tenth, at the end of a run than half way; (...)."""
        runs = np.broadcast_shapes(self.A.shape[2:], np.shape(self.push))
        rng = np.random.default_rng(seed)
        road = rng.standard_normal((self.cars, self.rows, *(1 for _ in runs))) * np.ones(runs)
        road -= road.mean(axis=(0, 1))
        state = np.zeros((2 + self.B.shape[1] - 1, self.cars, *runs))
        window = max(1, headways // 10)
        half, last = np.zeros(runs), np.zeros(runs)
        with np.errstate(over="ignore", invalid="ignore"):
            for n in range(headways):
                road, state = self.headway(road, state, weight=0.0)
                if n >= headways - window or headways // 2 - window <= n < headways // 2:
                    ripple = np.abs(road - road.mean(axis=(0, 1))).max(axis=(0, 1))
                    size = np.maximum(ripple, np.abs(state[0] - state[2]).max(axis=0))
                    if n >= headways - window:
                        last = np.maximum(last, size)
                    else:
                        half = np.maximum(half, size)
        # a perturbation that has died away is rounding, of which the one half may exceed the other
        return ~np.isfinite(last) | (last > 1.1 * half) & (last > 1e-10)


def threshold(grows: Callable, low, high, ways: int = 64, rounds: int = 2) -> np.ndarray:
    """Where `grows` first turns true between low and high, (cases,), within (high/low)^(1/ways^rounds); inf where never.

    grows(x) takes x (ways, cases) > 0 and gives as many booleans. The whole range is tried, not its halves: an island of
    growth below the limit would be found.
    """
    low, high = np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float)
    never = np.zeros(low.shape, dtype=bool)
    for _ in range(rounds):
        x = low * (high / low) ** (np.arange(ways + 1)[:, None] / ways)
        grown = grows(x[1:])
        never |= ~grown.any(axis=0)
        first = np.argmax(grown, axis=0)[None]
        low, high = (np.take_along_axis(x, first + n, axis=0)[0] for n in (0, 1))
    return np.where(never, np.inf, np.sqrt(low * high))
