"""The growth rate of the cars scheme itself: the eigenvalues of one headway of an even fleet, without lift-off.

One relaxation interval of n headways, (sweep, shift) n times, then relax, is linear in (road nodes of a block, Z, P and
contact heights of the car at its start). On a Bloch wave, where neighbouring blocks differ by exp(i k l), it is a matrix
of (rows + 2 + hold)^2; its eigenvalue mu gives sigma = ln(mu)/(n l), exact for any grid, hold and interval.
"""

from __future__ import annotations

import numpy as np

from ..errors import SceneError
from ..laws import Constant
from ..schemes.oscillator import propagator
from .dispersion import fleet_dispersion


def floquet_matrix(k, *, headway, rows, hold, relax_every, softness, diffusivity, car) -> np.ndarray:
    """Matrix of one relaxation interval, (rows + 2 + hold)^2; car = (speed, frequency, damping, mass)."""
    speed, frequency, damping, mass = car
    A, B = (c[0] for c in propagator(headway / rows / speed, frequency, damping, hold))
    push = 0.5 * softness * mass * headway / speed
    size = rows + 2 + hold
    state = np.eye(size, dtype=complex)  # rows of `state`: H_1..H_rows, Z, P, h_0, h_-1, ...; columns: basis vectors
    road, Z, P = state[:rows].copy(), state[rows], state[rows + 1]
    past = list(state[rows + 2 :])
    for r in range(rows):
        z_star = A[0, 0] * Z + A[0, 1] * P + sum(B[0, q + 1] * past[q] for q in range(hold))
        p_star = A[1, 0] * Z + A[1, 1] * P + sum(B[1, q + 1] * past[q] for q in range(hold))
        contact = (road[r] + push * frequency**2 * z_star) / (1 + push * frequency**2 * (1 - B[0, 0]))
        road[r] = 2 * contact - road[r]
        Z, P = z_star + B[0, 0] * contact, p_star + B[1, 0] * contact
        past = [contact, *past[:-1]]
    # shift: the car that enters block 0 next comes from block -1
    shift = np.exp(-1j * k * headway)
    sweep = np.vstack([road, shift * Z, shift * P, *(shift * h for h in past)])
    matrix = np.linalg.matrix_power(sweep, relax_every)
    if diffusivity:
        # the Bloch wave's components on the grid: k + 2 pi q / l, taken in the grid's first Brillouin zone
        node = np.arange(1, rows + 1) * (headway / rows)
        wavenumber = k + 2 * np.pi * np.arange(rows) / headway
        basis = np.exp(1j * np.outer(node, wavenumber))
        zone = 2 * np.pi * rows / headway
        folded = wavenumber - zone * np.rint(wavenumber / zone)
        decay = np.exp(-diffusivity * folded**2 * relax_every * headway / speed)
        matrix[:rows] = (basis * decay) @ (basis.conj().T / rows) @ matrix[:rows]
    return matrix


def floquet(scene, k, **numerics) -> complex:
    """sigma of the cars scheme on `scene` at wavenumber k (scalar), for numerics as in simulate(model="cars").

    Of the matrix's eigenvalues the one nearest the continuum's. SceneError unless the cars are identical and evenly
    spaced over whole nodes and both laws constant; lift-off is left out (it is no linear effect).
    """
    fleet, count = scene.fleet, scene.fleet.count
    nodes, hold, relax_every = (numerics.get(name, default) for name, default in _defaults(scene).items())
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
    matrix = floquet_matrix(
        float(k), headway=scene.headway, rows=nodes // count, hold=hold, relax_every=relax_every,
        softness=softness, diffusivity=diffusivity, car=car,
    )  # fmt: skip
    span = relax_every * scene.headway / car[0]
    guess = complex(fleet_dispersion(k, fleet, softness=softness, diffusivity=diffusivity))
    mu = np.linalg.eigvals(matrix)
    mu = mu[np.argmin(np.abs(mu - np.exp(guess * span)))]
    sigma = np.log(mu) / span
    turns = np.rint((guess.imag - sigma.imag) * span / (2 * np.pi))  # the branch of the logarithm
    return complex(sigma + 2j * np.pi * turns / span)


def _defaults(scene) -> dict:
    from ..models.cars import numerics  # not at the top: theory is read before the models

    return numerics(scene, {})
