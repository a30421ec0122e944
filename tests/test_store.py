"""Files: every bit comes back, any netCDF reader understands them, and they are whole or not there."""

import json
import os
import stat
import time
from dataclasses import replace
from itertools import count

import netCDF4
import numpy as np
import pytest
import xarray as xr

import traffic_road as tr
from traffic_road import store

SCENE = replace(tr.preset("paper"), duration=30.0, scales=tr.Scales(11.0, 11.0, 200.0))
KINDS = ("cars", "continuum", "compare")
COMMON = ("title", "source", "history", "references", "Conventions", "scene", "model", "tolerance")
OF_A_RUN = ("numerics", "error_estimate", "wall_time", "updates", "status")


@pytest.fixture(scope="module")
def results():
    return {
        "cars": tr.simulate(SCENE, "cars", samples=4, nodes=256),
        "continuum": tr.simulate(SCENE, "continuum", samples=4),
        "compare": tr.compare(SCENE, samples=4, nodes=256),
    }


@pytest.fixture(params=KINDS)
def result(request, results):
    return results[request.param]


def refusal(call, *args):
    with pytest.raises(tr.StoreError) as caught:
        call(*args)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_every_bit_comes_back(result, tmp_path):
    tr.save(result, tmp_path / "a.nc")
    again = tr.open(tmp_path / "a.nc")
    assert again.identical(result)
    for name, values in result.variables.items():
        assert again.variables[name].dtype == values.dtype, name
        assert again.variables[name].values.tobytes() == values.values.tobytes(), name
    tr.save(again, tmp_path / "b.nc")  # and once more
    assert tr.open(tmp_path / "b.nc").identical(result)
    os.unlink(tmp_path / "a.nc")  # nothing holds the file
    assert store.scene_of(again) == SCENE


def test_any_reader_understands_it(result, tmp_path):
    tr.save(result, tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc") as file:
        assert file.data_model == "NETCDF4" and not file.groups
        assert not (file.cmptypes or file.vltypes or file.enumtypes)
        file.set_auto_mask(False)
        for name, values in file.variables.items():
            assert values.dtype is not str and values.dtype.kind in "fiS", name
            if values.dtype.kind != "S":
                np.testing.assert_array_equal(values[:], result[name].values)
                assert values.units == "1"
            assert values.long_name
        for name in file.ncattrs():
            assert np.asarray(file.getncattr(name)).dtype.kind in "fiU"
        assert "_FillValue" not in file["time"].ncattrs()  # CF: a coordinate has no gaps
    with xr.open_dataset(tmp_path / "a.nc") as plain:
        np.testing.assert_array_equal(plain.road_height, result.road_height)
        assert plain.time.dtype == float


def test_attributes(result):
    assert result.attrs["Conventions"] == "CF-1.11"
    assert result.attrs["source"].startswith("traffic_road 0")
    assert "Both" in result.attrs["references"] and "T" in result.attrs["history"]
    assert tr.Scene.from_dict(json.loads(result.attrs["scene"])) == SCENE
    assert tr.Scales(**json.loads(result.attrs["scales"])) == SCENE.scales
    own = [f"{m}_{n}" for m in ("cars", "continuum") for n in OF_A_RUN] if "source" in result.dims else OF_A_RUN
    for name in (*COMMON, *own):
        assert name in result.attrs, name
        if name.endswith("numerics"):
            assert json.loads(result.attrs[name])["nodes"] > 0
        if name.endswith("status"):
            assert result.attrs[name] == "ok"


def test_every_variable_is_described(result):
    for name, values in result.variables.items():
        assert values.attrs["long_name"], name
        assert values.dtype.kind == "U" or values.attrs["units"] == "1", name
    # CF-1.11, 4.4: axis T promises a date in the units, which time in 1/omega_0 has not
    assert "axis" not in result.time.attrs and result.x.attrs["axis"] == "X"
    assert result.road_height.attrs["scale"] == "g/omega_0^2" and result.x.attrs["scale"] == "v/omega_0"


def test_schema(results):
    assert results["cars"].car_height.dims == results["cars"].car_position.dims == ("time", "car")
    assert results["continuum"].contact_force.dims == results["cars"].road_height.dims == ("time", "x")
    x = results["cars"].x
    assert x[0] == 0 and float(x[1] * x.size) == pytest.approx(SCENE.road.length, rel=1e-14)


def test_a_long_profile_is_an_attribute_still(tmp_path):
    road = replace(SCENE.road, profile=np.random.default_rng(0).normal(size=20001))
    scene = replace(SCENE, road=road)
    ds = xr.Dataset(attrs=store.provenance(scene, "long"))  # 400 kB of text
    tr.save(ds, tmp_path / "a.nc")
    assert store.scene_of(tr.open(tmp_path / "a.nc")) == scene


def test_history_survives_any_command_line(monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["/bin/traffic-road", "run", "a b", "\udcff", "Straße\nx"])
    ds = xr.Dataset(attrs=store.provenance(SCENE, "t"))
    assert ds.attrs["history"].isascii() and "traffic-road run 'a b'" in ds.attrs["history"]
    tr.save(ds, tmp_path / "a.nc")
    assert tr.open(tmp_path / "a.nc").identical(ds)


def test_what_is_given_back_is_what_stands_in_the_file(monkeypatch, tmp_path):
    clock = count(978307200)  # 2001; a second passes whenever it is asked
    gmtime = time.gmtime
    monkeypatch.setattr(store.time, "gmtime", lambda *given: gmtime(*given or (next(clock),)))
    first = tr.simulate(SCENE, "linear", samples=2, output=tmp_path / "a.nc")
    assert first.attrs["history"].startswith("2001-01-01") and tr.open(tmp_path / "a.nc").identical(first)


# ---------------------------------------------------------------- atomic writing


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("NetCDF: HDF error"), KeyError])
def test_a_failed_write_leaves_the_old_file(error, results, tmp_path, monkeypatch):
    path = tmp_path / "a.nc"
    path.write_bytes(b"old")

    def half(self, target, **keys):
        with open(target, "wb") as file:
            file.write(b"half")
        raise error

    monkeypatch.setattr(xr.Dataset, "to_netcdf", half)
    expected, words = (KeyError, None) if error is KeyError else (tr.StoreError, "cannot write: (No space|NetCDF: HDF)")
    with pytest.raises(expected, match=words):
        tr.save(results["cars"], path)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["a.nc"]


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()])
def test_a_failed_rename_leaves_the_old_file(error, results, tmp_path, monkeypatch):
    path = tmp_path / "a.nc"
    path.write_bytes(b"old")

    def fail(*args):
        raise error

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises((tr.StoreError, KeyboardInterrupt)):
        tr.save(results["cars"], path)
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["a.nc"]


def test_what_netcdf_cannot_hold(results, tmp_path):
    for values in (np.ones(2, complex), np.array([object(), 1])):
        assert "cannot write" in refusal(tr.save, results["cars"].assign(new=("two", values)), tmp_path / "a.nc")
    assert not os.listdir(tmp_path)


def test_places_that_cannot_be_written(results, tmp_path):
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path, "it is a folder; name a file in it"),
        (tmp_path / "none" / "a.nc", "No such file or directory; name a file in a folder"),
        (tmp_path / "file" / "a.nc", "Not a directory; name a file in a folder"),
        (tmp_path / ("a" * 300), "File name too long"),
        (tmp_path / "pipe", "no regular file"),
        ("/dev/null", "no regular file"),
        ("a\0b", "null byte"),
        ("", "it is a folder"),
        (None, "cannot write"),
    ):
        assert words in refusal(store.refuse_unwritable, path)
        assert words in refusal(tr.save, results["cars"], path)
    assert sorted(os.listdir(tmp_path)) == ["file", "pipe"]
    with pytest.raises(tr.StoreError, match="No such file"):
        tr.simulate(SCENE, output=tmp_path / "none" / "a.nc")


def test_names_and_modes(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkdir("real")
    os.symlink("real/b.nc", "link.nc")
    for path in ("plain.nc", "a" * 250 + ".nc", "ä ö.nc", "link.nc"):
        store.refuse_unwritable(path)
        tr.save(results["cars"], path)
        assert tr.open(path).identical(results["cars"])
    assert os.path.islink("link.nc") and os.path.isfile("real/b.nc")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(os.stat("plain.nc").st_mode) == 0o666 & ~mask
    assert len(os.listdir()) == 5


# ---------------------------------------------------------------- reading


def test_files_that_are_none_of_ours(results, tmp_path):
    tr.save(results["cars"], tmp_path / "a.nc")
    whole = (tmp_path / "a.nc").read_bytes()
    (tmp_path / "cut.nc").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "stub.nc").write_bytes(whole[:8])
    (tmp_path / "text.nc").write_text("hello")
    (tmp_path / "empty.nc").write_bytes(b"")
    xr.Dataset({"a": ("b", [1.0])}).to_netcdf(tmp_path / "foreign.nc")
    ours = {"schema": 1, "source": "traffic_road 0.1.0"}
    for name, changes in {
        "odd": {"schema": "abc"},
        "new": {"schema": 99, "source": "traffic_road 7.0"},
        "zero": {"schema": 0},
        "half": {"schema": 0.5},
        "two": {"schema": np.array([1, 1])},
        "other": {"source": "traffic_lights 1.0"},
        "number": {"source": 3},
        "unsigned": {"source": None},
    }.items():
        attributes = {key: value for key, value in (ours | changes).items() if value is not None}
        xr.Dataset(attrs=attributes).to_netcdf(tmp_path / f"{name}.nc")
    for name, words in (
        ("cut", "cannot read as netCDF"),
        ("stub", "cannot read as netCDF"),
        ("text", "cannot read as netCDF"),
        ("empty", "cannot read as netCDF"),
        ("foreign", "attribute 'schema' is missing"),
        ("odd", "schema 'abc'"),
        ("new", "schema 99, written by 'traffic_road 7.0', is newer than 1, which this version .* reads; update"),
        ("zero", "schema .*0.*: must be a whole number >= 1"),
        ("half", "schema .*0.5"),
        ("two", "schema array"),
        ("other", "written by 'traffic_lights 1.0', not by traffic_road"),
        ("number", "written by .*3"),
        ("unsigned", "attribute 'source' is missing"),
        ("none", "No such file"),
    ):
        text = refusal(tr.open, tmp_path / f"{name}.nc")
        assert text.startswith(f"{tmp_path}/{name}.nc: ")
        with pytest.raises(tr.StoreError, match=words):
            tr.open(tmp_path / f"{name}.nc")
    assert "cannot read" in refusal(tr.open, tmp_path)
    assert "cannot read" in refusal(tr.open, None)
    os.mkfifo(tmp_path / "pipe.nc")  # nobody will ever write to it
    assert "no regular file" in refusal(tr.open, tmp_path / "pipe.nc")
    assert "No such file" in refusal(tr.open, "http://localhost:1/a.nc")


def test_scene_missing_or_damaged(results):
    for attributes in ({}, {"scene": "{"}, {"scene": "{}"}, {"scene": 3}):
        assert "attribute 'scene'" in refusal(store.scene_of, xr.Dataset(attrs=attributes))


# ---------------------------------------------------------------- running again

AGAIN = {
    "even": (SCENE, {"model": "cars", "samples": 7, "nodes": 256}),
    "even, refined": (SCENE, {"model": "cars", "samples": 3, "tolerance": 2e-3}),
    "rare relaxation": (SCENE, {"model": "cars", "samples": [0.0, 3.3, 9.1, 30.0], "nodes": 256, "relax_every": 3}),
    "mixed": (
        replace(SCENE, fleet=tr.Fleet(3, (0.1, 0.2, 0.3), speed=(1, 1.1, 0.7))),
        {"model": "cars", "samples": 5, "nodes": 60},
    ),
    "continuum": (SCENE, {"model": "continuum", "samples": [0.0, 1 / 3, 7.0, 20.0]}),
    "noise": (
        replace(SCENE, road=replace(SCENE.road, profile=tr.Noise(1.0, 3.0, 5), softness=tr.Exponential(0.1, 1 / 3))),
        {"model": "continuum", "samples": 4},
    ),
    "auto": (
        replace(SCENE, road=replace(SCENE.road, softness=tr.Exponential(0.006, 0.3))),
        {"samples": 3, "tolerance": 1e-2},
    ),
    "auto, some given": (SCENE, {"samples": 3, "tolerance": 1e-2, "hold": 3}),
    "diverged, for study": (
        replace(SCENE, road=replace(SCENE.road, softness=0.05), duration=3000.0),
        {"model": "continuum", "samples": 31, "nodes": 32, "allow_unstable": True},
    ),
    "diverged": (
        replace(SCENE, road=replace(SCENE.road, softness=0.05), lift_off=False, duration=3000.0),
        {"model": "cars", "samples": 31, "nodes": 64},
    ),
    "diverged, at times": (
        replace(SCENE, road=replace(SCENE.road, softness=0.05), lift_off=False, duration=3000.0),
        {"model": "continuum", "samples": np.linspace(0, 3000, 13)},
    ),
}


def same_run(one, other):
    """Every bit the same, and every attribute but when and how fast."""
    for name, values in one.variables.items():
        assert other.variables[name].values.tobytes() == values.values.tobytes(), name
    changing = {"history", "wall_time", "error_wall_time", "planning_time"}
    for name in one.attrs.keys() - changing:
        np.testing.assert_array_equal(other.attrs[name], one.attrs[name], name)
    assert set(one.variables) == set(other.variables) and set(one.attrs) == set(other.attrs)


@pytest.mark.parametrize("name", AGAIN)
def test_a_stored_result_runs_again_to_the_same_bits(name, tmp_path):
    scene, arguments = AGAIN[name]
    first = tr.simulate(scene, output=tmp_path / "a.nc", **arguments)
    assert first.status.startswith("diverged") == name.startswith("diverged")
    stored = tr.open(tmp_path / "a.nc")
    assert stored.identical(first)
    same_run(first, tr.rerun(stored))
    if not name.startswith("diverged"):  # its own times say as much
        numerics = json.loads(stored.numerics)
        again = tr.simulate(scene, stored.model, stored.tolerance, stored.time.values, **numerics)
        assert again.road_height.values.tobytes() == first.road_height.values.tobytes()


def test_running_again_with_changes(results):
    cars = results["cars"]
    finer = tr.rerun(cars, nodes=512)
    assert finer.x.size == 512 and finer.time.size == 4 and json.loads(finer.numerics)["hold"] == 3
    assert tr.rerun(cars, samples=3).time.size == 3
    chosen = tr.simulate(SCENE, tolerance=1e-2, samples=2)
    assert "plan" in tr.rerun(chosen, tolerance=1e-1).attrs  # made anew, but not of what is named
    assert "plan" not in tr.rerun(chosen, nodes=2 * chosen.x.size).attrs
    other = tr.rerun(cars, model="continuum")  # whose numerics are its own
    assert other.model == "continuum" and other.road_height.equals(results["continuum"].road_height)
    si = tr.to_si(cars, SCENE.scales)
    same_run(cars, tr.rerun(si))  # what was run was run in the paper's units


def test_no_result_to_run_again(results):
    assert "missing or damaged" in refusal(tr.rerun, results["compare"])
    assert "no Dataset" in refusal(tr.rerun, SCENE)
    for attributes in (
        {"numerics": "{"},
        {"numerics": "[1]"},
        {"samples": "many"},
        {"model": None},
        {"model": np.ones(2)},
    ):
        ds = results["cars"].copy()
        ds.attrs = {key: value for key, value in (ds.attrs | attributes).items() if value is not None}
        assert "missing or damaged" in refusal(tr.rerun, ds)
    with pytest.raises(tr.SceneError, match="model = 'truck'"):
        tr.rerun(results["cars"].assign_attrs(model="truck"))


@pytest.mark.parametrize("model", ["cars", "continuum"])
def test_the_dataset_is_what_its_constructor_makes(model):
    ds = tr.simulate(tr.preset("paper"), model, samples=3, tolerance=1.0)
    parts = ({n: (v.dims, v.values, v.attrs) for n, v in part.items()} for part in (ds.data_vars, ds.coords))
    made = xr.Dataset(*parts, ds.attrs)
    assert ds.identical(made) and ds.sizes == made.sizes and list(ds.indexes) == list(made.indexes)
    assert ds.sel(x=ds.x[5], time=0.0).identical(made.sel(x=made.x[5], time=0.0))
    assert ds.isel(time=0).copy(deep=True).to_dict() == made.isel(time=0).to_dict()
    assert xr.concat([ds, ds.assign_coords(time=ds.time + 1e6)], "time").sizes["time"] == 2 * ds.sizes["time"]
