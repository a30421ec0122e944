"""Runs that are streamed, stopped, killed, taken up again, and refused: nothing is lost, and nothing that was there damaged."""

import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from test_restart import CASES, SOFT, SPEEDS, K, scene

import traffic_road as tr
from traffic_road import checkpoint, keeper, models, stream
from traffic_road.stream import Journal

TAKEN = ("wall_time", "error_wall_time", "history")
# as where Dask is not installed: xarray loads it wherever it is, which takes each process most of a second
START = 'import sys; sys.modules["dask"] = None; from traffic_road.cli import main; sys.exit(main())'


def started(*words, start=START, **options):
    """A process of its own that runs the command line `words`."""
    command = [sys.executable, "-c", start, *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def same(a: xr.Dataset, b: xr.Dataset) -> bool:
    """All bits but the times taken."""
    a, b = a.load().copy(), b.load().copy()
    for name in TAKEN:
        assert name in a.attrs and name in b.attrs
        del a.attrs[name], b.attrs[name]
    return a.identical(b) and all(a[n].values.tobytes() == b[n].values.tobytes() for n in a.variables)


def refused(call, *words, error=tr.StoreError) -> None:
    with pytest.raises(error) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


# ---------------------------------------------------------------- streaming


@pytest.mark.parametrize("name", ["even", "mixed, laws", "continuum"])
def test_a_streamed_run_is_what_memory_holds(name, monkeypatch):
    module, case, given = CASES[name]
    model = module.__name__.rsplit(".", 1)[-1]
    held = tr.simulate(case, model, samples=9, **given)
    monkeypatch.setattr(keeper, "FIRST", 0.0)  # publish at every sample
    monkeypatch.setattr(keeper, "SHARE", np.inf)
    monkeypatch.setattr(stream, "BLOCK", 5000)  # some records at a time
    streamed = tr.simulate(case, model, samples=9, output="out.nc", **given)
    assert same(streamed, held) and same(tr.open("out.nc"), held)
    tr.save(held, "saved.nc")
    kinds = [
        {n: (v.dtype, v.encoding) for n, v in xr.open_dataset(f).variables.items()} for f in ("out.nc", "saved.nc")
    ]
    for name, (dtype, encoding) in kinds[0].items():
        assert kinds[1][name][0] == dtype and kinds[1][name][1].get("_FillValue", 0) is not encoding, name
    monkeypatch.setattr(keeper, "IN_MEMORY", 0)
    lazy = tr.simulate(case, model, samples=9, output="out.nc", **given)
    assert not lazy.road_height.variable._in_memory and same(lazy, held)
    assert sorted(os.listdir()) == ["out.nc", "saved.nc"]


def test_the_file_can_be_read_at_any_moment():
    case = scene(duration=16000.0, speed=SPEEDS)
    case.to_toml("scene.toml")
    quick = START.replace(
        "sys.exit", "from traffic_road import keeper; keeper.FIRST = 0.02; keeper.SHARE = 0.5; sys.exit"
    )
    command = ["run", "scene.toml", "--model", "cars", "-o", "out.nc", "--samples", "8001", "--nodes", "64"]
    seen = []
    with started(*command, start=quick) as run:
        while run.poll() is None:
            if os.path.exists("out.nc"):
                ds = tr.open("out.nc")  # whole, or this raises
                assert np.isfinite(ds.road_height).all() and np.all(np.diff(ds.time) > 0)
                seen.append((ds.time.size, ds.status))
        assert run.returncode == 0, run.stderr.read()
    sizes = [size for size, _ in seen]
    assert sizes == sorted(sizes) and len(set(sizes)) > 5
    assert "unfinished: has reached time" in seen[0][1] and tr.open("out.nc").status == "ok"
    assert tr.open("out.nc").time.size == 8001


def test_memory_does_not_grow_with_the_number_of_samples():
    script = """
import resource, sys
sys.modules["dask"] = None
import numpy as np
import traffic_road as tr
road = tr.Road(2 * np.pi / 0.9, 0.006, 0.01, tr.Sine(1e-3, 0.9))
linear = tr.Scene(road, tr.Fleet(8, 0.1), 4000.0, lift_off=False)  # each sample is one leap
for samples in (100, 8000):
    ds = tr.simulate(linear, "continuum", samples=samples, nodes=1024, output="big.nc")
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, ds.road_height.nbytes, float(ds.road_height[-1, 3]))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=150)
    assert done.returncode == 0, done.stderr
    peaks, values = [], []
    for line in done.stdout.splitlines():  # the peak of the short run, and of the long one if that is higher
        peak, size, value = line.split()
        peaks.append(int(peak) * 1024)
        values.append(float(value))
    assert 3 * int(size) > 190e6  # three fields
    assert peaks[1] - peaks[0] < 60e6  # a few blocks
    assert values[1] == pytest.approx(values[0], rel=1e-9)


# ---------------------------------------------------------------- stopping and going on


class Stop:
    """Sends this process a signal at the sample number `at`."""

    def __init__(self, at, samples, number=signal.SIGINT):
        self.at, self.samples, self.number = at, samples, number

    def __call__(self, share):
        if round(share * self.samples) == self.at:
            os.kill(os.getpid(), self.number)


@pytest.mark.parametrize("name", CASES)
def test_a_run_stopped_again_and_again_ends_with_the_same_bits(name, monkeypatch):
    module, case, given = CASES[name]
    asked = {"model": module.__name__.rsplit(".", 1)[-1], "samples": [0.0, 7.0, 8.0, 31.0, 40.0, 60.0], **given}
    whole = tr.simulate(case, **asked)
    monkeypatch.setattr(models, "PACE", 0.0)
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted: time .* of 60 is kept; go on with tr.resume.*--resume"):
        tr.simulate(case, **asked, output="out.nc", checkpoint="c", progress=Stop(1, 6))
    assert sorted(os.listdir()) == ["c", "c.samples-0"]
    for at in (2, 4, 5):
        with pytest.raises(KeyboardInterrupt, match="is kept"):
            tr.resume("c", progress=Stop(at, 6, signal.SIGTERM))
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers
    resumed = tr.resume("c", scene=case)
    assert same(resumed, whole) and same(tr.open("out.nc"), whole)
    assert os.listdir() == ["out.nc"]


@pytest.mark.parametrize("at", [0, 1, 2])
def test_the_resolution_is_refined_as_it_would_have_been(at, monkeypatch):
    case = scene(amplitude=1e-3, duration=30.0)
    asked = {"model": "cars", "samples": 5, "tolerance": 2e-3}
    whole = tr.simulate(case, **asked)
    begun = []
    estimate = tr.run.error_estimate

    def stopped_at(*arguments):
        begun.append(1)
        if len(begun) == at + 1:
            os.kill(os.getpid(), signal.SIGINT)
        return estimate(*arguments)

    monkeypatch.setattr(tr.run, "error_estimate", stopped_at)
    with pytest.raises(KeyboardInterrupt, match=r"time 29.* of 30 is kept"):
        tr.simulate(case, **asked, output="out.nc", checkpoint="c")
    assert sorted(os.listdir()) == ["c", f"c.samples-{at}"]
    resumed = tr.resume("c")
    assert same(resumed, whole) and whole.x.size > 64
    assert os.listdir() == ["out.nc"]


def test_a_run_that_diverges_is_resumed_to_the_same_end(monkeypatch):
    wild = replace(scene(softness=0.05, diffusivity=0.0, amplitude=1.0, duration=4000.0), lift_off=False)
    whole = tr.simulate(wild, "cars", samples=41, nodes=64)
    assert whole.status.startswith("diverged")
    monkeypatch.setattr(models, "PACE", 0.0)
    for at in (3, whole.time.size):
        with pytest.raises(KeyboardInterrupt):
            tr.simulate(wild, "cars", samples=41, nodes=64, checkpoint=f"c{at}", progress=Stop(at, 41))
        assert same(tr.resume(f"c{at}"), whole)


def test_control_c_ends_the_command_within_two_seconds_and_says_how_to_go_on():
    case = scene(duration=40000.0, **SOFT)
    case.to_toml("scene.toml")
    command = ["run", "scene.toml", "--model", "cars", "-o", "out.nc", "--samples", "40", "--checkpoint", "c 1"]
    for number, words in ((signal.SIGINT, command), (signal.SIGTERM, ["run", "--resume", "c 1"])):
        with started(*words) as run:
            while not os.path.exists("out.nc"):  # published a second after the start
                assert run.poll() is None, run.stderr.read()
                time.sleep(0.02)
            os.unlink("out.nc")
            spent = Path(f"/proc/{run.pid}/stat").read_text().rsplit(")")[1].split()[11:13]
            before = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) + sum(map(int, spent)) / os.sysconf(
                "SC_CLK_TCK"
            )
            run.send_signal(number)
            out, err = run.communicate(timeout=15)
            # seconds of the process's own, since the machine may be busy with others
            assert sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - before < 2.0
        assert run.returncode == 1 and out == "" and len(err.splitlines()) == 1, err
        assert "interrupted: time " in err and f"traffic-road run --resume '{os.getcwd()}/c 1'" in err
    facts, state = checkpoint.read("c 1")
    assert 0 < facts["time"] < 40000 and state["road"].size == 64


def test_an_estimate_can_be_stopped_and_a_run_without_a_checkpoint_keeps_its_file(monkeypatch):
    def stop(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)

    monkeypatch.setattr(tr.run, "error_estimate", stop)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted: .*out.nc has all up to time 60 of 60; .* a checkpoint"):
        tr.simulate(scene(), "continuum", samples=5, output="out.nc")
    ds = tr.open("out.nc")
    assert ds.time.size == 5 and ds.status == "interrupted at time 60" and os.listdir() == ["out.nc"]


def test_in_another_thread_no_signal_is_touched(monkeypatch):
    seen = []

    def work():
        ds = tr.simulate(
            scene(), "continuum", samples=5, checkpoint="c", progress=lambda share: seen.append(handlers())
        )
        seen.append(ds.status)

    def handlers():
        return signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)

    before = handlers()
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before] * 5 + ["ok"]


# ---------------------------------------------------------------- what cannot be


@pytest.fixture
def stopped(monkeypatch):
    """A checkpoint "c" of a run that was stopped half way, with the output of an older run."""
    with open("out.nc", "wb") as old:
        old.write(b"old")
    monkeypatch.setattr(models, "PACE", 0.0)
    with pytest.raises(KeyboardInterrupt):
        tr.simulate(scene(), "cars", samples=7, nodes=64, output="out.nc", checkpoint="c", progress=Stop(3, 7))
    return {name: Path(name).read_bytes() for name in sorted(os.listdir())}


def unchanged(files) -> bool:
    return files == {name: Path(name).read_bytes() for name in sorted(os.listdir())}


def test_a_checkpoint_is_never_overwritten_by_a_new_run(stopped):
    for name, words in (("c", "there is a file; go on from it with tr.resume"), ("out.nc", "both")):
        refused(lambda name=name: tr.simulate(scene(), output="out.nc", checkpoint=name), words)
    assert unchanged(stopped)


@pytest.mark.parametrize("size", [0, 10, 100, 0.5, -1])
def test_a_truncated_checkpoint(size, stopped):
    whole = stopped["c"]
    cut = whole[: int(size * len(whole)) if isinstance(size, float) else size]
    with open("c", "wb") as file:
        file.write(cut)
    refused(lambda: tr.resume("c"), "c: ", "checkpoint")
    assert unchanged(stopped | {"c": cut})


@pytest.mark.parametrize("at", [0, 30, 300, -500, -5])
def test_a_damaged_checkpoint(at, stopped):
    damaged = bytearray(stopped["c"])
    damaged[at] ^= 1
    with open("c", "wb") as file:
        file.write(damaged)
    refused(lambda: tr.resume("c"), "checkpoint")
    assert unchanged(stopped | {"c": bytes(damaged)})


def test_a_foreign_file_a_folder_and_none(stopped):
    for path, words in (
        ("out.nc", "out.nc: no checkpoint of traffic_road"),
        (".", "cannot read the checkpoint: Is a directory"),
        ("none", "none: no such checkpoint"),
        (None, "None: cannot read the checkpoint"),
    ):
        refused(lambda path=path: tr.resume(path), words)
    assert unchanged(stopped)


def test_another_version_and_another_scene(stopped, monkeypatch):
    refused(lambda: tr.resume("c", scene=scene(softness=0.007)), "c: a checkpoint of another scene")
    monkeypatch.setattr(checkpoint, "VERSION", "9.9")
    refused(lambda: tr.resume("c"), f"a checkpoint of version '{version('traffic_road')}', this is 9.9")
    assert unchanged(stopped)


def test_samples_missing_damaged_or_in_use(stopped):
    name = "c.samples-0"
    with open(name, "r+b") as file:
        file.seek(200)
        file.write(b"\xff")
    refused(lambda: tr.resume("c"), f"{name}: damaged")
    with open(name, "r+b") as file:
        file.truncate(300)
    refused(lambda: tr.resume("c"), f"{name}: truncated")
    os.unlink(name)
    refused(lambda: tr.resume("c"), f"{name}: missing")
    with open(name, "wb") as file:
        file.write(stopped[name])
    used = Journal.reopened(name, {"road_height": 64, "car_height": 8, "contact_force": 8, "car_position": 8}, 0, 0)
    with open(name, "wb") as file:
        file.write(stopped[name])
    refused(lambda: tr.resume("c"), f"{name}: another process is running from this checkpoint")
    used.file.close()
    assert unchanged(stopped) and tr.resume("c").status == "ok"


def test_a_file_beside_a_new_checkpoint_is_not_overwritten():
    with open("new.samples-0", "w") as file:
        file.write("a diary")
    refused(lambda: tr.simulate(scene(), checkpoint="new"), "new.samples-0: holds something else")
    assert Path("new.samples-0").read_text() == "a diary" and os.listdir() == ["new.samples-0"]


def test_a_scene_that_is_refused_leaves_no_files():
    resonant = scene(damping=0.0, speed=1 / K)
    refused(lambda: tr.simulate(resonant, "cars", checkpoint="c", output="out.nc"), "settled", error=tr.SceneError)
    assert os.listdir() == []


def test_a_reader_keeps_the_file_that_it_has_open(stopped):
    tr.simulate(scene(), "cars", samples=3, nodes=64, output="out.nc")
    with xr.open_dataset("out.nc") as reader, open("out.nc", "rb") as plain:
        before = reader.road_height.values.copy()
        ds = tr.resume("c")
        assert np.array_equal(reader.road_height.load(), before) and plain.read(4) == b"\x89HDF"
    assert same(tr.open("out.nc"), ds) and ds.time.size == 7


def limited(size):
    """A disk on which no file grows beyond `size` bytes."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize("more", [[], ["--checkpoint", "c"]])
def test_a_full_disk(more):
    scene(duration=300.0).to_toml("scene.toml")
    with open("out.nc", "wb") as old:
        old.write(b"old")
    command = ["run", "scene.toml", "-o", "out.nc", "--model", "cars", "--samples", "300", "--nodes", "64", *more]
    with started(*command, preexec_fn=limited(100_000)) as full:
        _, err = full.communicate(timeout=150)
    assert full.returncode == 2 and len(err.splitlines()) == 1
    assert "cannot write: File too large; make room" in err
    assert Path("out.nc").read_bytes() == b"old" or tr.open("out.nc").status.startswith("unfinished")
    assert sorted(os.listdir()) == (["c", "c.samples-0"] if more else []) + ["out.nc", "scene.toml"]
    if more:
        assert "then go on with tr.resume" in err and "--resume" in err
        assert same(tr.resume("c"), tr.simulate(scene(duration=300.0), "cars", samples=300, nodes=64))


@pytest.mark.parametrize("step", ["write", "fsync", "replace"])
def test_a_disk_that_fills_while_a_checkpoint_is_written(step, stopped, monkeypatch):
    whole = tr.simulate(scene(), "cars", samples=7, nodes=64)

    def full(*arguments):
        if arguments[-1] == "rb":
            return open(*arguments)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        if step == "write":
            patch.setattr(checkpoint, "open", full, raising=False)
        else:
            patch.setattr(os, step, full)
        refused(lambda: tr.resume("c"), "No space left on device; make room", "then go on with tr.resume")
    left = {name: Path(name).read_bytes() for name in sorted(os.listdir())}
    assert left["c"] == stopped["c"] and left["out.nc"] == b"old" and len(left) == 3
    assert same(tr.resume("c"), whole)


@pytest.fixture
def shut():
    """A folder in which nothing can be written: root may write anywhere, so that we are somebody else for a while."""
    with tempfile.TemporaryDirectory() as name:
        os.chmod(name, 0o555)
        root = os.geteuid() == 0
        if root:
            os.seteuid(65534)
        yield name
        if root:
            os.seteuid(0)


def test_a_folder_that_is_read_only(shut):
    for name in ("output", "checkpoint"):
        words = f"{shut}/file: cannot write: Permission denied; name a file in a folder that"
        refused(lambda name=name, words=words: tr.simulate(scene(), **{name: f"{shut}/file"}), words)
    assert os.listdir(shut) == []
