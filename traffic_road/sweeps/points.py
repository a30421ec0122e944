"""One point of a sweep: its scene, its run, its measures. A point that fails is a row that says so."""

from __future__ import annotations

import time
import warnings
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..errors import TrafficRoadError
from ..measures import OF_A_WAVE, enough_samples, fastest_wave, measures
from ..run import simulate
from ..scene import Scene
from ..store import VERSION
from .axes import Axis, scene_at

LEAST_SAMPLES, MOST_SAMPLES = 101, 10_001  # of a run whose number of samples was not given


class Task(NamedTuple):
    """All that a process must know to compute any point of a sweep."""

    scene: Scene
    axes: tuple[Axis, ...]
    measure: tuple[str, ...]
    wavenumber: float | None
    samples: int | tuple[float, ...] | None
    model: str
    tolerance: float
    numerics: dict
    version: str = VERSION

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def needs_wave(self) -> bool:
        return any(name in OF_A_WAVE for name in self.measure)


def compute(task: Task, points: list[int]) -> tuple[list[tuple[int, dict]], float]:
    """Rows of the points of these numbers (row-major order of the axes), and the seconds that they took."""
    if task.version != VERSION:
        raise TrafficRoadError(f"a worker has traffic_road {VERSION}, the sweep is of {task.version}; install the same")
    begin = time.perf_counter()
    return [(point, _row(task, point)) for point in points], time.perf_counter() - begin


def warm_up(task: Task) -> None:
    """Compile what the first point needs, by a run of next to nothing: the next process finds it in the cache."""
    first = {axis.path: axis.values[0] for axis in task.axes}
    with suppress(Exception), warnings.catch_warnings():  # a first point that fails says so itself
        warnings.simplefilter("ignore")
        scene = scene_at(task.scene, first)
        short = replace(scene, duration=min(scene.duration, 4 * scene.headway_time))
        simulate(short, task.model, task.tolerance, 2, progress=False, **task.numerics)


def _row(task: Task, point: int) -> dict:
    place = np.unravel_index(point, task.shape)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an unmet tolerance stands in the row's error estimate
            return _measured(task, {axis.path: axis.values[i] for axis, i in zip(task.axes, place, strict=True)})
    except Exception as error:
        return {"status": reason(error)}


def _measured(task, values):
    scene = scene_at(task.scene, values)
    wavenumber = np.nan
    if task.needs_wave:
        wavenumber = fastest_wave(scene) if task.wavenumber is None else task.wavenumber
    samples = task.samples
    if samples is None:
        samples = LEAST_SAMPLES
        if task.needs_wave:
            samples = enough_samples(scene, wavenumber, LEAST_SAMPLES, MOST_SAMPLES)
    ds = simulate(scene, task.model, task.tolerance, samples, progress=False, **task.numerics)
    row = {name: ds.attrs[name] for name in ("status", "model", "error_estimate")}
    return (
        row
        | {"updates": int(ds.attrs["updates"]), "wavenumber": wavenumber}
        | measures(ds, scene, task.measure, wavenumber)
    )


def reason(error: BaseException) -> str:
    """What went wrong at a point, in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
