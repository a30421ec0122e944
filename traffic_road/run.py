"""simulate(): one scene, one model, one Dataset."""

from __future__ import annotations

import json
import math
import os
import sys
import time as clock
import warnings
from contextlib import nullcontext
from dataclasses import asdict, replace

import numpy as np
import xarray as xr
from tqdm import tqdm

from .checkpoint import read
from .errors import SceneError, StabilityError, StoreError, TrafficRoadError, shown
from .estimate import error_estimate
from .health import RUNAWAY, Watch, corrugation, foreseen
from .keeper import Disk, Job, Memory
from .laws import finite, whole
from .memory import refuse_beyond_memory
from .models import Breath, Sample, model
from .models.cars_state import evenly_spaced
from .models.continuum_state import linear_throughout
from .outlook import whole_headways
from .planning import KEYWORDS, plan
from .scene import Scene
from .signals import guarded
from .store import arguments_of, refuse_unwritable

MOST_SAMPLES = 10_000_000
MARGIN = 0.9  # of the tolerance, at which a refined plan aims
REFINEMENTS = 4  # doublings of the default resolution before a tolerance is given up


def simulate(
    scene, model="auto", tolerance=1e-3, samples=101, *, output=None, checkpoint=None, checkpoint_every=60.0, progress=None,
    allow_unstable=False, **numerics,
) -> xr.Dataset:  # fmt: skip
    """Run `scene` and return its Dataset.

    model: "cars", "continuum", "linear", or "auto", what `plan` chooses. tolerance: relative error of the corrugation (L2
    over the road, mean removed) at the end; where no resolution is given the default, or the plan's, is refined until the
    estimate meets it. By name `error_estimate` is the error by the model's own equations; with "auto" it is that against
    the discrete scene, the part `model_error` that the plan predicts included, and a run of evenly spaced cars of one speed
    ends after a whole number of headways, the nearest, whichever model is chosen: their road is known at these times alone.
    samples: number of times, evenly spaced from 0 to the duration, or the times themselves, which then say how long the run
    is. Numerics override the default: nodes, hold, relax_every for "cars", nodes, step for "continuum", nodes for "linear".
    progress: True, False, a function that is given the fraction done (from the start again when the resolution is refined),
    or None for a bar after two seconds if there is a terminal. allow_unstable: for study; run outside a stability limit,
    too, with a warning and without an error estimate, and follow growth beyond the saturation limit to a corrugation of 1e12.

    output: netCDF file to write. Samples are streamed to it, so that memory stays flat, and whoever opens it meanwhile finds
    a whole file of the run so far; `status` says so. A result of more than 64 MB is given back as that file, opened, whose
    variables are read when they are asked for. checkpoint: file from which `resume` goes on, written at the start, every
    checkpoint_every seconds, and at SIGINT or SIGTERM; the samples so far are beside it in FILE.samples-N, and both are
    removed when the run has finished.

    Dataset: road_height (time, x); car_height, contact_force (time, car) and car_position (time, car) for "cars", else
    (time, x). A run that diverges keeps what it has and says so, and why, in `status`; one that will pass lift-off where
    nothing saturates it is warned of. Raises SceneError, StabilityError, StoreError.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    _refuse_progress(progress)
    tolerance = finite("tolerance", tolerance, above=0)
    every = finite("checkpoint_every", checkpoint_every, least=0)
    if output is not None:
        refuse_unwritable(output)
    if checkpoint is not None:
        refuse_unwritable(checkpoint)
        if output is not None and os.path.realpath(checkpoint) == os.path.realpath(output):
            raise StoreError(f"{checkpoint}: cannot be both the checkpoint and the output; name another")
        if os.path.lexists(checkpoint):
            raise StoreError(
                f"{checkpoint}: there is a file; go on from it with tr.resume or --resume, or name another"
            )
    times, chosen = _times(scene, samples), None
    if model == "auto":
        scene, times = _to_whole_headways(scene, samples, times)
        chosen = asdict(plan(scene, tolerance, **numerics))
        model = chosen["model"]
    even = np.ndim(samples) == 0 or np.array_equal(times, _times(scene, times.size))
    job = Job(scene, model, tolerance, numerics, times, even, bool(allow_unstable), chosen)
    if output is None and checkpoint is None:
        return _run(Memory(job), progress)
    disk = Disk(job, output, checkpoint, every)
    with guarded(disk):
        return _run(disk, progress)


def resume(checkpoint, *, scene=None, output=None, progress=None) -> xr.Dataset:
    """Go on with the run that left `checkpoint`, to the Dataset that it would have given: the same bits, but for times taken.

    scene: refuse any other. output: in place of the file that was named at the start. StoreError for a file that is no
    checkpoint, damaged, of another version or scene, or in use.
    """
    _refuse_progress(progress)
    facts, state = read(checkpoint)
    job = Job.of(facts, state.pop("times"))
    if scene is not None and scene != job.scene:
        raise StoreError(
            f"{checkpoint}: a checkpoint of another scene; leave the scene out, or name its own checkpoint"
        )
    output = facts["output"] if output is None else output
    if output is not None:
        refuse_unwritable(output)
    disk = Disk(job, output, checkpoint, facts["every"], (facts, state or None))
    with guarded(disk):
        return _run(disk, progress)


def _refuse_progress(progress) -> None:
    if not (progress in (None, True, False) or callable(progress)):
        raise SceneError(f"progress = {shown(progress)}: must be True, False, None or a function of the fraction done")


def _times(scene, samples) -> np.ndarray:
    if isinstance(samples, int) or np.ndim(samples) == 0:
        count = whole("samples", samples, 2, MOST_SAMPLES)
        times = np.arange(count) * (scene.duration / (count - 1))
        times[-1] = scene.duration
        return times
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


def _to_whole_headways(scene, samples, times) -> tuple[Scene, np.ndarray]:
    """The scene and times that end when evenly spaced cars have each driven a whole number of headways, the nearest.

    What `plan` predicts is the error against the discrete road, which is known at these times alone.
    """
    scene = replace(scene, duration=float(times[-1]))
    if evenly_spaced(scene, scene.fleet.count) is None:
        return scene, times
    end = whole_headways(scene) * scene.headway_time
    if abs(end - times[-1]) <= 1e-9 * end:
        return scene, times
    scene = replace(scene, duration=end)
    return scene, _times(scene, samples) if np.ndim(samples) == 0 else np.append(times[times < end], end)


def rerun(ds, **changes) -> xr.Dataset:
    """Run again what a result of `simulate` was computed from; the same bits on the same machine.

    Scene, model, tolerance, samples and numerics are those that `ds` carries; `changes` are arguments of `simulate` to use
    instead, or besides. What "auto" chose is planned again, unless a model or numerics are named; with another model its
    numerics are chosen anew. StoreError if `ds` does not carry them.
    """
    arguments = arguments_of(ds, planned=not {"model", *KEYWORDS} & set(changes))
    if changes.get("model", arguments["model"]) != arguments["model"]:
        kept = "scene", "tolerance", "samples", "allow_unstable"
        arguments = {name: value for name, value in arguments.items() if name in kept}
    return simulate(**(arguments | changes))


def _run(keeper, progress):
    scene, name, tolerance, given, times, even, allow_unstable, chosen = keeper.job
    if scene.duration != times[-1]:
        scene = replace(scene, duration=float(times[-1]))
    module = model(name)
    outside = None
    try:
        numerics = module.numerics(scene, chosen["numerics"] if chosen else given)
    except StabilityError as refusal:
        if not (allow_unstable and hasattr(module, "unstable_numerics")):
            raise
        outside, numerics = str(refusal), module.unstable_numerics(scene, given)
    if hasattr(module, "fitted"):
        numerics = module.fitted(times, numerics)
    numerics = keeper.numerics or numerics
    if outside:
        warnings.warn(f"{outside}; allow_unstable: run all the same", stacklevel=3)
    # the continuum knows already where cars never take off
    if not (name == "continuum" and linear_throughout(scene, numerics["nodes"], scene.duration)) and (
        text := foreseen(scene)
    ):
        warnings.warn(text, stacklevel=3)
    for attempt in range(keeper.attempt, REFINEMENTS + 1):
        keeper.begin(attempt, numerics)
        begin = clock.perf_counter() - keeper.elapsed
        status = keeper.status or _collect(keeper, module, times, numerics, progress, outside)
        keeper.stepped(status)
        wall_time = clock.perf_counter() - begin
        last = keeper.last
        if outside:
            error, method, estimate_time = float("inf"), "none: outside a stability limit", 0.0
        elif status == "ok":
            begin = clock.perf_counter()
            as_planned = chosen and attempt == 0
            known = chosen["pair_ratio"] if as_planned else None
            if known == np.inf:
                error = chosen["error"]
                finest = "on this grid and on finer ones" if name == "cars" else "of this model and of cars"
                method = f"the plan's runs {finest}"
            else:
                error, method = _error_of(scene, name, numerics, last, known)
                planned = chosen["error"] - chosen["model_error"] if as_planned else 0.0
                if method.startswith("a second run") and error < planned < np.inf:
                    error, method = planned, f"the plan's runs; {method} differs by less"
                if chosen and chosen["model_error"] > 0:
                    error, method = error + chosen["model_error"], f"{method}; the model's own error by the plan"
            estimate_time = clock.perf_counter() - begin
        else:
            error, method, estimate_time = float("inf"), "none: the run diverged", 0.0
        if not error > tolerance or outside or status != "ok":
            break
        if chosen and not chosen["error"] <= tolerance:
            finer = numerics  # the plan has tried finer ones
        elif chosen and name == "cars":
            # no further than order 1 asks for: the plan was near already
            finer = module.finer(scene, numerics, given, min(2.0, error / (MARGIN * tolerance)))
        else:
            finer = module.finer(scene, numerics, given)
        if finer == numerics and given and error < np.inf:
            break
        if attempt == REFINEMENTS or finer == numerics:
            told = f"{error:.2g}" if error < np.inf else f"infinite ({method})"
            warnings.warn(
                f"tolerance = {tolerance:g}: not met, the error estimate is {told} with {numerics}; "
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
        "updates": last.updates,
        "status": status,
        "samples": times.size if even else times,
    }
    if chosen:
        outcome |= {
            "model_error": chosen["model_error"],
            "plan": chosen["reason"],
            "plan_given": json.dumps(given),
            "planning_time": chosen["planning_time"],
        }
    if allow_unstable:
        outcome["allow_unstable"] = 1
    if last.airborne is not None:
        outcome["airborne_passages"] = last.airborne
    return keeper.finish(outcome)


def _error_of(scene, name, numerics, last, known) -> tuple[float, str]:
    """The estimated error and how it was found; infinite where the run it is compared with fails."""
    try:
        with np.errstate(all="ignore"):
            error, method = error_estimate(scene, name, numerics, last, known)
    except TrafficRoadError as failure:
        return float("inf"), f"none: {failure}"
    return (error, method) if np.isfinite(error) else (float("inf"), f"none: {method} diverged")


def _collect(keeper, module, times, numerics, progress, outside) -> str:
    """Give the keeper the samples of a run up to its end or to where it blows up; its status."""
    scene, times = keeper.job.scene, module.sample_times(keeper.job.scene, times, numerics)
    watch = Watch(scene, keeper.job.model, outside, keeper.job.allow_unstable)
    report = progress if callable(progress) else None
    # progress None: only in a terminal, and only for what takes longer than two seconds
    shown = progress is True or (progress is None and sys.stderr is not None and sys.stderr.isatty())
    bar = tqdm(total=len(times), initial=keeper.count, delay=2, leave=False, unit="sample") if shown else None
    with np.errstate(all="ignore"), bar or nullcontext():
        for item in module.samples(scene, times, numerics, keeper.state):
            if isinstance(item, Breath):
                if trouble := watch.trouble(item.heights()):
                    return _diverged(keeper, times, trouble)
                keeper.breathe(item)
                continue
            if not keeper.count and keeper.output is None:
                _refuse_too_many(item, len(times))
            road_height = item.road_height if unbroken_cars(item) else np.full(1, np.nan)
            if trouble := watch.trouble(road_height):
                if not keeper.count and not corrugation(road_height) < RUNAWAY:
                    raise SceneError(
                        f"scene: corrugation {np.ptp(item.road_height):.3g} at the start, must be finite and < {RUNAWAY:g}; "
                        "lower the profile"
                    )
                return _diverged(keeper, times, trouble)
            keeper.append(item)
            if bar is not None:
                bar.update()
            if report is not None:
                report(keeper.count / len(times))
    return "ok"


def _diverged(keeper, times, trouble) -> str:
    return f"diverged between time {keeper.last.time:.6g} and {times[keeper.count]:.6g}: {trouble}"


def _refuse_too_many(sample: Sample, held: int) -> None:
    """SceneError if `held` samples at once, and the Dataset they are stacked to, do not fit in memory."""
    size = sum(np.size(a) for a in sample if isinstance(a, np.ndarray))
    what = f"{held} samples of {sample.road_height.size} nodes"
    refuse_beyond_memory(2.5 * held * size, what, "use fewer samples or nodes")


def unbroken_cars(sample: Sample) -> bool:
    """False where a number of the cars has been lost: a sum with it is none, either."""
    return math.isfinite(np.add.reduce(sample.car_height) + np.add.reduce(sample.contact_force))
