"""The growth rate of the cars scheme itself: the eigenvalues of one headway of an even fleet, without lift-off.

A relaxation interval of n headways, half a relaxation, (sweep, shift) n times, half a relaxation, is linear in the road
nodes of a block and in Z, P and the contact heights of the car at its start. On a Bloch wave, where neighbouring blocks
differ by exp(i k l), it is a matrix of (rows + 2 + hold)^2; its eigenvalue mu gives sigma = ln(mu)/(n l), exact for any
grid, hold and interval.
"""

from __future__ import annotations

import numpy as np

from ..compiled import njit
from ..errors import SceneError
from ..laws import Constant, finite
from ..schemes.oscillator import propagator
from .dispersion import fleet_dispersion

MOST_ROWS = 800  # of the matrix: some seconds for its eigenvalues
MOST_ITERATIONS = 60  # of the nearest eigenvalue
SETTLED = 1e-14  # change of it at which they end


def sweep_map(*, headway, rows, hold, softness, car) -> np.ndarray:
    """One headway of a car through its block, without relaxation: (rows + 2 + hold, rows + 3 + hold), real.

    Of H_1..H_rows, Z, P, h_0, h_-1, ..., the last column the weight of the car; car = (speed, frequency, damping, mass).
    """
    speed, frequency, damping, mass = car
    A, B = (c[0] for c in propagator(headway / rows / speed, frequency, damping, hold))
    push = 0.5 * softness * mass * headway / speed
    size = rows + 2 + hold
    state = np.eye(size + 1)  # columns: basis vectors, the last a load of 1
    own = np.array([push, frequency**2, 1 / (1 + push * frequency**2 * (1 - B[0, 0]))])
    _cross(state, rows, A, B, own)
    return state[:-1]


@njit(cache=True)
def _cross(state, rows, A, B, own):
    """The car goes through the block: state (rows + 3 + hold, columns) in place, rows as those of `sweep_map`."""
    hold = B.shape[1] - 1
    push, omega2, scale = own
    for column in range(state.shape[1]):
        road, car = state[:rows, column], state[rows:, column]
        load = state[-1, column]
        for r in range(rows):
            z_star = A[0, 0] * car[0] + A[0, 1] * car[1]
            p_star = A[1, 0] * car[0] + A[1, 1] * car[1]
            for q in range(hold):
                z_star += B[0, q + 1] * car[2 + q]
                p_star += B[1, q + 1] * car[2 + q]
            contact = (road[r] - push * (load - omega2 * z_star)) * scale
            road[r] = 2 * contact - road[r]
            car[0], car[1] = z_star + B[0, 0] * contact, p_star + B[1, 0] * contact
            for q in range(hold - 1, 0, -1):
                car[2 + q] = car[1 + q]
            car[2] = contact


def sweep_matrix(k, *, headway, rows, hold, softness, car) -> np.ndarray:
    """One headway without relaxation, (rows + 2 + hold)^2, on a Bloch wave; car = (speed, frequency, damping, mass)."""
    matrix = sweep_map(headway=headway, rows=rows, hold=hold, softness=softness, car=car)[:, :-1].astype(complex)
    # shift: the car that enters block 0 next comes from block -1
    matrix[rows:] *= np.exp(-1j * k * headway)
    return matrix


def relaxation_matrix(k, *, headway, rows, diffusion) -> np.ndarray:
    """exp(diffusion d2/dx2) on the nodes of a block of a Bloch wave, (rows, rows); diffusion = Delta * time."""
    node = np.arange(1, rows + 1) * (headway / rows)
    basis = np.exp(1j * np.outer(node, k + 2 * np.pi * np.arange(rows) / headway))
    return (basis * np.exp(-diffusion * _folded(k, headway, rows) ** 2)) @ (basis.conj().T / rows)


def _folded(k, headway, rows):
    """Components of a Bloch wave on the grid: k + 2 pi q / l, (rows,), taken in the grid's first Brillouin zone."""
    wavenumber = k + 2 * np.pi * np.arange(rows) / headway
    zone = 2 * np.pi * rows / headway
    return wavenumber - zone * np.rint(wavenumber / zone)


def floquet(scene, k, **numerics) -> complex:
    """sigma of the cars scheme on `scene` at wavenumber k (scalar); numerics as in simulate(model="cars").

    Of the matrix's eigenvalues the one nearest the continuum's. SceneError unless the cars are identical and evenly
    spaced over whole nodes and both laws constant; lift-off is left out (it is no linear effect).
    """
    return floquet_mode(scene, k, **numerics)[0]


def floquet_mode(scene, k, **numerics) -> tuple[complex, np.ndarray]:
    """sigma as `floquet`, and the road at a sample: its components at k, k + 2 pi/l, ..., the first 1; shape (rows,)."""
    return floquet_modes(scene, [k], **numerics)[0]


def floquet_modes(scene, wavenumbers, **numerics) -> list[tuple[complex, np.ndarray]]:
    """`floquet_mode` at each of `wavenumbers`."""
    fleet, count = scene.fleet, scene.fleet.count
    from ..models.cars import scheme  # not at the top: theory is read before the models

    chosen = scheme(scene, numerics)
    nodes, hold, relax_every = (chosen[name] for name in ("nodes", "hold", "relax_every"))
    laws = scene.road.softness, scene.road.diffusivity
    car = [fleet.per_car(name) for name in ("speed", "frequency", "damping", "mass")]
    spacing = np.sort(fleet.positions(scene.road.length)) - np.arange(count) * scene.headway
    if any(np.ptp(values) for values in car) or np.ptp(spacing) > 1e-9 * scene.headway or nodes % count:
        raise SceneError(
            f"floquet: needs identical, evenly spaced cars and a multiple of {count} nodes (here {nodes}); "
            "for other fleets use fleet_dispersion"
        )
    if not all(isinstance(law, Constant) for law in laws):
        raise SceneError("floquet: needs Constant softness and diffusivity; freeze the laws at one height")
    softness, diffusivity = (law.value for law in laws)
    car = [float(values[0]) for values in car]
    rows, wavenumbers = nodes // count, [finite("k", k) for k in wavenumbers]
    if rows > MOST_ROWS:
        raise SceneError(f"floquet: {rows} nodes a headway, must be at most {MOST_ROWS}; use fewer nodes")
    shortest = np.pi * nodes / scene.road.length * (1 + 1e-9)
    if max(map(abs, wavenumbers), default=0.0) > shortest:
        raise SceneError(
            f"floquet: k = {max(wavenumbers, key=abs):g} is a wave shorter than two nodes, must be at most "
            f"{shortest:.4g}; use more nodes"
        )
    span = relax_every * scene.headway / car[0]
    block = {"headway": scene.headway, "rows": rows}
    sweep = sweep_map(**block, hold=hold, softness=softness, car=car)[:, :-1]
    guesses = fleet_dispersion(np.array(wavenumbers), fleet, softness=softness, diffusivity=diffusivity)
    return [
        _mode(k, complex(guess), sweep, diffusivity * span, scene.headway, rows, relax_every, span)
        for k, guess in zip(wavenumbers, guesses, strict=True)
    ]


def _mode(k, guess, sweep, diffusion, headway, rows, relax_every, span):
    """sigma and components at k from the map `sweep` of one headway."""
    matrix = sweep.astype(complex)
    matrix[rows:] *= np.exp(-1j * k * headway)  # as in `sweep_matrix`
    matrix = np.linalg.matrix_power(matrix, relax_every)
    # half a relaxation, sweeps, half a relaxation from sample to sample: similar to sweeps and a whole relaxation
    phase = np.exp(1j * k * headway * np.arange(1, rows + 1) / rows)
    factor = np.exp(-diffusion * _folded(k, headway, rows) ** 2)
    matrix[:, :rows] = np.fft.fft(np.fft.ifft(matrix[:, :rows] * phase, axis=1) * factor, axis=1) * phase.conj()
    multiplier, vector = nearest_eigenpair(matrix, np.exp(guess * span))
    if multiplier == 0 or not np.any(vector[:rows]):
        raise SceneError(
            f"floquet: the wave k = {k:g} decays below rounding in {span:.3g}; use a longer wave, or relax more often"
        )
    sigma = np.log(multiplier) / span
    turns = np.rint((guess.imag - sigma.imag) * span / (2 * np.pi))  # the branch of the logarithm
    # components of the Bloch wave by a transform over the block, its phase at k taken out
    components = np.fft.fft(vector[:rows] * phase.conj()) * np.sqrt(factor)
    components *= np.exp(-2j * np.pi * np.arange(rows) / rows)
    if components[0] == 0:
        raise SceneError(
            f"floquet: k = {k:g} is not in its own wave, to rounding; use a longer wave, or relax more often"
        )
    return complex(sigma + 2j * np.pi * turns / span), components / components[0]


def nearest_eigenpair(matrix, guess) -> tuple[complex, np.ndarray]:
    """The eigenvalue of `matrix` (n, n) nearest to `guess`, and its vector: inverse iteration.

    Where that does not settle, because others are nearly as near, by all eigenvalues.
    """
    value, vector, residual = _inverse_iteration(matrix, complex(guess))
    if residual <= 100 * SETTLED:
        return value, vector
    values, vectors = np.linalg.eig(matrix)
    nearest = np.argmin(np.abs(values - guess))
    return values[nearest], vectors[:, nearest]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _inverse_iteration(matrix, guess):
    """Eigenvalue, vector of norm 1 and residual. Compiled: threads of BLAS take longer to wake than matrices so small."""
    size = matrix.shape[0]
    a, order = matrix.copy(), np.empty(size, np.int64)
    # entry by entry: what numpy does with whole arrays takes seconds to compile
    largest = 0.0
    for i in range(size):
        for j in range(size):
            largest = max(largest, np.abs(a[i, j]))
        a[i, i] -= guess
        order[i] = i
    lost = max(np.finfo(np.float64).eps * largest, np.finfo(np.float64).tiny)
    for n in range(size):  # LU with row pivots
        pivot = n
        for i in range(n + 1, size):
            if np.abs(a[i, n]) > np.abs(a[pivot, n]):
                pivot = i
        if pivot != n:
            for j in range(size):
                a[n, j], a[pivot, j] = a[pivot, j], a[n, j]
            order[n], order[pivot] = order[pivot], order[n]
        if a[n, n] == 0:  # the guess is an eigenvalue, to the last bit
            a[n, n] = lost
        per = 1.0 / a[n, n]
        for i in range(n + 1, size):
            factor = a[i, n] * per
            a[i, n] = factor
            if factor != 0:
                for j in range(n + 1, size):
                    a[i, j] -= factor * a[n, j]
    vector, image = np.empty(size, np.complex128), np.empty(size, np.complex128)
    for i in range(size):  # no symmetry that a mode could lack
        vector[i] = np.exp(2j * np.pi * np.sqrt(2) * i**2) / np.sqrt(size)
    value = np.inf + 0j
    for _ in range(MOST_ITERATIONS):
        for i in range(size):
            image[i] = vector[order[i]]
        for i in range(1, size):
            for j in range(i):
                image[i] -= a[i, j] * image[j]
        for i in range(size - 1, -1, -1):
            for j in range(i + 1, size):
                image[i] -= a[i, j] * image[j]
            image[i] /= a[i, i]
        along, norm = 0j, 0.0
        for i in range(size):
            along += np.conj(vector[i]) * image[i]
            norm += np.abs(image[i]) ** 2
        last, value = value, guess + 1 / along
        for i in range(size):
            vector[i] = image[i] / np.sqrt(norm)
        if not abs(value - last) > SETTLED * abs(value):
            break
    residual = 0.0
    for i in range(size):
        row = -value * vector[i]
        for j in range(size):
            row += matrix[i, j] * vector[j]
        residual += np.abs(row) ** 2
    return value, vector, np.sqrt(residual)
