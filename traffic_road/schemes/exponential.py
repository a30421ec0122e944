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
from numba import uint64

from ..compiled import njit

HALVED = 3  # Taylor's series is of norms up to 2^-HALVED,
DEGREE = 9  # and ends with this power: 8^-10/10! is about a rounding
INVERSE_FACTORIALS = np.array([1.0 / math.factorial(n) for n in range(DEGREE + 4)])
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
    systems, size = system.shape[:2]
    if size <= SMALL:
        return _solved(system, source, step, size + 3)
    from scipy.linalg import expm  # not at the top: 0.2 s, and every run would wait for it

    augmented = np.zeros((systems, size + 3, size + 3), dtype=system.dtype)
    augmented[:, :size, :size], augmented[:, :size, size] = step * system, step * source
    augmented[:, size, size + 1] = augmented[:, size + 1, size + 2] = 1.0
    return np.ascontiguousarray(expm(augmented)[:, :size].transpose(1, 2, 0))


def exponentials(matrices: np.ndarray) -> np.ndarray:
    """Matrix exponentials, (systems, size, size)."""
    size = matrices.shape[1]
    if size > SMALL:
        from scipy.linalg import expm  # as above

        return expm(matrices)
    return _solved(matrices, np.zeros(size), 1.0, size).transpose(2, 0, 1)


@njit(cache=True, error_model="numpy")
def _solved(system, source, step, columns):
    """The first `columns` of `exact`: Taylor's series of steps halved until the norm is at most 2^-HALVED, which then double.

    Column j < size is exp(L step) e_j, column size + p is phi_(p+1)(L step) b step; sum_n (L step)^n w/(n + q)! in either case,
    by Horner's rule. All systems side by side, real and imaginary parts apart.
    """
    systems, size = system.shape[:2]
    wide = (systems + 3) // 4 * 4  # so that loops over vectors leave no rest
    halvings = np.zeros(systems, np.int64)
    real, imag, scale = np.zeros((size, size, wide)), np.zeros((size, size, wide)), np.zeros(wide)
    for s in range(systems):
        norm = 0.0
        for i in range(size):
            row = 0.0
            for j in range(size):
                row += abs(step * system[s, i, j])
            norm = max(norm, row)
        if s > 0:  # the higher a wave, the larger its norm: so that those to be doubled are always the last ones
            halvings[s] = halvings[s - 1]
        if 0.0 < norm < 1e300:
            halvings[s] = max(halvings[s], math.ceil(math.log2(norm)) + HALVED)
        scale[s] = step * 0.5 ** halvings[s]
        for i in range(size):
            for j in range(size):
                real[i, j, s], imag[i, j, s] = scale[s] * system[s, i, j].real, scale[s] * system[s, i, j].imag
    result = np.zeros((2, size, columns, wide))
    now, new = np.zeros((2, 2, size, wide))
    for c in range(columns):
        q = max(0, c - size + 1)
        now[:] = 0.0
        for n in range(DEGREE, -1, -1):
            share = INVERSE_FACTORIALS[n + q]
            for i in range(size):
                to, too = new[0, i], new[1, i]
                if c < size:
                    to[:] = share if i == c else 0.0
                else:
                    by = share * source[i]
                    for s in range(uint64(wide)):
                        to[s] = by * scale[s]
                too[:] = 0.0
                for k in range(size):
                    a, b, x, y = real[i, k], imag[i, k], now[0, k], now[1, k]
                    for s in range(uint64(wide)):
                        to[s] += a[s] * x[s] - b[s] * y[s]
                        too[s] += a[s] * y[s] + b[s] * x[s]
            now, new = new, now
        for i in range(size):
            for s in range(uint64(systems)):
                result[0, i, c, s], result[1, i, c, s] = now[0, i, s], now[1, i, s]
    twice = np.empty_like(result)
    first = 0
    for n in range(halvings[-1]):
        while halvings[first] <= n:
            first += 1
        _double(result, twice, first)
        for i in range(size):
            for j in range(columns):
                for c in range(2):
                    for s in range(uint64(first), uint64(wide)):
                        result[c, i, j, s] = twice[c, i, j, s]
    return _joined(result, systems)


@njit(cache=True, error_model="numpy")
def _double(half, full, first):
    """full <- `half` (2, size, columns, systems) over twice the step, of systems from `first` on: the map applied twice, to
    the same polynomial of N seen from the start and from midway."""
    size, columns, systems = half.shape[1:]
    for i in range(size):
        for j in range(columns):
            to, too = full[0, i, j, first:], full[1, i, j, first:]
            share = 0.5 ** max(0, j - size)
            to[:] = 0.0
            too[:] = 0.0
            for k in range(size):
                a, b, x, y = half[0, i, k, first:], half[1, i, k, first:], half[0, k, j, first:], half[1, k, j, first:]
                for s in range(uint64(to.size)):
                    to[s] += share * (a[s] * x[s] - b[s] * y[s])
                    too[s] += share * (a[s] * y[s] + b[s] * x[s])
        for c in range(2):
            if columns > size:  # N, its slope and its bend midway, of those at the start
                for s in range(first, systems):
                    n, slope, bend = half[c, i, size, s], half[c, i, size + 1, s], half[c, i, size + 2, s]
                    full[c, i, size, s] += n
                    full[c, i, size + 1, s] += 0.5 * n + 0.5 * slope
                    full[c, i, size + 2, s] += 0.125 * n + 0.25 * (slope + bend)


@njit(cache=True, error_model="numpy")
def _joined(parts, systems):
    """Complex (rows, columns, systems) of their real and imaginary parts (2, rows, columns, systems or more)."""
    joined = np.empty((parts.shape[1], parts.shape[2], systems), np.complex128)
    for i in range(joined.shape[0]):
        for j in range(joined.shape[1]):
            for s in range(joined.shape[2]):
                joined[i, j, s] = complex(parts[0, i, j, s], parts[1, i, j, s])
    return joined


@njit(cache=True, error_model="numpy")
def doubled(half):
    """`exact` over twice the step."""
    parts = np.empty((2, *half.shape))
    for i in range(half.shape[0]):
        for j in range(half.shape[1]):
            for s in range(half.shape[2]):
                parts[0, i, j, s], parts[1, i, j, s] = half[i, j, s].real, half[i, j, s].imag
    full = np.empty_like(parts)
    _double(parts, full, 0)
    return _joined(full, half.shape[2])


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


@njit(cache=True, error_model="numpy")
def stays_below(limit, rate, shape, inverse, u, share, first, duration):
    """Whether u' = L u keeps real Fourier series below `limit` (rows,) for `duration`, wherever one looks on the ring.

    The series are those in the rows of u from `first` on. u (size, systems) holds their waves; share (systems,) is 2, of
    those that stand for their conjugates, too, or 1, of the mean; rate, shape, inverse: `eigenvectors` of L. A wave is a sum
    of exponentials of time, so that its amplitude is never above the sum of their largest sizes, and the series never above
    the sum over its waves. That may say too little as long as the exponentials cancel: then one looks ahead a little, by the
    rate at which their phases part, and asks again. Where eigenvectors nearly coincide this finds no bound, never a false one.
    """
    systems, size = rate.shape
    term = np.empty((systems, limit.size, size), np.complex128)  # the exponentials, which move at `rate`
    for s in range(systems):
        for j in range(size):
            part = 0j
            for i in range(size):
                part += inverse[s, j, i] * u[i, s]
            for row in range(limit.size):
                term[s, row, j] = shape[s, first + row, j] * part
    for _ in range(MOST_LOOKS):
        below = within_reach = True
        for row in range(limit.size):
            largest = reach = 0.0
            for s in range(rate.shape[0]):
                count, some, total, main, parting = share[s], term[s, row], 0j, 0, 0.0
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
            sure = limit[row] * (1 - 1e-6)  # rounding
            below &= largest < sure
            within_reach &= reach < sure
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
