"""The error of a run: how far its corrugation is, at the end, from what its model's own equations give.

In the L2 norm over the road, mean removed, relative. Where the run is linear (identical evenly spaced cars, constant
laws, no passage without contact) the Floquet matrix tells the growth rate of the scheme, and of one far finer: the error
is their difference over the duration. Elsewhere a second run at half the resolution tells.
"""

from __future__ import annotations

import numpy as np

from .laws import Constant
from .models import Sample, model
from .models.cars import even_start
from .theory.floquet import floquet

STRONGEST = 8  # waves of the final road that stand for all of them
FINE_ROWS = 96  # nodes a headway up to which a matrix of twice as many is still cheap
RATIO = 2.0  # a pair differs by 3 x the error of the better run at order 2, by more at higher order


def error_estimate(scene, name: str, numerics: dict, last: Sample) -> tuple[float, str]:
    """Relative error of the corrugation of `last`, the run's final sample, and how it was found."""
    if name == "cars" and _is_linear(scene, numerics, last):
        return _by_growth_rates(scene, numerics, last), "growth rates of the scheme and of a finer one"
    module = model(name)
    coarse = module.coarser(scene, numerics)
    if coarse is None:
        return float("nan"), "none: half the resolution is too little to run"
    *_, other = module.samples(scene, np.array([0.0, last.time]), coarse)
    return corrugation_difference(last.road_height, other.road_height) / RATIO, "a second run at half the resolution"


def _is_linear(scene, numerics, last):
    laws = scene.road.softness, scene.road.diffusivity
    contact = not scene.lift_off or last.airborne == 0
    return (
        contact and all(isinstance(law, Constant) for law in laws) and even_start(scene, numerics["nodes"]) is not None
    )


def _by_growth_rates(scene, numerics, last):
    count, nodes = scene.fleet.count, numerics["nodes"]
    rows = nodes // count
    other = {"nodes": 2 * nodes, "hold": 5, "relax_every": 1}
    if rows > FINE_ROWS:
        other = {**numerics, "nodes": count * (rows // 2)}
    wave = np.abs(np.fft.rfft(last.road_height))[1:]
    if not wave.any():
        return 0.0
    strongest = np.argsort(wave)[-STRONGEST:]
    error = 0.0
    for n in strongest:
        k = 2 * np.pi * (n + 1) / scene.road.length
        drift = (floquet(scene, k, **numerics) - floquet(scene, k, **other)) * last.time
        error += (wave[n] * abs(np.expm1(drift))) ** 2
    return float(np.sqrt(error / np.sum(wave[strongest] ** 2)))


def corrugation_difference(height: np.ndarray, other: np.ndarray) -> float:
    """Relative L2 difference of two roads of the same ring on any two grids, mean removed."""
    a, b = (np.fft.rfft(h)[1:] / h.size for h in (height, other))
    size = max(a.size, b.size)
    a, b = (np.pad(w, (0, size - w.size)) for w in (a, b))
    norm = np.linalg.norm(a)
    difference = np.linalg.norm(a - b)
    if norm == 0:
        return 0.0 if difference == 0 else float("inf")
    return float(difference / norm)
