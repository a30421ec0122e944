"""simulate(): one scene, one model, one Dataset."""

from __future__ import annotations

import time as clock
import warnings

import numpy as np
import xarray as xr
from tqdm import tqdm

from .errors import SceneError, shown
from .estimate import error_estimate
from .laws import finite, whole
from .memory import refuse_beyond_memory
from .models import Breath, Sample, model
from .scene import Scene
from .store import arguments_of, assemble, refuse_unwritable, save

MOST_SAMPLES = 10_000_000
RUNAWAY = 1e12  # corrugation (g/omega_0^2) beyond which the road has blown up and rounding eats what is left
REFINEMENTS = 4  # doublings of the default resolution before a tolerance is given up


def simulate(scene, model="auto", tolerance=1e-3, samples=101, *, output=None, progress=None, **numerics) -> xr.Dataset:
    """Run `scene` and return its Dataset.

    model: "cars", "continuum", or "auto" (the cars, which are what a scene describes). tolerance: relative error of the
    corrugation (L2 over the road, mean removed) at the end; where no resolution is given the default is refined until the
    estimate meets it. samples: number of times, evenly spaced from 0 to the duration, or the times themselves, which then
    say how long the run is. Numerics override the default: nodes, hold, relax_every for "cars", nodes, step for
    "continuum". output: netCDF file to write. progress: True, False, a function that is given the fraction done (from the
    start again when the resolution is refined), or None for a bar after two seconds if there is a terminal.

    Dataset: road_height (time, x); car_height, contact_force (time, car) and car_position (time, car) for "cars", else
    (time, x). A run that diverges keeps what it has and says so in `status`. Raises SceneError, StabilityError,
    StoreError.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    if not (progress in (None, True, False) or callable(progress)):
        raise SceneError(f"progress = {shown(progress)}: must be True, False, None or a function of the fraction done")
    name = "cars" if model == "auto" else model
    finite("tolerance", tolerance, above=0)
    if output is not None:
        refuse_unwritable(output)
    ds = _run(scene, name, finite("tolerance", tolerance), samples, numerics, progress)
    if output is not None:
        save(ds, output)
    return ds


def _times(scene, samples) -> np.ndarray:
    if np.ndim(samples) == 0:
        return np.linspace(0.0, scene.duration, whole("samples", samples, 2, MOST_SAMPLES))
    times = np.asarray(samples, dtype=float)
    if (
        times.ndim != 1
        or times.size < 2
        or times[0] != 0
        or not np.all(np.diff(times) > 0)
        or not np.isfinite(times[-1])
    ):
        raise SceneError("samples: times must be two or more, increase, and begin with 0; or give their number")
    return times


def rerun(ds, **changes) -> xr.Dataset:
    """Run again what a result of `simulate` was computed from; the same bits on the same machine.

    Scene, model, tolerance, samples and numerics are those that `ds` carries; `changes` are arguments of `simulate` to use
    instead, or besides. With another model its numerics are chosen anew. StoreError if `ds` does not carry them.
    """
    arguments = arguments_of(ds)
    if changes.get("model", arguments["model"]) != arguments["model"]:
        arguments = {name: arguments[name] for name in ("scene", "tolerance", "samples")}
    return simulate(**(arguments | changes))


def _run(scene, name, tolerance, samples, given, progress):
    module, times = model(name), _times(scene, samples)
    numerics = module.numerics(scene, given)
    for attempt in range(REFINEMENTS + 1):
        begin = clock.perf_counter()
        taken, status = _collect(scene, module, times, numerics, progress)
        wall_time = clock.perf_counter() - begin
        if status == "ok":
            begin = clock.perf_counter()
            error, method = error_estimate(scene, name, numerics, taken[-1])
            estimate_time = clock.perf_counter() - begin
        else:
            error, method, estimate_time = float("inf"), "none: the run diverged", 0.0
        finer = module.finer(scene, numerics, given)
        if not error > tolerance or status != "ok" or finer == numerics:
            break
        if attempt == REFINEMENTS:
            warnings.warn(
                f"tolerance = {tolerance:g}: not met, the error estimate is {error:.2g} with {numerics}; "
                "name finer numerics, shorten the duration, or ask less of a road that is nearly flat",
                stacklevel=3,
            )
            break
        numerics = finer
    outcome = {
        "tolerance": tolerance,
        "error_estimate": error,
        "error_method": method,
        "wall_time": wall_time,
        "error_wall_time": estimate_time,
        "updates": taken[-1].updates,
        "status": status,
        "samples": samples if np.ndim(samples) == 0 else times,
    }
    if taken[-1].airborne is not None:
        outcome["airborne_passages"] = taken[-1].airborne
    return assemble(scene, name, numerics, taken, outcome)


def _collect(scene, module, times, numerics, progress) -> tuple[list[Sample], str]:
    """The samples of a run up to its end or to where it blows up, and its status."""
    times = module.sample_times(scene, times, numerics)
    taken: list[Sample] = []
    status = "ok"
    report = progress if callable(progress) else None
    # progress None: only in a terminal (disable=None), and only for what takes longer than two seconds
    disable = None if progress is None else progress is not True
    with np.errstate(all="ignore"), tqdm(total=len(times), delay=2, disable=disable, leave=False, unit="sample") as bar:
        for sample in module.samples(scene, times, numerics):
            if isinstance(sample, Breath):
                continue
            if not taken:
                _refuse_too_many(sample, len(times))
            if not healthy(sample) and not taken:
                raise SceneError(
                    f"scene: corrugation {np.ptp(sample.road_height):.3g} at the start, must be finite and < {RUNAWAY:g}; "
                    "lower the profile"
                )
            if not healthy(sample):
                status = f"diverged between time {taken[-1].time:.6g} and {sample.time:.6g}"
                break
            taken.append(sample)
            bar.update()
            if report is not None:
                report(len(taken) / len(times))
    return taken, status


def _refuse_too_many(sample: Sample, held: int) -> None:
    """SceneError if `held` samples at once, and the Dataset they are stacked to, do not fit in memory."""
    size = sum(np.size(a) for a in sample if isinstance(a, np.ndarray))
    what = f"{held} samples of {sample.road_height.size} nodes"
    refuse_beyond_memory(2.5 * held * size, what, "use fewer samples or nodes")


def healthy(sample: Sample) -> bool:
    """False where a number has been lost or the corrugation has run away."""
    whole = all(np.all(np.isfinite(a)) for a in (sample.road_height, sample.car_height, sample.contact_force))
    return whole and float(np.ptp(sample.road_height)) < RUNAWAY
