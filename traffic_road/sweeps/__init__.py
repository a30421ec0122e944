"""Many scenes, one Dataset. The folder is not called `sweep` as its function is: the one name would hide the other.

axes: which scenes. points: one of them. linear: all of them in closed form. pool: who computes. store: what is finished.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import closing

import numpy as np
import xarray as xr
from tqdm import tqdm

from ..errors import SceneError, StoreError, shown
from ..laws import finite, whole
from ..measures import MEASURES
from ..models import MODELS
from ..models import model as module_of
from ..scene import Scene
from ..store import VERSION, open_dataset, provenance, refuse_unwritable, save, variable
from .axes import checked_axes
from .linear import linear_columns
from .points import Task
from .pool import cores, local, on_cluster
from .store import PointStore, discard, refuse_other

MOST_WORKERS = 1000


def sweep(
    scene,
    over,
    *,
    measure=MEASURES,
    wavenumber=None,
    members=None,
    samples=None,
    model="auto",
    tolerance=1e-3,
    output=None,
    workers=None,
    client=None,
    progress=None,
    **numerics,
) -> xr.Dataset:
    """Run `scene` with every combination of the values in `over`, and return what each run came to.

    over: path of a field -> its values, as {"road.softness": [0.004, 0.006], "fleet.damping": np.linspace(0.1, 0.3, 9)};
    nested fields, too ("road.softness.hardening", "road.profile.wavenumber"). members: so many roads of the scene's Noise
    besides, their seeds spawned from its own; without, all points start from the same road. measure: names among
    growth_rate, phase_velocity, amplitude (of one wave), sink_rate, airborne; see `measures` for what each is.
    wavenumber: of the wave that is measured; None for that of the profile or the fastest growing one that it has.

    model, tolerance, numerics: as in `simulate`; "linear" takes all points at once through the closed form in the
    continuum limit, where the number of cars does not count (see `linear_columns`), 10^5 of them in seconds. samples: as
    in `simulate`; None for 101, or more where the wave would turn too far between two. output: netCDF file. Points that
    are finished are kept in OUTPUT.sweep until that file is complete: the same call goes on where one was interrupted.
    workers: processes on this machine, None for as many as there are cores, each with one thread. client: a
    distributed.Client, or the address of its scheduler, to compute on a Dask cluster. progress: True, False, None for a
    bar in a terminal, or a function that is given the fraction done.

    Dataset over one dimension per path (dots become underscores): the measures, wavenumber, status ("ok", where a run
    diverged, or the error of a scene that cannot be run), model, error_estimate, updates; NaN, "" and 0 where a point
    failed. Bits do not depend on the number of workers. Raises SceneError, StoreError, TrafficRoadError.
    """
    task = _task(scene, over, measure, wavenumber, members, samples, model, tolerance, numerics)
    if not (progress in (None, True, False) or callable(progress)):
        raise SceneError(f"progress = {shown(progress)}: must be True, False, None or a function of the fraction done")
    if workers is not None:
        workers = whole("workers", workers, 1, MOST_WORKERS)
        if client is not None:
            raise SceneError("workers: of a cluster are its own; name workers or client")
    identity = _identity(task)
    if output is not None:
        refuse_unwritable(output)
        if os.path.exists(output):
            found = _finished(output, identity)
            discard(_store_path(output))  # killed between the file and this
            return found
    if task.model == "linear":
        columns = linear_columns(task)
    else:
        columns = _columns(task, _run(task, identity, output, workers, client, progress))
    ds = _assemble(task, identity, columns)
    if output is not None:
        save(ds, output)
        discard(_store_path(output))
    return ds


def _task(scene, over, measure, wavenumber, members, samples, model, tolerance, numerics) -> Task:
    """The arguments, checked."""
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {shown(scene)}: must be a Scene; preset(name) and Scene.from_toml(path) give one")
    names = (measure,) if isinstance(measure, str) else tuple(measure) if np.iterable(measure) else ()
    unknown = [name for name in names if name not in MEASURES]
    if not names or unknown or len(set(names)) < len(names):
        raise SceneError(f"measure = {shown(measure)}: must be one or more of {', '.join(MEASURES)}")
    if wavenumber is not None:
        wavenumber = finite("wavenumber", wavenumber, above=0)
    if samples is not None:
        samples = int(samples) if isinstance(samples, np.integer) else samples
        if not isinstance(samples, int):
            samples = tuple(finite(f"samples[{i}]", time) for i, time in enumerate(np.atleast_1d(samples)))
    if model not in ("auto", "linear", *MODELS):
        raise SceneError(
            f"model = {shown(model)}: must be one of {', '.join(dict.fromkeys(('auto', 'linear', *MODELS)))}"
        )
    if numerics:
        used = {"linear": (), "auto": ("cars", "continuum")}.get(model, (model,))
        known = list(
            dict.fromkeys(key for name in used for key in (*module_of(name).numerics(scene, {}), "allow_unstable"))
        )
        wrong = [name for name in numerics if name not in known]
        if wrong:
            raise SceneError(f"{wrong[0]}: not a parameter of the {model} model; it takes {', '.join(known) or 'none'}")
        numerics = {name: value.item() if isinstance(value, np.generic) else value for name, value in numerics.items()}
    tolerance = finite("tolerance", tolerance, above=0)
    return Task(scene, checked_axes(scene, over, members), names, wavenumber, samples, model, tolerance, numerics)


def _identity(task: Task) -> dict:
    """Which sweep this is, in short plain values: two that agree in these have the same points and bits."""
    plain = {"traffic_road": VERSION, "scene": _digest(task.scene.to_dict())}
    plain |= {axis.path: _digest(axis.values) for axis in task.axes}
    plain["order of paths"] = [axis.path for axis in task.axes]
    plain |= {name: getattr(task, name) for name in ("measure", "wavenumber", "model", "tolerance", "numerics")}
    plain["samples"] = _digest(task.samples)
    return json.loads(json.dumps(plain))


def _digest(values) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:16]


def _store_path(output):
    return os.path.realpath(output) + ".sweep"


def _finished(output, identity) -> xr.Dataset:
    """The Dataset at `output`, if it is that of this sweep; StoreError if it is anything else."""
    try:
        ds = open_dataset(output)
        found = json.loads(ds.attrs["sweep"])
    except (StoreError, KeyError, TypeError, ValueError):
        raise StoreError(f"{output}: exists and is not the result of a sweep; delete it or name another file") from None
    refuse_other(output, found, identity)
    return ds


def _run(task, identity, output, workers, client, progress) -> dict[int, dict]:
    """Rows of all points: those in the store, and the rest computed now."""
    points = int(np.prod(task.shape))
    store = PointStore(_store_path(output), identity) if output is not None else None
    rows = dict(store.rows) if store is not None else {}
    missing = [point for point in range(points) if point not in rows]
    report = progress if callable(progress) else None
    disable = None if progress is None else progress is not True  # None: a bar only in a terminal
    try:
        with (
            _computed(task, missing, workers, client) as finished,
            tqdm(total=points, initial=len(rows), disable=disable, leave=False, unit="point") as bar,
        ):
            for some in finished:
                if store is not None and some:
                    store.add(some)
                rows.update(some)
                bar.update(len(some))
                if report is not None and some:
                    report(len(rows) / points)
    except KeyboardInterrupt:
        kept = f"kept in {store.path}; the same sweep again goes on from there" if store is not None else "lost"
        # asked of the store: Ctrl-C may come between the commit of some rows and their entry in `rows`
        done = len(rows) if store is None else store.finished()
        raise KeyboardInterrupt(f"interrupted; {done} of {points} points are finished, and {kept}") from None
    finally:
        if store is not None:
            store.close()
    return rows


def _computed(task, missing, workers, client):
    """The rows of the missing points as they are finished, to be closed when no more are wanted."""
    if client is not None and missing:
        return closing(on_cluster(task, missing, client))
    return closing(local(task, missing, workers or cores()))


def _columns(task, rows) -> dict[str, np.ndarray]:
    """Rows of all points as arrays (points,)."""
    order = [rows[point] for point in range(len(rows))]
    blank = {"status": "", "model": "", "updates": 0} | dict.fromkeys(
        ("error_estimate", "wavenumber", *task.measure), np.nan
    )
    return {name: np.array([row.get(name, nothing) for row in order]) for name, nothing in blank.items()}


def _assemble(task, identity, columns) -> xr.Dataset:
    """The Dataset of a sweep from its columns, arrays (points,)."""
    dims = [axis.dim for axis in task.axes]
    coordinates = {}
    for axis in task.axes:
        about = {"long_name": f"{axis.path} of the scene", "path": axis.path}
        if isinstance(axis.values[0], (int, float)) and not isinstance(axis.values[0], bool):
            about["units"] = "1"
        coordinates[axis.dim] = xr.Variable(axis.dim, np.array(axis.values), about)
    variables = {
        name: variable(name, dims, values.astype(str if values.dtype == object else values.dtype).reshape(task.shape))
        for name, values in columns.items()
    }
    bad = columns["status"] != "ok"
    attributes = provenance(
        task.scene, f"Corrugation of roads, a sweep over {', '.join(axis.path for axis in task.axes)}"
    )
    del attributes["passages_per_time"]  # of the scene that the points differ from
    attributes |= {
        "model": task.model,
        "numerics": json.dumps(task.numerics),
        "tolerance": task.tolerance,
        "points": bad.size,
        "failed": int(bad.sum()),
        "status": "ok" if not bad.any() else f"{int(bad.sum())} of {bad.size} points failed, see status",
        "sweep": json.dumps(identity),
    }
    if task.model == "linear":
        attributes["comment"] = (
            "small waves of the continuum, laws and hardening rate frozen at the start; no error estimate"
        )
    return xr.Dataset(variables, coordinates, attributes)
