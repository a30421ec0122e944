"""Real processes, killed with SIGKILL at random moments and resumed: what is lost, and what is different.

Runs of cars in an even fleet, of cars of different speeds, and of the continuum, each a process of its own that streams
its samples to a file and writes checkpoints far more often than anybody would, so that kills hit it in all it does: while
it starts, steps, writes a sample, builds the file, writes a checkpoint, estimates its error, and finishes. Each is killed
again and again, goes on from its checkpoint, or starts anew if it was killed before there was one, and at last is left to
finish. Then its file must be that of an uninterrupted run: the same bits of time axis, road, cars and counts. At every
kill the file there is must open, and hold the samples up to where it says. Run time: about 2 minutes.
"""

import os
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter, sleep

import numpy as np
import xarray as xr
from common import options, store
from matplotlib.figure import Figure

import traffic_road as tr

K = 0.9
ROAD = tr.Road(2 * np.pi / K, 0.006, 0.01, tr.Sine(1.5, K))
HARDENING = tr.Road(ROAD.length, tr.Exponential(0.01, 0.3), tr.Exponential(0.01, 0.2), ROAD.profile)
SPEEDS = (1.0, 1.1, 0.9, 1.0, 1.2, 1.0, 0.8, 1.0)
# name: scene, model, numerics
RUNS = {
    "cars, even": (tr.Scene(ROAD, tr.Fleet(8, 0.1), 1.2e5), "cars", {"nodes": 64}),
    "cars, mixed": (tr.Scene(ROAD, tr.Fleet(8, 0.1, speed=SPEEDS), 4e4), "cars", {"nodes": 64}),
    "continuum": (tr.Scene(HARDENING, tr.Fleet(8, 0.1), 8e3), "continuum", {"nodes": 32, "step": 0.25}),
}
SAMPLES = 400
KILLS = 18  # of each run
TAKEN = ("wall_time", "error_wall_time", "history")
MARKS = {
    "starting": ("#000000", "x"),
    "stepping": ("#0072b2", "o"),
    "checkpointing": ("#d55e00", "s"),
    "building the file": ("#009e73", "^"),
    "estimating or finishing": ("#cc79a7", "D"),
}


def work(name: str, quick: bool, folder: Path) -> None:
    """What a process does: go on if there is a checkpoint, else begin."""
    sys.modules["dask"] = None  # as where it is not installed: xarray loads it wherever it is
    from traffic_road import keeper, models, run  # noqa: F401 - all that is slow to import is there before the clock runs

    models.model(RUNS[name][1])
    print("ready", flush=True)
    keeper.FIRST, keeper.SHARE, models.PACE = 0.02, 0.5, 0.005
    path = folder / "checkpoint"
    if path.exists():
        tr.resume(path)
    else:
        scene, model, numerics, samples = asked(name, quick)
        files = {"output": folder / "out.nc", "checkpoint": path, "checkpoint_every": 0.02}
        tr.simulate(scene, model, samples=samples, **files, **numerics)


def asked(name: str, quick: bool) -> tuple:
    scene, model, numerics = RUNS[name]
    return tr.Scene(scene.road, scene.fleet, scene.duration / (8 if quick else 1)), model, numerics, SAMPLES


def process(name: str, quick: bool, folder: Path):
    command = [sys.executable, __file__, *(["--quick"] if quick else []), "--work", name, "--output", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def state_of(folder: Path) -> tuple[float, str]:
    """The time up to which a checkpoint has kept the run, and where the kill found it."""
    from traffic_road.checkpoint import read

    names = os.listdir(folder)
    unfinished = [name for name in names if name.startswith(".traffic_road-")]
    if "checkpoint" not in names:
        return (0.0, "starting") if "out.nc" not in names else (1.0, "estimating or finishing")
    facts, _ = read(folder / "checkpoint")  # whole, or this raises
    if unfinished:
        return facts["time"], "building the file" if any(n.endswith(".nc") for n in unfinished) else "checkpointing"
    return facts["time"], "estimating or finishing" if facts["status"] else "stepping"


def same(a: xr.Dataset, b: xr.Dataset) -> bool:
    bits = all(a[name].values.tobytes() == b[name].values.tobytes() for name in a.variables)
    return bits and {n: v for n, v in a.attrs.items() if n not in TAKEN} == {
        n: v for n, v in b.attrs.items() if n not in TAKEN
    }


def check_file(path: Path, whole: xr.Dataset) -> None:
    """The file that a kill has left opens, and holds the samples of the run up to where it says."""
    ds = tr.open(path)
    size = ds.time.size
    assert all(np.array_equal(ds[name], whole[name][:size]) for name in ("time", "road_height", "car_height"))


def study(name: str, quick: bool, kills: int, random) -> tuple[list, int, int]:
    """Rows (share of the duration kept, what the kill hit), the number of runs that finished, and how many differ."""
    begin = perf_counter()
    scene, model, numerics, samples = asked(name, quick)
    whole = tr.simulate(scene, model, samples=samples, **numerics)
    rows, finished, different = [], 0, 0
    length = 1.0 if quick else None  # of a process that is not killed; the first one tells
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        out = folder / "out.nc"
        while length is None or len(rows) < kills or not finished or (folder / "checkpoint").exists():
            with process(name, quick, folder) as run:
                if length is not None and len(rows) < kills:
                    if random.random() < 0.9 or quick:  # else the kill may hit Python's own start
                        run.stdout.readline()
                    while quick and not (folder / "checkpoint").exists():
                        sleep(0.01)
                    sleep(random.uniform(0.0, min(1.0, 0.4 * length)))
                else:
                    run.stdout.readline()
                    stepping = perf_counter()
                    run.wait()
                    length = length or perf_counter() - stepping
                killed = run.poll() is None
                if killed:
                    run.send_signal(signal.SIGKILL)
                assert run.wait() == (-signal.SIGKILL if killed else 0), run.stderr.read().decode()
            if killed:
                kept, where = state_of(folder)
                rows.append((kept / scene.duration, where))
            if out.exists():
                check_file(out, whole)
            if out.exists() and not (folder / "checkpoint").exists() and tr.open(out).status == "ok":
                finished += 1
                different += not same(tr.open(out), whole)
                assert killed or os.listdir(folder) == ["out.nc"], os.listdir(folder)
                out.unlink()
    print(
        f"{name:<12} {len(rows)} kills, {finished} runs finished, {different} different, {perf_counter() - begin:.0f} s"
    )
    return rows, finished, different


def main() -> None:
    if "--work" in sys.argv:
        at = sys.argv.index("--work")
        _, name = sys.argv.pop(at), sys.argv.pop(at)
        chosen = options(__doc__)
        work(name, chosen.quick, chosen.output)
        return
    chosen = options(__doc__)
    names = list(RUNS)[1:2] if chosen.quick else list(RUNS)
    seeds = np.random.SeedSequence(20011).spawn(len(names))
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # threads that wait for processes
        kills = 1 if chosen.quick else KILLS
        jobs = [
            pool.submit(study, name, chosen.quick, kills, np.random.default_rng(s))
            for name, s in zip(names, seeds, strict=True)
        ]
        results = [job.result() for job in jobs]
    rows = {name: result[0] for name, result in zip(names, results, strict=True)}
    finished, different = (sum(result[i] for result in results) for i in (1, 2))
    every = [(name, *row) for name in rows for row in rows[name]]
    data = {
        "run": ("kill", np.array([row[0] for row in every]), {"long_name": "run that was killed"}),
        "kept": (
            "kill",
            np.array([row[1] for row in every]),
            {"long_name": "share of the duration kept", "units": "1"},
        ),
        "found": ("kill", np.array([row[2] for row in every]), {"long_name": "what the kill hit"}),
    }
    ds = xr.Dataset(data, attrs={"Conventions": "CF-1.11", "title": "Runs killed and resumed"})
    ds.attrs |= {"kills": len(every), "finished": finished, "different": different}
    where, counts = np.unique(ds.found.values, return_counts=True)
    hit = ", ".join(f"{n} while {w}" for w, n in zip(where, counts, strict=True))
    print(f"{len(every)} kills ({hit}): {finished} runs finished, {different} different")
    assert different == 0
    store("kills", chosen.output, ds, draw(ds))


def draw(ds) -> Figure:
    figure = Figure(figsize=(8, 6), layout="constrained")
    figure.suptitle(
        f"{ds.kills} kills: what each left to go on from; {ds.finished} runs finished, {ds.different} different"
    )
    names = [name for name in RUNS if name in ds.run.values]
    all_axes = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axis, name in zip(all_axes, names, strict=True):
        kept, found = (ds[what].values[ds.run.values == name] for what in ("kept", "found"))
        number = np.arange(1, kept.size + 1)
        axis.plot(number, kept, lw=0.6, color="#999999")
        for where, (colour, mark) in MARKS.items():
            axis.plot(number[found == where], kept[found == where], mark, color=colour, ms=6, label=where)
        axis.set(title=name, ylabel="share of the run kept", ylim=(-0.1, 1.1))
    all_axes[-1].set_xlabel("number of the kill")
    all_axes[-1].xaxis.get_major_locator().set_params(integer=True)
    figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(MARKS), frameon=False)
    return figure


if __name__ == "__main__":
    main()
