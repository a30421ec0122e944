"""The table of variables, provenance, and netCDF files that are either whole or not there."""

from __future__ import annotations

import errno
import json
import os
import shlex
import stat
import sys
import tempfile
import time
import zlib
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import xarray as xr
from xarray.indexes import PandasIndex

from .errors import StoreError, TrafficRoadError, shown
from .scales import HEIGHT, LENGTH, RATE, SINK_RATE, TIME, VELOCITY
from .scene import Scene

SCHEMA = 1
VERSION = version("traffic_road")  # looked up once: it searches the installed packages
TEMPORARY = ".traffic_road-"  # how names of unfinished files begin
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
FORCE = "static load of the reference car"

# name: (long_name, scale of the dimensionless value)
VARIABLES = {
    "time": ("time", TIME),
    "x": ("distance along the road", LENGTH),
    "car": ("number of the car", None),
    "road_height": ("height of the road surface", HEIGHT),
    "car_height": ("height of the car's mass", HEIGHT),
    "contact_force": ("force of the wheel on the road", FORCE),
    "car_position": ("last node that the car has crossed", LENGTH),
    "amplitude": ("amplitude of one wave of the road", HEIGHT),
    "phase": ("phase of one wave of the road, unwrapped", None),
    "growth_rate": ("growth rate of one wave of the road", RATE),
    "phase_velocity": ("velocity of one wave of the road", VELOCITY),
    "model": ("how the road was computed", None),
    "source": ("where a growth rate comes from", None),
    "growth_rate_difference": ("growth rate relative to that of the cars, minus 1", None),
    "phase_velocity_difference": ("phase velocity relative to that of the cars, minus 1", None),
    "wavenumber": ("wavenumber of the wave that is measured, times v/omega_0", None),
    "sink_rate": ("rate at which the mean height of the road falls", SINK_RATE),
    "airborne": ("share of the contact forces that are not above zero", None),
    "error_estimate": ("relative error of the corrugation at the end, by the equations of its model", None),
    "updates": ("road-node updates done", None),
    "status": ("whether the run is whole", None),
}
AXES = {"x": "X"}  # not time: axis T promises a date, and dimensionless or elapsed time has none


def describe(name: str) -> dict:
    """CF attributes of a variable of the table."""
    long_name, scale = VARIABLES[name]
    attributes = {"long_name": long_name}
    if name not in ("model", "source", "status"):
        attributes["units"] = "1"
    if scale is not None:
        attributes["scale"] = scale
    if name in AXES:
        attributes["axis"] = AXES[name]
    return attributes


def variable(name: str, dims, values) -> xr.Variable:
    """One variable of the table, with its attributes."""
    return xr.Variable((dims,) if isinstance(dims, str) else dims, np.asarray(values), describe(name), fastpath=True)


def origin() -> dict:
    """Dataset attributes that say by what a file was written, when, and by which conventions."""
    return {
        "Conventions": "CF-1.11",
        "source": f"traffic_road {VERSION}",
        "history": history(),
        "references": "J. A. Both, D. C. Hong and D. A. Kurtze, Corrugation of roads, Physica A 301 (2001) 545-559",
    }


def history() -> str:
    """The line that says when, and by which command."""
    return f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} {_command(tuple(sys.argv))}"


@lru_cache(maxsize=1)
def _command(argv: tuple) -> str:
    return shlex.join([Path(argv[0]).name, *argv[1:]]).encode("ascii", "backslashreplace").decode()


def provenance(scene: Scene, title: str) -> dict:
    """Dataset attributes that say what was run, by what, when."""
    plain = scene.to_dict()
    attributes = {
        **origin(),
        "title": title,
        "schema": SCHEMA,
        "scene": json.dumps(plain),
        "passages_per_time": 1.0 / scene.headway_time,
    }
    if scene.scales is not None:
        attributes["scales"] = json.dumps(plain["scales"])
    return attributes


def assemble(scene: Scene, model: str, numerics: dict, samples: list, outcome: dict) -> xr.Dataset:
    """`dataset` of samples as `models` yield them."""
    names = {"time": "time", "road_height": "road_height", "car_height": "car_height", "contact_force": "contact_force"}
    if samples[0].where is not None:
        names["car_position"] = "where"
    columns = {name: np.array([getattr(s, field) for s in samples]) for name, field in names.items()}
    return dataset(scene, model, numerics, columns, outcome)


def dataset(scene: Scene, model: str, numerics: dict, columns: dict, outcome: dict) -> xr.Dataset:
    """The Dataset of one run: `columns` are its variables by name, time first in each, taken as they are and no copies;
    `outcome`: the remaining attributes."""
    cars = "car_position" in columns
    on = ("time", "car" if cars else "x")
    dims = {"road_height": ("time", "x")}
    nodes = columns["road_height"].shape[1]
    axes = {"time": columns["time"], "x": np.arange(nodes) * (scene.road.length / nodes)}
    if cars:
        axes["car"] = np.arange(columns["car_position"].shape[1], dtype=np.int32)
    # what xr.Dataset(variables, axes, attributes) comes to, in a sixth of its time: nothing here needs to be aligned
    variables = {name: variable(name, dims.get(name, on), columns[name]) for name in columns if name != "time"}
    indexes = {}
    for name, values in axes.items():
        index = pd.Index._simple_new(values, name)  # pd.Index would look at values that are floats or int32
        indexes[name] = PandasIndex(index, name, coord_dtype=values.dtype, fastpath=True)
        variables |= indexes[name].create_variables()
        variables[name].attrs = describe(name)
    attributes = provenance(scene, f"Corrugation of a road, {model} model")
    attributes |= {"model": model, "numerics": json.dumps(numerics)} | outcome
    sizes = {name: values.size for name, values in axes.items()}
    return xr.Dataset._construct_direct(variables, set(axes), sizes, attributes, indexes)


def refuse_unwritable(path) -> None:
    """StoreError now rather than after a long run, if nothing could be written at `path`."""
    try:
        target = _target(path)
        with tempfile.NamedTemporaryFile(dir=target.parent, prefix=_prefix(target)):
            pass
    except (OSError, ValueError, TypeError) as error:
        raise unwritable(path, error) from None


def replace_file(path, write) -> None:
    """Call write(temporary path in the same folder), then rename: `path` is the old file or the whole new one.

    StoreError if it cannot be written; whatever happens, no temporary file is left.
    """
    temporary = None
    try:
        target = _target(path)
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=_prefix(target), suffix=target.suffix)
        os.close(handle)
        write(temporary)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)  # mkstemp's own mode would hide the file from everybody else
        os.replace(temporary, target)
    except (OSError, RuntimeError, ValueError, TypeError) as error:  # netCDF4 says RuntimeError when the disk is full
        raise unwritable(path, error) from error
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)


def _prefix(target: Path) -> str:
    """How the names of unfinished files in the place of `target` begin."""
    return f"{TEMPORARY}{zlib.crc32(os.fsencode(target.name)):08x}-"


def clear_unfinished(path) -> None:
    """Remove what a process that was killed while it wrote `path` has left."""
    target = _target(path)
    for leftover in target.parent.glob(_prefix(target) + "*"):
        leftover.unlink(missing_ok=True)


def _target(path) -> Path:
    """The file that `path` means, links followed; OSError if it is a folder or a device, or its name is too long."""
    target = Path(os.path.realpath(path))
    try:
        mode = os.lstat(target).st_mode
    except FileNotFoundError:
        return target
    if stat.S_ISDIR(mode):
        raise OSError("it is a folder; name a file in it")
    if not stat.S_ISREG(mode):  # a rename would put a file in the place of /dev/null
        raise OSError("it is no regular file; name another")
    return target


def unwritable(path, error: Exception) -> StoreError:
    remedy = ""
    if getattr(error, "errno", None) in FULL:
        remedy = "; make room"
    elif getattr(error, "strerror", None):
        remedy = "; name a file in a folder that exists and can be written"
    return StoreError(f"{path}: cannot write: {_reason(error)}{remedy}")


def _reason(error: Exception) -> str:
    """What went wrong, in one line."""
    return getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]


def save(ds: xr.Dataset, path) -> None:
    """Write `ds` as netCDF-4, atomically. StoreError if that is impossible."""
    encoding = {}
    for name, values in ds.variables.items():
        if values.dtype.kind == "U":
            encoding[name] = {"dtype": "S1"}  # characters: strings are unknown to older readers
        elif values.dtype.kind == "f":
            encoding[name] = {"_FillValue": None} if name in ds.coords else {"_FillValue": np.nan}
    replace_file(path, lambda temporary: ds.to_netcdf(temporary, engine="netcdf4", encoding=encoding))


def write_blocks(path, template: xr.Dataset, count: int, blocks) -> None:
    """What `save` writes, of `count` times: `template` holds the first, blocks() gives (first, records) of some at a time.

    Records are those of a structured array, by the names of the variables. StoreError if it cannot be written.
    """

    def write(temporary):
        with netCDF4.Dataset(temporary, "w") as file:
            for name, size in template.sizes.items():
                file.createDimension(name, count if name == "time" else size)
            for name, values in template.variables.items():
                fill = np.nan if values.dtype.kind == "f" and name not in template.coords else False
                out = file.createVariable(name, values.dtype, values.dims, fill_value=fill)
                out.setncatts(values.attrs)
                if "time" not in values.dims:
                    out[:] = values.values
            file.setncatts(template.attrs)
            for first, records in blocks():
                for name in records.dtype.names:
                    if name in template.variables:
                        file[name][first : first + records.size] = records[name]

    replace_file(path, write)


def open_dataset(path) -> xr.Dataset:
    """A file that this package wrote, read whole into memory (the file is closed). StoreError for any other file."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would wait for a writer; an address is no file either
            raise OSError("it is no regular file")
        with xr.open_dataset(path, engine="netcdf4", decode_times=False) as stored:
            ds = stored.load()
    except Exception as error:  # damaged bytes take the readers beneath by surprise in many ways
        raise StoreError(
            f"{path}: cannot read as netCDF: {_reason(error)}; name a file written by traffic_road"
        ) from None
    for name in ("schema", "source"):
        if name not in ds.attrs:
            raise StoreError(
                f"{path}: no result of traffic_road: attribute {name!r} is missing; name a file written by it"
            )
    schema, source = ds.attrs["schema"], ds.attrs["source"]
    if not isinstance(schema, (int, np.integer)) or schema < 1:
        raise StoreError(f"{path}: schema {shown(schema)}: must be a whole number >= 1; name a file of traffic_road")
    if schema > SCHEMA:
        raise StoreError(
            f"{path}: schema {schema}, written by {shown(source)}, is newer than {SCHEMA}, which this version "
            f"({VERSION}) reads; update traffic_road"
        )
    if not isinstance(source, str) or not source.startswith("traffic_road "):
        raise StoreError(f"{path}: written by {shown(source)}, not by traffic_road; name a file written by it")
    for name, values in list(ds.variables.items()):
        values.encoding.clear()
        if values.dtype.kind == "O":
            ds[name] = values.astype(str)  # as it was saved
    return ds


def scene_of(ds: xr.Dataset) -> Scene:
    """The scene that a result was computed from. StoreError if it does not carry one."""
    try:
        return Scene.from_dict(json.loads(ds.attrs["scene"]))
    except (KeyError, TypeError, ValueError, RecursionError, TrafficRoadError) as error:
        raise StoreError(
            f"attribute 'scene' of the Dataset is missing or damaged: {shown(error)}; run it again"
        ) from None


def arguments_of(ds: xr.Dataset, planned: bool = False) -> dict:
    """The arguments of `simulate` that a result was computed with; planned: where "auto" chose, those given to it.

    StoreError if `ds` does not carry them.
    """
    if not isinstance(ds, xr.Dataset):
        raise StoreError(f"{shown(ds)}: no Dataset; open a file by traffic_road.open")
    scene = scene_of(ds)
    try:
        numerics = json.loads(ds.attrs["numerics"])
        arguments = {name: ds.attrs[name] for name in ("model", "tolerance", "samples")}
        if not isinstance(arguments["model"], str):
            raise TypeError(f"model = {arguments['model']!r}")
        if np.ndim(arguments["samples"]) == 0:
            arguments["samples"] = int(arguments["samples"])
        if ds.attrs.get("allow_unstable"):
            arguments["allow_unstable"] = True
        if planned and "plan_given" in ds.attrs:
            arguments["model"], numerics = "auto", json.loads(ds.attrs["plan_given"])
        return {"scene": scene, **arguments, **numerics}
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise StoreError(
            f"attributes of the Dataset that say how it was run are missing or damaged: {shown(error)}; "
            "give a result of simulate, or its scene"
        ) from None
