"""A step of u' = L u + b N(u): the stiff linear L exactly, the remainder N, one number a system, to order 4.

Within a stage N is a polynomial in time, and the linear system under a polynomial is solved exactly, by one matrix
exponential of L augmented with the chain 1, theta, theta^2/2 (Al-Mohy and Higham, SIAM J. Sci. Comput. 33, 488, 2011):
no eigenvectors, so that an exceptional point of L does no harm. Stages and weights: Krogstad, J. Comput. Phys. 203, 72,
2005 (ETDRK4-B). Four remainders a step; exact for constant N, order 4 for smooth N, less where N has kinks in time.
No stability limit from L. Of a fast decay rate, N may take back all or add two thirds: N = -theta L u is stable for
-2/3 <= theta <= 1 at any step.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from ..compiled import njit

DEGREE = 18  # of the Taylor polynomial for norms up to 1: 1/19! is below rounding
LOOK = 0.5  # how far `stays_below` looks ahead at a time, and how often
MOST_LOOKS = 100
SAFE = 0.1  # step times the rate at which N acts, below which no step of cars has been found to grow
SMALL = 16  # size up to which plain loops beat a call of the library for every matrix

# stage s: over half a step (s = 0, 1) or the step (2, 3) from its start, N = sum_p theta^p/p! sum_r POLYNOMIAL[s, p, r] N_r
# with N_0 at the start and N_r at the end of stage r - 1; stage 3 ends where the step does
POLYNOMIAL = np.array(
    [
        [[1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
        [[1, 0, 0, 0], [-2, 2, 0, 0], [0, 0, 0, 0]],
        [[1, 0, 0, 0], [-2, 0, 2, 0], [0, 0, 0, 0]],
        [[1, 0, 0, 0], [-3, 2, 2, -1], [4, -4, -4, 4]],
    ],
    dtype=float,
)


def exact(system: np.ndarray, source: np.ndarray, step: float) -> np.ndarray:
    """The map over `step` of (u, N, step N', step^2 N'') at its start to u at its end, (size, size + 3, systems).

    `system` (systems, size, size) is L, `source` (size,) is b, the direction in which the remainder acts.
    """
    augmented = _augmented(system, source, step)
    exponential = exponentials(augmented) if augmented.shape[1] <= SMALL else expm(augmented)
    return _systems_last(exponential, system.shape[1])


@njit(cache=True, error_model="numpy")
def _augmented(system, source, step):
    systems, size = system.shape[:2]
    augmented = np.zeros((systems, size + 3, size + 3), dtype=system.dtype)
    for s in range(systems):
        for i in range(size):
            for j in range(size):
                augmented[s, i, j] = step * system[s, i, j]
            augmented[s, i, size] = step * source[i]
        augmented[s, size, size + 1] = augmented[s, size + 1, size + 2] = 1.0
    return augmented


@njit(cache=True, error_model="numpy")
def _systems_last(matrices, rows):
    """The first `rows` of matrices (systems, size, size) as (rows, size, systems)."""
    systems, size = matrices.shape[:2]
    turned = np.empty((rows, size, systems), dtype=matrices.dtype)
    for i in range(rows):
        for j in range(size):
            for s in range(systems):
                turned[i, j, s] = matrices[s, i, j]
    return turned


@njit(cache=True, error_model="numpy")
def doubled(half):
    """`exact` over twice the step: the map applied twice, to the same polynomial of N seen from the start and from midway."""
    size, columns, systems = half.shape
    full = np.zeros_like(half)
    for i in range(size):
        for j in range(columns):
            share = 0.5 ** max(0, j - size)
            for k in range(size):
                for s in range(systems):
                    full[i, j, s] += share * half[i, k, s] * half[k, j, s]
        for s in range(systems):  # N, its slope and its bend midway, of those at the start
            full[i, size, s] += half[i, size, s]
            full[i, size + 1, s] += 0.5 * half[i, size, s] + 0.5 * half[i, size + 1, s]
            full[i, size + 2, s] += 0.125 * half[i, size, s] + 0.25 * (half[i, size + 1, s] + half[i, size + 2, s])
    return full


@njit(cache=True, error_model="numpy")
def exponentials(matrices):
    """Matrix exponentials (systems, size, size): Taylor's polynomial of the matrix scaled to norm 1, then squarings."""
    size = matrices.shape[1]
    result = np.empty_like(matrices)
    product, scaled = np.empty_like(matrices[0]), np.empty_like(matrices[0])
    for s in range(matrices.shape[0]):
        norm = 0.0
        for i in range(size):
            row = 0.0
            for j in range(size):
                row += abs(matrices[s, i, j])
            norm = max(norm, row)
        if not norm < 1e300:  # infinite or NaN
            result[s] = np.nan
            continue
        squarings = max(0, math.ceil(math.log2(norm))) if norm > 0.0 else 0
        power = result[s]
        for i in range(size):
            for j in range(size):
                scaled[i, j] = matrices[s, i, j] * 0.5**squarings
                power[i, j] = 1.0 if i == j else 0.0
        for degree in range(DEGREE, 0, -1):  # Horner: I + A/1 (I + A/2 (I + ...))
            _multiply(scaled, power, product)
            for i in range(size):
                for j in range(size):
                    power[i, j] = product[i, j] * (1.0 / degree)
                power[i, i] += 1.0
        for _ in range(squarings):
            _multiply(power, power, product)
            for i in range(size):  # numba compiles power[:] = product for seconds
                for j in range(size):
                    power[i, j] = product[i, j]
    return result


@njit(cache=True, error_model="numpy")
def _multiply(a, b, product):
    size = len(a)
    for i in range(size):
        for j in range(size):
            product[i, j] = 0.0
        for k in range(size):
            factor = a[i, k]
            if factor == 0.0:  # the chain never comes back to u
                continue
            for j in range(size):
                product[i, j] += factor * b[k, j]


def eigenvectors(system: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues (systems, size), eigenvectors and the inverse of their matrix; NaN where there is none."""
    try:
        return _eigenvectors(system)
    except (np.linalg.LinAlgError, ValueError):
        lost = np.full(system.shape, np.nan + 0j)
        return lost[..., 0], lost, lost


@njit(cache=True, error_model="numpy")
def _eigenvectors(system):
    rate, shape, inverse = np.empty(system.shape[:2], system.dtype), np.empty_like(system), np.empty_like(system)
    size = system.shape[1]
    for s in range(len(system)):
        values, vectors = np.linalg.eig(system[s])
        back = np.linalg.inv(vectors)
        for i in range(size):
            rate[s, i] = values[i]
            for j in range(size):
                shape[s, i, j], inverse[s, i, j] = vectors[i, j], back[i, j]
    return rate, shape, inverse


def stays_below(limit: np.ndarray, eigen: tuple, u: np.ndarray, rows: slice, duration: float) -> bool:
    """Whether u' = L u keeps real Fourier series below `limit` (rows,) for `duration`, wherever one looks on the ring.

    u (size, systems) holds waves 0, 1, ... of the series; `eigen`: `eigenvectors` of L. A wave is a sum of exponentials of
    time, so that its amplitude is never above the sum of their largest sizes, and the series never above the sum over its
    waves. That may say too little as long as the exponentials cancel: then one looks ahead a little, by the rate at
    which their phases part, and asks again. Where eigenvectors nearly coincide this finds no bound, never a false one.
    """
    rate, shape, inverse = eigen
    term = shape[:, rows] * (inverse @ u.T[..., None]).swapaxes(1, 2)
    return _stays_below(limit * (1 - 1e-6), rate, term, duration)  # rounding


@njit(cache=True, error_model="numpy")
def _stays_below(limit, rate, term, duration):
    """The same of exponentials `term` (systems, rows, size) that move at the `rate` (systems, size); changes `term`."""
    for _ in range(MOST_LOOKS):
        below = within_reach = True
        for row in range(limit.size):
            largest = reach = 0.0
            for s in range(rate.shape[0]):
                count = 2.0 if s > 0 else 1.0  # a wave and its conjugate
                some, total, main, parting = term[s, row], 0j, 0, 0.0
                for j in range(some.size):
                    size = abs(some[j])
                    largest += count * size * math.exp(max(rate[s, j].real, 0.0) * duration)
                    total += some[j]
                    main = j if size > abs(some[main]) else main
                for j in range(some.size):
                    apart = rate[s, j] - rate[s, main]
                    parting += abs(some[j] * apart) * math.exp(max(apart.real, 0.0) * LOOK)
                    some[j] *= np.exp(rate[s, j] * LOOK)
                reach += count * (abs(total) + LOOK * parting) * math.exp(max(rate[s, main].real, 0.0) * LOOK)
            below &= largest < limit[row]
            within_reach &= reach < limit[row]
        duration -= LOOK
        if below or (within_reach and duration <= 0):
            return True
        if not within_reach:
            return False
    return False


def krogstad(u: np.ndarray, remainder, half: np.ndarray, full: np.ndarray) -> np.ndarray:
    """u (size, systems) one step on; remainder(u) is (systems,), `half`, `full`: `exact` for half a step and a step."""
    rates = np.zeros((4, u.shape[1]), dtype=u.dtype)
    stage = u
    for s, propagator in enumerate((half, half, full, full)):
        rates[s] = remainder(stage)
        stage = np.einsum("ijk,jk->ik", propagator, np.concatenate((u, POLYNOMIAL[s] @ rates)))
    return stage


def amplification(system: np.ndarray, source: np.ndarray, row: np.ndarray, step: float) -> np.ndarray:
    """What a step does to u where N = row u, row (systems, size): matrices (systems, size, size)."""
    half = exact(system, source, step / 2)
    full = doubled(half)
    each = np.eye(source.size, dtype=complex)[:, :, None] * np.ones(len(system))
    return np.stack([krogstad(u, lambda u: (row.T * u).sum(axis=0), half, full) for u in each]).transpose(2, 1, 0)


def step_limit(system: np.ndarray, source: np.ndarray, row: np.ndarray, longest: float) -> float:
    """The step from which on N = row u makes a system grow that u' = (L + b row) u does not, or grow twice as fast as that
    does; inf if not below `longest`.

    Looked for from far below, since beyond its limit a step may be stable again for a while.
    """
    rate = np.abs(row @ source).max(initial=0.0)
    if rate == 0:
        return np.inf
    growth = np.maximum(0.0, np.linalg.eigvals(system + source[:, None] * row[:, None, :]).real.max(axis=1))

    def grows(step):
        size = np.abs(np.linalg.eigvals(amplification(system, source, row, step))).max(axis=1)
        return np.any(np.log(size) > 2 * growth * step + 1e-9)

    low = high = SAFE / rate
    while not grows(high):
        if high > longest:
            return np.inf
        low, high = high, 1.05 * high
    while high - low > 1e-4 * low:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low
