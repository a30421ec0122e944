"""The growth rate of the cars scheme itself: the eigenvalues of one headway of an even fleet, without lift-off.

A relaxation interval of n headways, half a relaxation, (sweep, shift) n times, half a relaxation, is linear in the road
nodes of a block and in Z, P and the contact heights of the car at its start. On a Bloch wave, where neighbouring blocks
differ by exp(i k l), it is a matrix of (rows + 2 + hold)^2; its eigenvalue mu gives sigma = ln(mu)/(n l), exact for any
grid, hold and interval.
"""

from __future__ import annotations

import numpy as np

from ..errors import SceneError
from ..laws import Constant, finite
from ..schemes.oscillator import propagator
from .dispersion import fleet_dispersion

MOST_ROWS = 800  # of the matrix: some seconds for its eigenvalues


def sweep_map(*, headway, rows, hold, softness, car) -> np.ndarray:
    """One headway of a car through its block, without relaxation: (rows + 2 + hold, rows + 3 + hold), real.

    Of H_1..H_rows, Z, P, h_0, h_-1, ..., the last column the weight of the car; car = (speed, frequency, damping, mass).
    """
    speed, frequency, damping, mass = car
    A, B = (c[0] for c in propagator(headway / rows / speed, frequency, damping, hold))
    push = 0.5 * softness * mass * headway / speed
    size = rows + 2 + hold
    state = np.eye(size + 1)  # columns: basis vectors, the last a load of 1
    road, Z, P, load = state[:rows].copy(), state[rows], state[rows + 1], state[-1]
    past = list(state[rows + 2 : -1])
    for r in range(rows):
        z_star = A[0, 0] * Z + A[0, 1] * P + sum(B[0, q + 1] * past[q] for q in range(hold))
        p_star = A[1, 0] * Z + A[1, 1] * P + sum(B[1, q + 1] * past[q] for q in range(hold))
        contact = (road[r] - push * (load - frequency**2 * z_star)) / (1 + push * frequency**2 * (1 - B[0, 0]))
        road[r] = 2 * contact - road[r]
        Z, P = z_star + B[0, 0] * contact, p_star + B[1, 0] * contact
        past = [contact, *past[:-1]]
    return np.vstack([road, Z, P, *past])


def sweep_matrix(k, *, headway, rows, hold, softness, car) -> np.ndarray:
    """One headway without relaxation, (rows + 2 + hold)^2, on a Bloch wave; car = (speed, frequency, damping, mass)."""
    matrix = sweep_map(headway=headway, rows=rows, hold=hold, softness=softness, car=car)[:, :-1].astype(complex)
    # shift: the car that enters block 0 next comes from block -1
    matrix[rows:] *= np.exp(-1j * k * headway)
    return matrix


def relaxation_matrix(k, *, headway, rows, diffusion) -> np.ndarray:
    """exp(diffusion d2/dx2) on the nodes of a block of a Bloch wave, (rows, rows); diffusion = Delta * time."""
    # its components on the grid: k + 2 pi q / l, taken in the grid's first Brillouin zone
    node = np.arange(1, rows + 1) * (headway / rows)
    wavenumber = k + 2 * np.pi * np.arange(rows) / headway
    basis = np.exp(1j * np.outer(node, wavenumber))
    zone = 2 * np.pi * rows / headway
    folded = wavenumber - zone * np.rint(wavenumber / zone)
    return (basis * np.exp(-diffusion * folded**2)) @ (basis.conj().T / rows)


def floquet(scene, k, **numerics) -> complex:
    """sigma of the cars scheme on `scene` at wavenumber k (scalar); numerics as in simulate(model="cars").

    Of the matrix's eigenvalues the one nearest the continuum's. SceneError unless the cars are identical and evenly
    spaced over whole nodes and both laws constant; lift-off is left out (it is no linear effect).
    """
    return floquet_mode(scene, k, **numerics)[0]


def floquet_mode(scene, k, **numerics) -> tuple[complex, np.ndarray]:
    """sigma as `floquet`, and the road at a sample: its components at k, k + 2 pi/l, ..., the first 1; shape (rows,)."""
    fleet, count = scene.fleet, scene.fleet.count
    from ..models.cars import numerics as checked  # not at the top: theory is read before the models

    nodes, hold, relax_every = (checked(scene, numerics)[name] for name in ("nodes", "hold", "relax_every"))
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
    rows, k = nodes // count, finite("k", k)
    if rows > MOST_ROWS:
        raise SceneError(f"floquet: {rows} nodes a headway, must be at most {MOST_ROWS}; use fewer nodes")
    span = relax_every * scene.headway / car[0]
    block = {"headway": scene.headway, "rows": rows}
    sweep = np.linalg.matrix_power(sweep_matrix(k, **block, hold=hold, softness=softness, car=car), relax_every)
    half = relaxation_matrix(k, **block, diffusion=diffusivity * span / 2)
    # from sample to sample: half a relaxation, sweeps, half a relaxation
    matrix = sweep.copy()
    matrix[:, :rows] = matrix[:, :rows] @ half
    matrix[:rows] = half @ matrix[:rows]
    guess = complex(fleet_dispersion(k, fleet, softness=softness, diffusivity=diffusivity))
    multipliers, vectors = np.linalg.eig(matrix)
    nearest = np.argmin(np.abs(multipliers - np.exp(guess * span)))
    sigma = np.log(multipliers[nearest]) / span
    turns = np.rint((guess.imag - sigma.imag) * span / (2 * np.pi))  # the branch of the logarithm
    # components of the Bloch wave by a transform over the block, its phase at k taken out
    place = np.arange(1, rows + 1) / rows
    components = np.fft.fft(vectors[:rows, nearest] * np.exp(-1j * k * scene.headway * place))
    components *= np.exp(-2j * np.pi * np.arange(rows) / rows)
    return complex(sigma + 2j * np.pi * turns / span), components / components[0]
