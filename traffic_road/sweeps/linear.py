"""All points of a sweep at once by linear theory: small waves of the continuum, laws frozen, nothing stepped.

The linear model of `simulate` knows an even fleet's headway, too: matrices of its own for every scene, and slower by far.

What a scene is made of (ring and profile, softness, diffusivity, fleet, duration) is looked at once for each combination
of its own values; the points, their product, are arrays. A wave is a small linear system (`kinds_matrix`), whose
eigenvectors say how much of each root there is in the start.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ..errors import SceneError
from ..measures import mean_height, waves
from ..profiles import whole_waves
from ..run import RUNAWAY
from ..theory.dispersion import kinds_matrix
from .axes import scene_at
from .points import Task, reason

PARTS = {  # what of a scene is looked at together
    "ring": ("road.length", "road.profile"),
    "softness": ("road.softness",),
    "diffusivity": ("road.diffusivity",),
    "fleet": ("fleet",),
    "rest": ("duration", "lift_off", "scales"),
}
CHUNK = 20_000  # waves at a time


def linear_columns(task: Task) -> dict[str, np.ndarray]:
    """Arrays (points,) of status, wavenumber and the measures.

    growth_rate and phase_velocity are those of the root of largest growth, amplitude is that of the wave at the end
    (all roots, from the start that the fleet has), sink_rate that of the quiescent road, airborne the share of the wave,
    at the end, over which the linear force is not above zero. Laws and hardening rate are those of the mean height at
    the start. Where a point has no scene, its status says why and its measures are NaN.
    """
    points = int(np.prod(task.shape))
    places = np.unravel_index(np.arange(points), task.shape)
    status = np.full(points, "ok", dtype=object)
    tables, which = {}, {}
    for part, paths in PARTS.items():
        mine = [i for i, axis in enumerate(task.axes) if f"{axis.path}.".startswith(tuple(f"{p}." for p in paths))]
        shape = [task.shape[i] for i in mine]
        which[part] = np.ravel_multi_index([places[i] for i in mine], shape) if mine else np.zeros(points, dtype=int)
        combinations = product(*([(task.axes[i].path, value) for value in task.axes[i].values] for i in mine))
        looks = [_look(task, part, dict(values)) for values in combinations]
        wrong = np.array([look if isinstance(look, str) else "ok" for look in looks], dtype=object)
        status = np.where(status == "ok", wrong[which[part]], status)
        tables[part] = _table(looks)
    out = {name: np.full(points, np.nan) for name in ("wavenumber", *task.measure)}
    good = np.flatnonzero(status == "ok")
    step = max(1, CHUNK // tables["ring"].shape[-1])
    for begin in range(0, good.size, step):
        here = good[begin : begin + step]
        with np.errstate(all="ignore"):  # what overflows says so in its status
            found, status[here] = _fastest(*(tables[part][which[part][here]] for part in PARTS))
        for name in out:
            out[name][here] = found[name]
    return {"status": status, **out}


def _look(task, part, values):
    """The numbers (rows, any) of one part of the scene with `values`, or why there are none."""
    try:
        scene = scene_at(task.scene, values)
        if part == "ring":
            return _ring(task, scene)
    except SceneError as error:
        return reason(error)
    road, fleet = scene.road, scene.fleet
    height = mean_height(task.scene)  # no value of a sweep changes it
    if part == "softness":
        return np.array([[float(road.softness(height))], [float(road.softness.derivative(height))]])
    if part == "diffusivity":
        return np.array([[float(road.diffusivity(height))]])
    if part == "fleet":
        columns = np.stack([fleet.per_car(name) for name in ("speed", "frequency", "damping", "mass")])
        distinct, count = np.unique(columns, axis=1, return_counts=True)
        return np.vstack([count / fleet.count, distinct, np.full(count.size, float(fleet.start == "rest"))])
    return np.array([[scene.duration]])


def _ring(task, scene):
    """Wavenumbers and amplitudes at the start of the waves to choose from, (2, waves)."""
    k, size = waves(scene)
    if task.wavenumber is not None:
        number = whole_waves("wavenumber", task.wavenumber, scene.road.length)
        same = np.rint(k * scene.road.length / (2 * np.pi)) == number
        return np.array([[task.wavenumber], [size[same].sum()]])
    if not k.size and task.needs_wave:
        raise SceneError("profile: a flat road has no wave; give it one, or name measures that need none")
    return np.array([k, size]) if k.size else np.array([[np.nan], [0.0]])


def _table(looks) -> np.ndarray:
    """All looks in one array, (combinations, rows, any), filled up with NaN."""
    shapes = [look.shape for look in looks if not isinstance(look, str)] or [(1, 1)]
    table = np.full((len(looks), shapes[0][0], max(shape[1] for shape in shapes)), np.nan)
    for row, look in zip(table, looks, strict=True):
        if not isinstance(look, str):
            row[:, : look.shape[1]] = look
    return table


def _fastest(ring, softness, diffusivity, fleet, rest) -> tuple[dict, np.ndarray]:
    """Measures (points,) and status of the fastest growing of the waves of each point."""
    # a wave or a kind of car that only other points have: numbers that harm nobody
    absent = np.isnan(ring[:, 0])
    k, size = np.where(absent, 1.0, ring[:, 0]), ring[:, 1]
    harmless = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 0.0])[:, None]  # no share of the fleet
    *cars, rests = np.where(np.isnan(fleet[:, :1]), harmless, fleet).transpose(1, 0, 2)[:, :, None]
    share, mass = cars[0], cars[-1]
    alpha, slope = softness[..., 0].T[..., None]
    mean_mass = np.sum(share * mass, axis=-1)
    laws = {"softness": alpha, "diffusivity": diffusivity[:, 0], "hardening_rate": slope * mean_mass}
    matrix = kinds_matrix(k, *cars, **laws)
    lost = ~np.isfinite(matrix).all(axis=(1, 2, 3))
    roots, states = np.linalg.eig(np.where(lost[:, None, None, None], np.eye(matrix.shape[-1]), matrix))
    first = np.argmax(roots.real, axis=-1)
    growing = np.take_along_axis(roots.real, first[..., None], axis=-1)[..., 0]
    best = np.argmax(np.where(absent, -np.inf, growing), axis=-1)
    here = np.arange(len(k)), best
    k, size, roots, states, first = k[here], size[here], roots[here], states[here], first[here]
    *cars, rests = (column[:, 0] for column in (*cars, rests))
    sigma, sure = _polished(
        roots[np.arange(len(k)), first], k, *cars, **{name: law[:, 0] for name, law in laws.items()}
    )
    start, resonant = _start(k, *cars[1:4], rests == 1)
    single = np.linalg.det(states) == 0  # roots that coincide to the last digit
    weights = np.linalg.solve(np.where(single[:, None, None], np.eye(roots.shape[1]), states), start[..., None])[..., 0]
    height = np.sum(weights * states[:, 0] * np.exp(roots * rest[:, 0]), axis=-1)
    amplitude = np.where(single | resonant | lost, np.nan, size * np.abs(height))
    force = amplitude[:, None] * np.abs(_response(sigma, k, *cars[1:4])[0])
    aloft = np.where(np.isnan(force), np.nan, np.arccos(1 / np.maximum(force, 1.0)) / np.pi)
    status = np.full(k.size, "ok", dtype=object)
    status[~(amplitude < RUNAWAY)] = "diverged: the amplitude of the linear wave passes all bounds within the duration"
    lost |= ~sure | np.isnan(np.sum(cars[0] * aloft, axis=-1)) & ~single & ~resonant
    status[lost] = "SceneError: scene: its numbers overflow, or rounding hides the wave; use less extreme ones"
    status[single] = "SceneError: two roots of the wave coincide, which hides its amplitude; change any value a little"
    status[resonant] = "SceneError: fleet: an undamped car in resonance with the wave has no settled start"
    measures = {
        "wavenumber": np.where(absent[here], np.nan, k),
        "growth_rate": sigma.real,
        "phase_velocity": -sigma.imag / k,
        "amplitude": amplitude,
        "sink_rate": alpha[:, 0] * mean_mass[:, 0],
        "airborne": np.sum(cars[0] * aloft, axis=-1),
    }
    return {name: np.where(lost, np.nan, values) for name, values in measures.items()}, status


def _response(sigma, k, speed, omega, damping):
    """omega^2 R of each kind of car, the force on a road that varies as exp(ikx + sigma t), and its slope in sigma."""
    s = sigma[:, None] + 1j * k[:, None] * speed
    quadratic = s**2 + 2 * damping * omega * s + omega**2
    return omega**2 * s**2 / quadratic, omega**2 * 2 * s * omega * (damping * s + omega) / quadratic**2


def _polished(sigma, k, share, speed, omega, damping, mass, *, softness, diffusivity, hardening_rate):
    """sigma after a Newton step on the dispersion relation itself, and whether it was near enough for that.

    sigma may be far smaller than k or omega, on whose scale an eigenvalue is rounded.
    """
    force, slope = _response(sigma, k, speed, omega, damping)
    value = sigma + hardening_rate + diffusivity * k**2 + softness * np.sum(share * mass * force, axis=-1)
    step = value / (1 + softness * np.sum(share * mass * slope, axis=-1))
    small = np.abs(step) < 1e-6 * (np.abs(sigma) + 1e-6)
    return sigma - np.where(small, step, 0.0), small | (
        softness == 0
    )  # a road that yields to no car has no such relation


def _start(k, speed, omega, damping, rests):
    """H, Z_1, P_1, ... of a wave of unit height at the start (points, 2n + 1), and where there is no settled one."""
    q = k[:, None] * speed / omega
    quadratic = 1 - q**2 + 2j * damping * q
    resonant = np.any(quadratic == 0, axis=-1) & ~rests[:, 0]
    quadratic = np.where(quadratic == 0, 1.0, quadratic)
    start = np.ones((k.size, 2 * speed.shape[-1] + 1), dtype=complex)
    start[:, 1::2] = np.where(rests, 1.0, (1 + 2j * damping * q) / quadratic)
    start[:, 2::2] = np.where(rests, 0.0, 1j * omega * q / quadratic)
    return start, resonant
