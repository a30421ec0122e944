"""Sweeps: what they compute, that no number of workers, killed worker or killed sweep changes it, and what they refuse."""

import ast
import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import traffic_road as tr
from traffic_road import cli
from traffic_road.measures import MEASURES, measures
from traffic_road.sweeps import _identity, _task, pool
from traffic_road.sweeps.axes import parse_over, scene_at
from traffic_road.sweeps.linear import linear_columns
from traffic_road.sweeps.points import compute
from traffic_road.sweeps.store import PointStore

K, DIFFUSIVITY = 0.9, 0.01
SMALL = replace(tr.preset("paper"), duration=60.0)
OVER = {"road.softness": np.linspace(0.004, 0.006, 5), "fleet.damping": [0.1, -0.5, 0.3], "fleet.count": [7, 8]}
# as where Dask is not installed: xarray loads it wherever it is, which takes each process most of a second
START = 'import sys; sys.modules["dask"] = None; from traffic_road.cli import main; sys.exit(main())'
ARGUMENTS = [
    "sweep",
    "small.toml",
    "--over",
    "road.softness=0.004:0.006:48",
    "-o",
    "o.nc",
    "--workers",
    "2",
    "--tolerance",
    "1e-2",
]


def task(scene=SMALL, over=OVER, **given):
    defaults = {"measure": MEASURES, "wavenumber": None, "members": None, "samples": None, "model": "cars"}
    numerics = {name: given.pop(name) for name in ("nodes",) if name in given}
    return _task(scene, over, **(defaults | {"tolerance": 1e-2} | given), numerics=numerics)


def serial(this):
    """Rows of all points, computed in this process."""
    return dict(compute(this, list(range(int(np.prod(this.shape)))))[0])


def same(ds, rows):
    """The Dataset holds these very rows, bit for bit."""
    for name in ("status", "model", "updates", "error_estimate", "wavenumber", *MEASURES):
        blank = "" if name == "model" else 0 if name == "updates" else np.nan
        expected = np.array([rows[i].get(name, blank) for i in range(len(rows))])
        np.testing.assert_array_equal(ds[name].values.ravel(), expected, err_msg=name)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    replace(SMALL, duration=200.0).to_toml("small.toml")
    return tmp_path


def processes(folder):
    """(pid, pid of the parent) of the processes of sweeps in `folder`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has just ended
            if os.readlink(entry / "cwd") == str(folder) and b"sweeps.pool" in (entry / "cmdline").read_bytes():
                found.append((int(entry.name), int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])))
    return found


# ---------------------------------------------------------------- what it computes


@pytest.fixture(scope="module")
def rows():
    return serial(task())


def test_points_are_runs_of_their_scenes(rows):
    place = (3, 2, 0)  # softness 0.0055, damping 0.3, 7 cars
    scene = tr.Scene(
        tr.Road(SMALL.road.length, OVER["road.softness"][3], DIFFUSIVITY, SMALL.road.profile), tr.Fleet(7, 0.3), 60.0
    )
    ds = tr.simulate(scene, "cars", 1e-2)
    row = rows[np.ravel_multi_index(place, (5, 3, 2))]
    assert row["updates"] == ds.updates and row["error_estimate"] == ds.error_estimate and row["status"] == "ok"
    assert row["amplitude"] == tr.mode(ds, K).amplitude.values[-1] and row["wavenumber"] == pytest.approx(K)
    failed = [row["status"] for row in rows.values() if row["status"] != "ok"]
    assert len(failed) == 10 and all(line.startswith("SceneError: Fleet.damping = -0.5: must be") for line in failed)


def test_measures_of_a_small_wave():
    scene = replace(SMALL, duration=300.0, fleet=tr.Fleet(32, 0.1))
    ds = tr.simulate(scene, "continuum", 1e-6)
    found = measures(ds, scene, MEASURES, K)
    sigma = tr.theory.dispersion(K, softness=0.006, diffusivity=DIFFUSIVITY, damping=0.1)
    assert found["growth_rate"] == pytest.approx(sigma.real, rel=1e-3)  # what is left of the transient
    assert found["phase_velocity"] == pytest.approx(-sigma.imag / K, rel=1e-3)
    assert found["sink_rate"] == pytest.approx(0.006, rel=1e-6) and found["airborne"] == 0


def test_measures_of_a_saturated_wave():
    wave = tr.theory.travelling_wave(K, softness=0.0056, diffusivity=DIFFUSIVITY, damping=0.1)
    road = tr.Road(2 * np.pi / K, 0.0056, DIFFUSIVITY, wave.height.values[::8])
    scene = tr.Scene(road, tr.Fleet(64, 0.1), duration=400.0)
    ds = tr.simulate(scene, "continuum", 1e-5)
    found = measures(ds, scene, MEASURES, K)
    for name in ("amplitude", "sink_rate"):
        assert found[name] == pytest.approx(float(wave[name]), rel=0.02), name
    assert found["phase_velocity"] == pytest.approx(float(wave.velocity), rel=0.02)
    assert found["airborne"] == pytest.approx(float(wave.airborne), abs=0.02) and wave.airborne > 0.05


def test_a_run_that_diverges_is_a_value(folder):
    wild = replace(SMALL, duration=3000.0, lift_off=False)
    (row,) = serial(task(wild, {"road.softness": [0.05]}, model="continuum")).values()
    assert row["status"].startswith("diverged between time") and row["growth_rate"] > 0.005


def test_a_flat_road_has_no_wave_but_sinks():
    flat = replace(SMALL, road=replace(SMALL.road, profile=None))
    (row,) = serial(task(flat, {"road.softness": [0.005]})).values()
    assert "flat road has no wave" in row["status"]
    for model in ("continuum", "linear"):
        this = task(flat, {"road.softness": [0.005]}, measure=("sink_rate", "airborne"), model=model)
        found = linear_columns(this) if model == "linear" else serial(this)[0]
        assert found["sink_rate"] == pytest.approx(0.005, rel=1e-6) and found["airborne"] == 0


def test_members_are_roads_of_their_own():
    noise = replace(SMALL, road=replace(SMALL.road, length=4 * SMALL.road.length, profile=tr.Noise(1e-3, 1.3, seed=5)))
    seeds = task(noise, {"road.softness": [0.005, 0.006]}, members=3).axes[1].values
    spawned = np.random.SeedSequence(5).spawn(3)
    assert seeds == tuple(int(s.generate_state(1, np.uint64)[0] // 2) for s in spawned) and len(set(seeds)) == 3
    ds = tr.sweep(noise, {"road.softness": [0.005, 0.006]}, members=3, model="linear", wavenumber=K)
    one = replace(noise, road=replace(noise.road, profile=tr.Noise(1e-3, 1.3, seed=seeds[1])))
    alone = tr.sweep(one, {"road.softness": [0.005, 0.006]}, model="linear", wavenumber=K)
    np.testing.assert_array_equal(ds.amplitude[:, 1], alone.amplitude)
    assert np.ptp(ds.amplitude.values[0]) > 0  # members differ, points of one member start from one road
    with pytest.raises(tr.SceneError, match="needs a profile of Noise"):
        task(members=2)


# ---------------------------------------------------------------- the linear model


def test_linear_is_the_dispersion_relation():
    over = {"road.softness": np.linspace(1e-3, 0.02, 7), "fleet.damping": [0.05, 0.6], "road.diffusivity": [0.0, 0.01]}
    ds = tr.sweep(SMALL, over, model="linear")
    sigma = tr.theory.dispersion(
        K,
        softness=ds.road_softness.values[:, None, None],
        diffusivity=ds.road_diffusivity.values,
        damping=ds.fleet_damping.values[:, None],
    )
    np.testing.assert_allclose(ds.growth_rate, sigma.real, rtol=1e-12)
    np.testing.assert_allclose(ds.phase_velocity, -sigma.imag / K, rtol=1e-12)
    np.testing.assert_array_equal(ds.sink_rate[:, 0, 0], over["road.softness"])


MIXED = tr.Fleet(
    6, (0.1, 0.2, 0.2, 0.3, 0.1, 0.1), (1, 1.1, 1.1, 0.9, 1, 1), (1, 1, 1, 1.2, 1, 1), (1, 2, 2, 0.5, 1, 1)
)


@pytest.mark.parametrize("start", ["settled", "rest"])
@pytest.mark.parametrize(
    "fleet", [tr.Fleet(8, 0.1), tr.Fleet(8, 0.2, 0.8, 1.3, 1.4), MIXED], ids=["paper", "other", "mixed"]
)
def test_linear_is_the_continuum_without_clip(fleet, start):
    scene = replace(SMALL, lift_off=False, fleet=replace(fleet, start=start))
    over = {"road.softness": [0.004, 0.009], "duration": [30.0, 90.0]}
    found = linear_columns(task(scene, over, model="linear"))
    rows = serial(task(scene, over, model="continuum", tolerance=1e-9))
    sigma = tr.theory.fleet_dispersion(K, fleet, softness=0.009, diffusivity=DIFFUSIVITY)
    assert found["growth_rate"][3] == pytest.approx(sigma.real, rel=1e-12)
    assert found["phase_velocity"][3] == pytest.approx(-sigma.imag / K, rel=1e-12)
    for i, row in rows.items():
        assert found["amplitude"][i] == pytest.approx(row["amplitude"], rel=1e-9)
        assert found["sink_rate"][i] == pytest.approx(row["sink_rate"], rel=1e-2 if start == "rest" else 1e-9)


def test_linear_kinds_of_car_may_differ_in_number():
    over = {"fleet.damping": [0.1, 0.3], "fleet.speed": [1.0, 1.2], "fleet.mass": [1.0, 2.0]}
    fleet = replace(MIXED, frequency=1.0, speed=1.0)
    scene = replace(SMALL, fleet=fleet)
    found = linear_columns(task(scene, over, model="linear"))
    for i, values in enumerate(np.ndindex(2, 2, 2)):
        here = {path: over[path][j] for path, j in zip(over, values, strict=True)}
        sigma = tr.theory.fleet_dispersion(K, scene_at(scene, here).fleet, softness=0.006, diffusivity=DIFFUSIVITY)
        assert found["growth_rate"][i] == pytest.approx(sigma.real, rel=1e-11)


def test_linear_chooses_the_fastest_wave_of_each_point(monkeypatch):
    length = 2 * np.pi / 0.1
    noise = replace(SMALL, road=tr.Road(length, 0.006, 0.01, tr.Noise(1e-3, 1.2, seed=1)))
    over = {"road.diffusivity": np.linspace(0.0, 0.02, 6), "road.profile.max_wavenumber": [0.55, 1.2]}
    found = linear_columns(task(noise, over, model="linear"))
    k = np.arange(1, 13) * 0.1
    for i, (diffusivity, highest) in enumerate((d, h) for d in over["road.diffusivity"] for h in (0.55, 1.2)):
        sigma = tr.theory.dispersion(k[k < highest + 0.01], softness=0.006, diffusivity=diffusivity, damping=0.1)
        assert found["growth_rate"][i] == pytest.approx(sigma.real.max(), rel=1e-12)
        assert found["wavenumber"][i] == pytest.approx(k[np.argmax(sigma.real)])
    monkeypatch.setattr("traffic_road.sweeps.linear.CHUNK", 30)  # in pieces
    for name, values in linear_columns(task(noise, over, model="linear")).items():
        np.testing.assert_array_equal(values, found[name])


def test_linear_points_that_fail_are_values():
    over = {
        "fleet.damping": [-1.0, 0.0, 0.1],
        "road.profile.wavenumber": [0.85, 1.0, 0.9],
        "road.length": [2 * np.pi, 20 * np.pi / 9],
    }
    ds = tr.sweep(SMALL, over, model="linear")
    ok = ds.status == "ok"
    assert ds.status.values[0, 0, 0].startswith("SceneError: Sine.wavenumber = 0.85") and not ok[0].any()
    assert "Fleet.damping = -1.0" in ds.status.values[0, 1, 0]
    assert "resonance" in ds.status.values[1, 1, 0] and ok[1:, 2, 1].all() and ok[2, 1, 0] and ok.sum() == 3
    assert not np.isnan(ds.amplitude.values[ok.values]).any() and np.isnan(ds.amplitude.values[~ok.values]).all()
    wild = tr.sweep(SMALL, {"road.softness": [0.006, 0.05], "duration": [1e3, 1e6]}, model="linear")
    assert [line.split(":")[0] for line in wild.status.values.ravel()] == ["ok", "diverged", "diverged", "diverged"]
    assert wild.airborne[1, 1] == 0.5  # half of an endless wave
    huge = tr.sweep(SMALL, {"fleet.frequency": [1e3, 1e12, 1e200], "fleet.start": ["settled", "rest"]}, model="linear")
    exact = -DIFFUSIVITY * K**2 + 0.006 * K**2  # stiff cars follow the road: omega^2 R = -k^2
    assert (huge.status[0] == "ok").all() and huge.growth_rate[0, 0] == pytest.approx(exact, rel=1e-3)
    assert all("overflow" in line for line in huge.status.values[1:].flat)
    assert np.isnan(huge.amplitude[1:]).all() and np.isnan(huge.growth_rate[1:]).all()


def test_linear_airborne_is_that_of_a_sine():
    over = {"road.profile.amplitude": [0.1, 0.4, 2.0], "duration": [1e-9]}
    found = linear_columns(task(over=over, model="linear"))
    s = tr.theory.dispersion(K, softness=0.006, diffusivity=DIFFUSIVITY, damping=0.1) + 1j * K
    force = np.abs(s**2 / (s**2 + 0.2 * s + 1)) * np.array([0.1, 0.4, 2.0])
    phase = (np.arange(200_000) + 0.5) * (2 * np.pi / 200_000)
    share = (1 + force[:, None] * np.cos(phase) <= 0).mean(axis=1)
    assert share[0] == 0 < share[1] < share[2]
    np.testing.assert_allclose(found["airborne"], share, atol=1e-5)


def test_many_linear_points_take_seconds(folder):
    over = {"road.softness": np.linspace(1e-3, 1e-2, 100), "fleet.damping": np.linspace(0.05, 0.9, 100)}
    begin = time.perf_counter()
    ds = tr.sweep(SMALL, over, model="linear", output="o.nc")
    assert time.perf_counter() - begin < 5  # a tenth of a second, on a quiet machine
    assert (
        ds.attrs["points"] == 10_000 and not ds.attrs["failed"] and sorted(os.listdir(folder)) == ["o.nc", "small.toml"]
    )
    xr.testing.assert_identical(
        tr.sweep(SMALL, over, model="linear", output="o.nc"), ds
    )  # history, too: not computed again


# ---------------------------------------------------------------- workers that die


def test_three_processes_one_of_them_killed(rows, folder):
    """One process is killed when the first points are done; its points are computed by another. Same bits as serially."""
    victims, seen = [], []

    def kill_one(done):
        seen.append(done)
        if not victims:
            victims.extend(pid for pid, parent in processes(folder) if parent == os.getpid())
            os.kill(victims[0], signal.SIGKILL)

    ds = tr.sweep(SMALL, OVER, model="cars", tolerance=1e-2, workers=3, output="o.nc", progress=kill_one)
    same(ds, rows)
    assert len(victims) == 3 and seen[-1] == 1.0 and seen == sorted(seen)
    assert ds.growth_rate.dims == ("road_softness", "fleet_damping", "fleet_count")
    assert ds.road_softness.attrs["path"] == "road.softness" and ds.fleet_count.dtype.kind == "i"
    assert (ds.attrs["points"], ds.attrs["failed"]) == (30, 10)
    assert sorted(os.listdir(folder)) == ["o.nc", "small.toml"]
    xr.testing.assert_identical(tr.open("o.nc"), ds)


def test_a_point_that_kills_every_process_is_a_value():
    batches = pool.Batches(range(4), 1)
    batches.done(batches.take(), 1e-3)
    assert batches.take() == [1]  # near the end one by one
    assert batches.lost([1, 2], "it died") == []
    assert [batches.take(), batches.take()] == [[1], [2]]
    assert batches.lost([2], "it died") == []
    assert batches.take() == [2]
    ((point, row),) = batches.lost([2], "it died")
    assert point == 2 and row["status"].startswith("WorkerError: it died, 2 times")


def test_dask_cluster_with_a_worker_killed(rows):
    distributed = pytest.importorskip("distributed")
    killed = []
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = list(client.run(os.getpid).values())

        def kill_one(done):
            if not killed:
                killed.append(pids[0])
                os.kill(pids[0], signal.SIGKILL)

        ds = tr.sweep(SMALL, OVER, model="cars", tolerance=1e-2, client=client, progress=kill_one)
        assert killed and set(client.run(os.getpid).values()) != set(pids)
        few = {"road.softness": OVER["road.softness"][:1], "fleet.damping": [0.1], "fleet.count": [7]}
        one = tr.sweep(SMALL, few, model="cars", tolerance=1e-2, client=cluster.scheduler_address)
        assert one.amplitude.item() == rows[0]["amplitude"]
    same(ds, rows)


def test_no_scheduler():
    with pytest.raises(tr.TrafficRoadError, match="no Dask scheduler answers"):
        tr.sweep(SMALL, {"duration": [1.0]}, client="tcp//nowhere")
    with pytest.raises(tr.SceneError, match="must be a distributed"):
        tr.sweep(SMALL, {"duration": [1.0]}, client=3)


# ---------------------------------------------------------------- sweeps that die


def process(*arguments):
    command = [sys.executable, "-c", START, *arguments]
    telling = {**os.environ, "PYTHONFAULTHANDLER": "1"}  # where each thread is, should it be stopped by SIGABRT
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=telling)


def said(sweep, timeout):
    """What the process of a sweep, and those it started, have left on stderr when all have ended."""
    begin = time.monotonic()
    try:
        return sweep.communicate(timeout=timeout)[1]
    except subprocess.TimeoutExpired:
        took = time.monotonic() - begin
        alive = [pid for pid, _ in processes(os.getcwd())] + ([sweep.pid] if sweep.poll() is None else [])
        for pid in alive:
            os.kill(pid, signal.SIGABRT)
        pytest.fail(f"not ended after {took:.1f} s: {alive} of {sweep.pid} are alive. {sweep.communicate()[1]}")


def stored():
    """Rows of the store beside o.nc."""
    connection = sqlite3.connect("o.nc.sweep")
    try:
        return {n: json.loads(row) for n, row in connection.execute("SELECT number, row FROM points")}
    finally:
        connection.close()


def wait_for_points(sweep, more_than):
    begin = time.monotonic()
    while time.monotonic() - begin < 30 and sweep.poll() is None:
        if os.path.exists("o.nc.sweep"):
            try:
                connection = sqlite3.connect("file:o.nc.sweep?mode=ro&immutable=1", uri=True)
                if connection.execute("SELECT count(*) FROM points").fetchone()[0] > more_than:
                    return
            except sqlite3.Error:
                pass  # it is being written
            finally:
                connection.close()
        time.sleep(0.02)
    raise AssertionError("no points within 30 s, or all at once")


def test_killed_and_interrupted_sweeps_go_on(folder, monkeypatch):
    scene = tr.Scene.from_toml("small.toml")
    over = parse_over(["road.softness=0.004:0.006:48"])
    before = {}
    for end in (signal.SIGKILL, signal.SIGINT):
        sweep = process(*ARGUMENTS)
        wait_for_points(sweep, len(before) + 2)
        time.sleep(0.1)
        sweep.send_signal(end)
        begin = time.monotonic()
        err = said(sweep, 20)
        after = stored()
        while processes(folder):  # they end with the pipe that fed them
            assert time.monotonic() - begin < 10
            time.sleep(0.05)
        assert before.items() <= after.items() and not os.path.exists("o.nc") and len(after) < 48
        before = after
    assert time.monotonic() - begin < 5 and sweep.returncode == 1  # two seconds, on a quiet machine
    assert err.startswith("traffic-road: interrupted; ") and len(err.splitlines()) == 1
    assert f"{len(before)} of 48 points are finished, and kept in " in err
    asked = []
    original = pool.local

    def spy(this, points, workers):
        asked.extend(points)
        return original(this, points, workers)

    monkeypatch.setattr("traffic_road.sweeps.local", spy)
    ds = tr.sweep(scene, over, tolerance=1e-2, output="o.nc", workers=2)
    assert sorted(asked) == sorted(set(range(48)) - set(before)) and len(asked) < 43
    same(ds, serial(task(scene, over, model="auto")))
    assert sorted(os.listdir(folder)) == ["o.nc", "small.toml"]


def test_what_is_finished_after_the_end_keeps_no_one_waiting():
    # a process may answer between the interrupt and its own end: its thread then asked for ever
    batches, given = pool.Batches(range(5), 1), []
    batch = batches.take()
    batches.close()
    batches.done(batch, 0.1)
    servant = threading.Thread(target=lambda: given.append(batches.take()), daemon=True)
    servant.start()
    servant.join(5)
    assert given == [[]]


@pytest.mark.parametrize("committed", [True, False])
def test_an_interrupt_in_the_midst_of_a_transaction_counts_what_is_on_the_disk(folder, monkeypatch, committed):
    add, kept = PointStore.add, []

    def stop(row):
        raise KeyboardInterrupt

    def interrupted(store, rows):
        if not rows or store.finished() < 2:
            return add(store, rows)
        try:
            with monkeypatch.context() as patch:
                if not committed:
                    patch.setattr(json, "dumps", stop)  # after the transaction has begun
                add(store, rows)
        finally:
            kept.append(store.finished())
        raise KeyboardInterrupt

    monkeypatch.setattr(PointStore, "add", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        tr.sweep(SMALL, {"road.softness": np.linspace(0.004, 0.005, 6)}, tolerance=1e-2, output="o.nc", workers=1)
    assert f"; {kept[0]} of 6 points are finished, and kept in " in str(caught.value)
    assert len(stored()) == kept[0] >= 2 + committed


def test_what_is_complete_is_not_computed_again(folder, monkeypatch):
    over = {"duration": [20.0]}
    ds = tr.sweep(SMALL, over, model="linear", output="o.nc")
    PointStore("o.nc.sweep", {}).close()  # as if killed after the file was renamed
    monkeypatch.setattr("traffic_road.sweeps.linear_columns", None)
    xr.testing.assert_identical(tr.sweep(SMALL, over, model="linear", output="o.nc"), ds)
    assert sorted(os.listdir(folder)) == ["o.nc", "small.toml"]
    with pytest.raises(tr.StoreError, match=r"o\.nc: belongs to another sweep, its duration differs; delete it"):
        tr.sweep(SMALL, {"duration": [21.0]}, model="linear", output="o.nc")
    tr.save(tr.open("o.nc").drop_attrs().assign_attrs(schema=1), "other.nc")
    with pytest.raises(tr.StoreError, match="exists and is not the result of a sweep"):
        tr.sweep(SMALL, over, output="other.nc")


def test_store(tmp_path):
    path = tmp_path / "o.sweep"
    rows = [(i, {"status": "ok", "amplitude": 0.1 * i, "growth_rate": np.nan}) for i in range(5)]
    with_rows = PointStore(path, {"tolerance": 1e-3})
    with_rows.add(rows)
    with pytest.raises(tr.StoreError, match="another sweep is writing it"):
        PointStore(path, {"tolerance": 1e-3})
    with pytest.raises(tr.StoreError, match="UNIQUE"):  # a point counts once, and what comes with it not at all
        with_rows.add([(7, {}), (3, {})])
    with_rows.close()
    again = PointStore(path, {"tolerance": 1e-3})
    assert sorted(again.rows) == [0, 1, 2, 3, 4] and again.rows[3]["amplitude"] == 0.1 * 3
    again.close()
    with pytest.raises(tr.StoreError, match="belongs to another sweep, its tolerance differs"):
        PointStore(path, {"tolerance": 1e-2})
    again = PointStore(path, {"tolerance": 1e-3})
    again.remove()
    assert os.listdir(tmp_path) == []


def test_foreign_stores_are_left_alone(tmp_path):
    path = tmp_path / "o.sweep"
    path.write_bytes(b"something else, and long enough that it is not taken for nothing " * 20)
    content = path.read_bytes()
    with pytest.raises(tr.StoreError, match="is no store of a sweep or is damaged; delete it"):
        PointStore(path, {})
    assert path.read_bytes() == content
    path.unlink()
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE mine (a)")
    connection.close()
    with pytest.raises(tr.StoreError, match="is no store of a sweep; delete it"):
        PointStore(path, {})
    with pytest.raises(tr.StoreError, match="cannot write: unable to open database file"):
        PointStore(tmp_path / "nowhere" / "o.sweep", {})


def test_full_disk(tmp_path):
    store = PointStore(tmp_path / "o.sweep", {})
    store.add([(0, {"status": "ok"})])
    store._connection.execute("PRAGMA max_page_count = 1")
    with pytest.raises(tr.StoreError, match=r"o\.sweep: cannot write: database or disk is full; .* are kept"):
        store.add([(i, {"status": "x" * 1000}) for i in range(1, 100)])
    store.close()
    assert PointStore(tmp_path / "o.sweep", {}).rows == {0: {"status": "ok"}}


def test_identity_tells_sweeps_apart():
    assert _identity(task()) == _identity(task(over={path: list(values) for path, values in OVER.items()}))
    others = [
        task(replace(SMALL, duration=61.0)),
        task(over=OVER | {"road.softness": [0.004]}),
        task(over=dict(reversed(OVER.items()))),
        task(measure=("amplitude",)),
        task(wavenumber=0.9),
        task(samples=50),
        task(samples=[0.0, 1.0, 60.0]),
        task(model="continuum"),
        task(tolerance=1e-4),
        task(nodes=256),
    ]
    found = [json.dumps(_identity(this)) for this in (task(), *others)]
    assert len(set(found)) == len(found)


# ---------------------------------------------------------------- what it refuses


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ({}, "names no field"),
        ([("duration", [1.0])], "must be a dict"),
        ({"road.softnes": [1.0]}, "no such field; road (Road) has length, softness"),
        ({"softness": [1.0]}, "a scene has road, fleet"),
        ({"duration.x": [1.0]}, "duration is a value and has no fields"),
        ({"road.softness.hardening": [0.1]}, "road.softness (Constant) has value"),
        ({3: [1.0]}, "over: 3: no such field"),
        ({"road": [1.0]}, "name one of road.length"),
        ({"road.profile": [1.0]}, "name one of road.profile.amplitude"),
        ({"fleet.position": [1.0]}, "no single value"),
        ({"duration": 3.0}, "must be a sequence"),
        ({"duration": "123"}, "must be a sequence"),
        ({"duration": []}, "has no values"),
        ({"duration": [1.0, 2.0, 1.0]}, "1.0 stands there twice"),
        ({"duration": [1.0, np.nan]}, "over: duration[1] = nan: must be a finite number"),
        ({"duration": ["1"]}, "must be a finite number"),
        ({"duration": [True]}, "must be a finite number"),
        ({"fleet.count": [7.5]}, "must be a whole number"),
        ({"fleet.count": [True]}, "must be a whole number"),
        ({"lift_off": [1]}, "must be True or False"),
        ({"fleet.start": [1]}, "must be a text"),
        ({"road.softness": [0.1], "road.softness.value": [0.2]}, "name one of the two"),
        ({"duration": np.arange(1, 4000), "road.softness": np.arange(1, 4000)}, "15992001 points"),
    ],
)
def test_bad_axes(over, words):
    with pytest.raises(tr.SceneError) as caught:
        tr.sweep(SMALL, over)
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"measure": "height"}, "must be one or more of growth_rate"),
        ({"measure": []}, "must be one or more of"),
        ({"measure": 3}, "must be one or more of"),
        ({"wavenumber": -1}, "wavenumber = -1"),
        ({"samples": "many"}, "samples"),
        ({"model": "trains"}, "must be one of auto, linear, cars"),
        ({"model": ["cars"]}, "must be one of auto, linear, cars"),
        ({"tolerance": 0}, "tolerance = 0"),
        ({"nodez": 3}, "nodez: not a parameter"),
        ({"nodes": 64, "model": "linear"}, "it takes none"),
        ({"workers": 0}, "workers = 0"),
        ({"workers": 2, "client": "tcp://a:1"}, "name workers or client"),
        ({"progress": 3}, "progress = 3"),
    ],
)
def test_bad_arguments(given, words):
    with pytest.raises(tr.SceneError) as caught:
        tr.sweep(SMALL, {"duration": [1.0]}, **given)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_nested_fields_change_at_once():
    hard = replace(SMALL, road=replace(SMALL.road, softness=tr.Exponential(0.006, 0.1)))
    changes = {
        "road.softness.hardening": 0.2,
        "road.length": 4 * np.pi,
        "road.profile.wavenumber": 1.5,
        "lift_off": False,
    }
    scene = scene_at(hard, changes)  # neither length nor wavenumber would fit without the other
    assert scene.road == tr.Road(4 * np.pi, tr.Exponential(0.006, 0.2), DIFFUSIVITY, tr.Sine(1e-3, 1.5))
    assert scene.lift_off is False and scene.fleet == hard.fleet
    assert scene_at(hard, {"road.softness": 0.01}).road.softness == tr.Constant(0.01)


def test_over_from_the_command_line():
    over = parse_over(
        ["road.softness=0.004:0.006:3", "fleet.start=settled,rest", "lift_off=true,false", "fleet.count=7,8"]
    )
    assert over["road.softness"] == pytest.approx([0.004, 0.005, 0.006])
    assert (
        over["fleet.start"] == ["settled", "rest"]
        and over["lift_off"] == [True, False]
        and over["fleet.count"] == [7, 8]
    )
    for text in ("duration", "=1", "duration=", "duration=1:2", "duration=1:2:x", "duration=1:2:0", "duration=1:inf:3"):
        with pytest.raises(tr.SceneError, match="--over"):
            parse_over([text])
    with pytest.raises(tr.SceneError, match="stands there twice"):
        parse_over(["duration=1", "duration=2"])


def test_command_line(folder, capsys):
    arguments = [
        "sweep",
        "small.toml",
        "--over",
        "fleet.damping=-1,0.1",
        "--over",
        "duration=10:20:2",
        "--model",
        "linear",
    ]
    assert cli.main([*arguments, "-o", "o.nc", "--measure", "amplitude,sink_rate"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == ["4 points, 2 ok", "wrote o.nc"]
    assert err.startswith("traffic-road: 2 of 4 points failed, the first with SceneError: Fleet.damping = -1.0")
    ds = tr.open("o.nc")
    assert ds.amplitude.dims == ("fleet_damping", "duration") and "growth_rate" not in ds
    assert cli.main([*arguments, "-o", "o.nc"]) == 2
    assert "belongs to another sweep, its measure differs" in capsys.readouterr().err
    assert cli.main(["plot", "o.nc"]) == 2 and "a sweep has no picture" in capsys.readouterr().err
    assert cli.main(["sweep", "small.toml", "--over", "fleet.damping=-1", "--model", "linear", "-o", "p.nc"]) == 1
    assert cli.main(["sweep", "small.toml", "--over", "fleet.dumping=1", "-o", "q.nc"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2 and sorted(os.listdir()) == ["o.nc", "p.nc", "small.toml"]


def test_dask_is_imported_in_functions_only():
    for path in Path(tr.__file__).parent.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
                assert not {"dask", "distributed"} & {name.split(".")[0] for name in names}, path
