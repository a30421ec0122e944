"""Sweeps: what a second worker is worth, how long 10^5 linear points take, and what SIGKILL costs.

Top left: 64 scenes of cars (8 softnesses, 8 dampings) by one process and by two, starting up included. Top right: a sweep
that is killed at random moments and started again with the same command; each point on the line is what its store held
after a kill (squares: complete). No finished point was lost, changed or computed again: its store takes a point once.
Bottom: 10^5 points of the linear model; corrugations begin at the black line.

Run: python experiments/sweep_speed.py [--quick]        (about 2 minutes; 10 s)
"""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

import traffic_road as tr
from traffic_road.plots import BLUE, ORANGE
from traffic_road.store import TEMPORARY

PAPER = tr.preset("paper")
BAR = 1.8  # what two workers must be worth on 64 scenes
# as where Dask is not installed: xarray loads it wherever it is, which takes each process most of a second
COMMAND = 'import sys; sys.modules["dask"] = None; from traffic_road.cli import main; sys.exit(main())'


def rates(side: int, duration: float, repeats: int) -> dict[int, float]:
    """Seconds that side*side scenes of cars take by 1 and by 2 workers, best of some; results must be the same bits."""
    over = {"road.softness": np.linspace(0.003, 0.006, side), "fleet.damping": np.linspace(0.1, 0.3, side)}
    scene = replace(PAPER, duration=duration)
    seconds, results = {1: np.inf, 2: np.inf}, []
    for workers in (1, 2) * repeats:
        begin = time.perf_counter()
        results.append(tr.sweep(scene, over, model="cars", nodes=256, workers=workers, progress=False))
        seconds[workers] = min(seconds[workers], time.perf_counter() - begin)
    assert np.all(results[0].status == "ok") and results[0].drop_attrs().identical(results[1].drop_attrs())
    print(
        f"{side**2} scenes of cars: {seconds[1]:.1f} s by 1 worker, {seconds[2]:.1f} s by 2, "
        f"{seconds[1] / seconds[2]:.2f} times as fast"
    )
    return seconds


def linear(softnesses: int, dampings: int) -> tuple[xr.Dataset, float]:
    """The paper's wave at so many softnesses and dampings, and the seconds that took."""
    over = {"road.softness": np.linspace(0.001, 0.01, softnesses), "fleet.damping": np.linspace(0.05, 0.4, dampings)}
    begin = time.perf_counter()
    ds = tr.sweep(PAPER, over, model="linear", progress=False)
    seconds = time.perf_counter() - begin
    print(f"{ds.growth_rate.size} points of the linear model: {seconds:.2f} s")
    sigma = tr.theory.dispersion(
        0.9, softness=ds.road_softness.values[:, None], diffusivity=0.01, damping=ds.fleet_damping.values
    )
    assert np.abs(ds.growth_rate - sigma.real).max() < 1e-15  # rounding; on the black line the rate itself is nothing
    return ds, seconds


def kills(wanted: int, points: int, workers: int) -> list[list[int]]:
    """Points in the store after each kill, a list for each sweep that was brought to its end."""
    scene = replace(PAPER, duration=200.0)
    over = ["--over", f"road.softness=0.003:0.005:{points}", "--tolerance", "1e-2", "--model", "cars"]
    over += ["--workers", str(workers)]
    rng = np.random.default_rng(np.random.SeedSequence(1))
    lives: list[list[int]] = [[]]
    with tempfile.TemporaryDirectory() as folder:
        scene.to_toml(Path(folder, "scene.toml"))
        command = [sys.executable, "-c", COMMAND, "sweep", "scene.toml", *over]
        begin = time.perf_counter()
        subprocess.run([*command, "-o", "reference.nc"], cwd=folder, check=True, capture_output=True)
        whole = time.perf_counter() - begin
        reference = tr.open(Path(folder, "reference.nc"))
        known: dict = {}
        killed = 0
        while killed < wanted:
            process = subprocess.Popen(
                [*command, "-o", "o.nc"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
            )
            try:
                _, error = process.communicate(timeout=rng.uniform(0, whole))
            except subprocess.TimeoutExpired:
                os.kill(process.pid, signal.SIGKILL)
                process.communicate()
                killed += 1
                if Path(folder, "o.nc").exists():  # complete: killed on its way out
                    lives[-1].append(points)
                    continue
                found = stored(Path(folder, "o.nc.sweep"))
                assert known.items() <= found.items(), (
                    f"of {len(known)} finished points {len(found)} are left, or changed"
                )
                known = found
                lives[-1].append(len(found))
                continue
            assert process.returncode == 0, error  # a point that is stored twice would end it
            assert tr.open(Path(folder, "o.nc")).drop_attrs().identical(reference.drop_attrs())
            # a process that is killed while it writes may leave its unfinished file, never the store
            left = sorted(name for name in os.listdir(folder) if not name.startswith(TEMPORARY))
            assert left == ["o.nc", "reference.nc", "scene.toml"], left
            os.unlink(Path(folder, "o.nc"))
            known = {}
            lives[-1].append(points)
            lives.append([])
        if lives[-1]:  # the last one, too, comes to its end
            subprocess.run([*command, "-o", "o.nc"], cwd=folder, check=True, capture_output=True)
            assert tr.open(Path(folder, "o.nc")).drop_attrs().identical(reference.drop_attrs())
            lives[-1].append(points)
    print(f"{killed} kills, {len(lives)} sweeps of {points} points brought to their end: 0 points lost, 0 different")
    return [life for life in lives if life]


def stored(path: Path) -> dict[int, str]:
    """Rows in a store; none if the sweep was killed before there was one."""
    if not path.exists():
        return {}
    with closing(sqlite3.connect(path)) as connection:
        if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return {}
        rows = dict(connection.execute("SELECT number, row FROM points"))
    return {number: json.dumps(json.loads(row)) for number, row in rows.items()}


def main() -> None:
    chosen = options(__doc__)
    seconds = rates(2, 100.0, 1) if chosen.quick else rates(8, 5000.0, 2)
    map_, linear_seconds = linear(20, 50) if chosen.quick else linear(250, 400)
    lives = kills(1, 16, workers=1) if chosen.quick else kills(25, 120, workers=2)
    after = [count for life in lives for count in life]
    ds = xr.Dataset(
        {
            "seconds": ("workers", [seconds[1], seconds[2]], {"long_name": "time of the sweep", "units": "s"}),
            "stored": (
                "life",
                np.array(after),
                {"long_name": "points in the store at the end of a process", "units": "1"},
            ),
            "growth_rate": map_.growth_rate.variable,
        },
        {
            "workers": ("workers", [1, 2], {"long_name": "processes", "units": "1"}),
            **{name: map_[name].variable for name in map_.growth_rate.dims},
        },
        {
            "Conventions": "CF-1.11",
            "title": "Speed and safety of sweeps",
            "linear_seconds": linear_seconds,
            "kills": len(after) - len(lives),
        },
    )
    store("sweep_speed", chosen.output, ds, draw(ds, lives))
    if not chosen.quick:
        assert seconds[1] / seconds[2] >= BAR, seconds
        assert linear_seconds < 10, linear_seconds


def draw(ds, lives) -> Figure:
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    (bars, saw), (below, colours) = (row for row in figure.subplots(2, 2, height_ratios=(2, 3)))
    colours.remove()
    below.set_subplotspec(below.get_gridspec()[1, :])
    one, two = ds.seconds.values
    bars.barh(["1 worker", "2 workers"], [one, two], color=[ORANGE, BLUE])
    bars.set(xlabel="time of the sweep (s)", title=f"Two workers: {one / two:.2f} times as fast")
    bars.invert_yaxis()
    begin = 0
    for life in lives:
        saw.plot(np.arange(begin, begin + len(life) + 1), [0, *life], "-o", ms=3, color=BLUE)
        saw.plot(begin + len(life), life[-1], "s", color=ORANGE, zorder=3)
        begin += len(life)
    saw.set(
        xlabel="processes started",
        ylabel="finished points kept",
        title=f"{ds.attrs['kills']} SIGKILLs, nothing lost",
    )
    rate = ds.growth_rate.values
    reach = np.abs(rate).max()
    mesh = below.pcolormesh(
        ds.fleet_damping, ds.road_softness, rate, cmap="PuOr_r", vmin=-reach, vmax=reach, rasterized=True
    )
    below.contour(ds.fleet_damping, ds.road_softness, rate, [0.0], colors="k")
    figure.colorbar(mesh, ax=below, label="growth rate (ω₀)")
    below.set(
        xlabel="damping Γ",
        ylabel="softness α",
        title=f"{rate.size} points of the linear model in {ds.attrs['linear_seconds']:.2g} s, k = 0.9, Δ = 0.01",
    )
    return figure


if __name__ == "__main__":
    main()
