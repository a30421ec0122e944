"""The command line: what it prints and writes, its exit status, and what is left after an error."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import traffic_road as tr
from traffic_road import cli

# as where Dask is not installed: xarray loads it wherever it is, which takes each process most of a second
START = 'import sys; sys.modules["dask"] = None; from traffic_road.cli import main; sys.exit(main())'
SMALL = replace(tr.preset("paper"), duration=30.0)
FEW = ["--samples", "4", "--nodes", "256"]
# softness far above what saturates and no lift-off: the wave grows by 1e12 within the duration
WILD = replace(SMALL, duration=3000.0, lift_off=False, road=replace(SMALL.road, softness=0.05))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder of its own with some scenes in it."""
    monkeypatch.chdir(tmp_path)
    SMALL.to_toml("small.toml")
    WILD.to_toml("wild.toml")
    replace(SMALL, fleet=tr.Fleet(8, 0.1, frequency=10.0)).to_toml("stiff.toml")
    replace(SMALL, road=replace(SMALL.road, profile=None)).to_toml("flat.toml")
    return tmp_path


def run(capsys, *arguments):
    """Exit status, stdout, stderr of one command in this process."""
    try:
        status = cli.main([str(a) for a in arguments])
    except SystemExit as stop:
        status = stop.code
    return status, *capsys.readouterr()


def written():
    return sorted(name for name in os.listdir() if not name.endswith(".toml"))


def process(*arguments, **keys):
    return subprocess.run([sys.executable, "-c", START, *arguments], capture_output=True, text=True, timeout=60, **keys)


# ---------------------------------------------------------------- what works


def test_compare(capsys):
    status, out, err = run(capsys, "compare", "small.toml", "-o", "c.nc", *FEW)
    assert (status, err) == (0, "") and written() == ["c.nc", "c.png"]
    lines = out.splitlines()
    ds = tr.open("c.nc")
    assert lines[0].startswith("wavenumber 0.9, time ") and "wrote c.nc and c.png" in lines[-1]
    table = [line for line in lines if line.split("  ")[0] in ds.source.values]
    assert len(table) == 6
    for line, growth, velocity in zip(table, ds.growth_rate.values, ds.phase_velocity.values, strict=True):
        assert f"{growth:.8f}" in line and f"{velocity:.8f}" in line
    assert Path("c.png").read_bytes()[:4] == b"\x89PNG"


def test_compare_defaults(capsys):
    status, out, _ = run(capsys, "compare", *FEW)
    assert status == 0 and written() == ["compare.nc", "compare.png"] and "leading order" in out
    assert xr.open_dataset("compare.nc").attrs["wavenumber"] == 0.9


@pytest.mark.parametrize(("model", "dims"), [("cars", ("time", "car")), ("continuum", ("time", "x"))])
def test_run_and_plot(model, dims, capsys):
    arguments = ["run", "small.toml", "-o", "r.nc", "--model", model, "--samples", "4", "--plot", "r.svg"]
    status, out, err = run(capsys, *arguments)
    assert (status, err) == (0, "") and written() == ["r.nc", "r.svg"]
    assert out.startswith(f"{model}: ok, error estimate") and "wrote r.nc\nwrote r.svg" in out
    ds = tr.open("r.nc")
    assert ds.contact_force.dims == dims and ds.attrs["model"] == model and ds.time.size == 4
    assert tr.Scene.from_toml("small.toml") == SMALL
    status, out, err = run(capsys, "plot", "r.nc")
    assert (status, err) == (0, "") and out == "wrote r.png\n" and written() == ["r.nc", "r.png", "r.svg"]
    assert run(capsys, "plot", "r.nc", "-o", "other.pdf")[0] == 0 and Path("other.pdf").read_bytes()[:4] == b"%PDF"


def test_plan_says_what_run_does(capsys):
    status, out, err = run(capsys, "plan", "small.toml", "--tolerance", "1e-4")
    assert (status, err) == (0, "") and written() == []
    lines = out.splitlines()
    assert len(lines) == 4 and "predicted error" in lines[1] and "predicted cost" in lines[2] and "theory" in lines[3]
    run(capsys, "run", "small.toml", "-o", "r.nc", "--tolerance", "1e-4")
    attributes = tr.open("r.nc").attrs
    assert lines[0].split(":")[0] == attributes["model"] and attributes["plan"] == lines[3]
    assert f"nodes {json.loads(attributes['numerics'])['nodes']}" in lines[0]


def test_numerics_arrive(capsys):
    numbers = [
        "--model",
        "cars",
        "--nodes",
        "264",
        "--hold",
        "5",
        "--relax-every",
        "2",
        "--samples",
        "3",
        "--tolerance",
        "0.5",
    ]
    assert run(capsys, "run", "small.toml", "-o", "r.nc", *numbers)[0] == 0
    attributes = tr.open("r.nc").attrs
    assert attributes["numerics"] == '{"nodes": 264, "hold": 5, "relax_every": 2}' and attributes["tolerance"] == 0.5
    run(capsys, "run", "small.toml", "-o", "s.nc", "--model", "continuum", "--step", "0.3", "--nodes", "40")
    assert tr.open("s.nc").attrs["numerics"] == '{"nodes": 40, "step": 0.3}'


def test_a_stored_result_runs_again(capsys):
    assert (
        run(capsys, "run", "small.toml", "-o", "r.nc", "--model", "cars", "--samples", 5, "--nodes", 264, "--hold", 5)[
            0
        ]
        == 0
    )
    assert run(capsys, "run", "r.nc", "-o", "again.nc")[0] == 0
    first, again = tr.open("r.nc"), tr.open("again.nc")
    assert again.road_height.identical(first.road_height) and again.attrs["numerics"] == first.attrs["numerics"]
    assert run(capsys, "run", "r.nc", "-o", "other.nc", "--samples", 3, "--nodes", 272)[0] == 0
    other = tr.open("other.nc")
    assert other.time.size == 3 and other.attrs["numerics"] == '{"nodes": 272, "hold": 5, "relax_every": 1}'
    os.rename("r.nc", "without_ending")
    assert run(capsys, "run", "without_ending", "-o", "again.nc")[0] == 0
    status, _, err = run(capsys, "run", "again.nc", "-o", "again.nc")
    assert status == 2 and "would overwrite" in err


def test_a_flat_road(capsys):
    for model in ("cars", "continuum"):
        status, _, err = run(
            capsys,
            "run",
            "flat.toml",
            "-o",
            "f.nc",
            "--model",
            model,
            "--plot",
            "f.png",
            "--samples",
            3,
            "--nodes",
            256,
        )
        assert status == 0 and len(err.splitlines()) <= 1
    assert written() == ["f.nc", "f.png"]


def test_a_row_of_heights(capsys):
    heights = np.random.default_rng(0).normal(size=8) * 1e-3  # the shortest wave of eight points included
    replace(SMALL, road=replace(SMALL.road, profile=heights)).to_toml("heights.toml")
    assert run(capsys, "compare", "heights.toml", *FEW)[0] == 0


def test_presets(capsys, folder):
    status, out, err = run(capsys, "presets")
    assert (status, err) == (0, "") and [line.split()[0] for line in out.splitlines()] == ["paper", "gravel"]
    for name in ("paper", "gravel"):
        status, out, err = run(capsys, "presets", name)
        (folder / "p.toml").write_text(out)
        assert (status, err) == (0, "") and tr.Scene.from_toml("p.toml") == tr.preset(name)


def test_a_file_named_as_a_preset_is_not_asked(capsys, folder):
    (folder / "paper").write_text("nonsense")
    assert run(capsys, "run", "paper", "-o", "r.nc", *FEW)[0] == 0


# ---------------------------------------------------------------- bad input: status 2, one line, nothing written

BAD = [
    ([], "COMMAND"),
    (["drive"], "invalid choice: 'drive'"),
    (["compare", "papre"], "scene 'papre': neither a preset (paper, gravel) nor a TOML file that exists"),
    (["compare", ""], "scene ''"),
    (["compare", "."], "scene '.'"),
    (["compare", "x" * 5000], "neither a preset"),
    (["compare", "none.toml"], "none.toml: cannot read the scene: No such file"),
    (["compare", "broken.toml"], "broken.toml: cannot read the scene"),
    (["compare", "a\nb.toml"], "a b.toml: cannot read the scene"),
    (["compare", "binary"], "binary: cannot read the scene"),
    (["compare", "flat.toml"], "a flat road has no wave to compare"),
    (["compare", "small.toml", "--wavenumber", "1.0"], "use wavenumber 0.9"),
    (["compare", "small.toml", "--wavenumber", "nan"], "wavenumber = nan"),
    (["compare", "small.toml", "--samples", "1"], "samples = 1: must be a whole number >= 2"),
    (["compare", "small.toml", "--samples", "many"], "invalid int value: 'many'"),
    (["compare", "small.toml", "--tolerance", "-1"], "tolerance = -1.0: must be a finite number > 0"),
    (["compare", "small.toml", "--tolerance", "nan"], "tolerance = nan"),
    (["compare", "small.toml", "--nodes", "2"], "nodes = 2"),
    (["compare", "stiff.toml", "--nodes", "16"], "use nodes >= "),
    (["compare", "small.toml", "--hold", "2"], "hold = 2: must be 1 (linear), 3 (cubic) or 5 (quintic)"),
    (["compare", "small.toml", "--step", "-1"], "step = -1.0"),
    (["compare", "small.toml", "-o", ""], "it is a folder"),
    (["compare", "small.toml", "-o", "."], "it is a folder"),
    (["compare", "small.toml", "-o", "/"], "it is a folder"),
    (["compare", "small.toml", "-o", "c.png"], "c.png: the ending of a picture"),
    (["compare", "small.toml", "-o", "none/c.nc"], "none/c.nc: cannot write: No such file or directory; name a file"),
    (["compare", "small.toml", "-o", "small.toml"], "small.toml: would overwrite the scene"),
    (["run", "./small.toml", "-o", "small.toml"], "small.toml: would overwrite the scene"),
    (["run", "small.toml"], "-o/--output"),
    (["run", "small.toml", "-o", "r.nc", "--model", "train"], "invalid choice: 'train'"),
    (
        ["run", "small.toml", "-o", "r.nc", "--model", "linear", "--step", "1"],
        "step: not a parameter of the linear model",
    ),
    (["plan", "papre"], "scene 'papre': neither a preset"),
    (["plan", "small.toml", "--tolerance", "0"], "tolerance = 0.0: must be a finite number > 0"),
    (["run", "small.toml", "-o", "r.nc", "--model", "continuum", "--hold", "3"], "hold"),
    (["run", "small.toml", "-o", "r.nc", "--model", "cars", "--step", "1"], "step: not a parameter of the cars model"),
    (["run", "small.toml", "-o", "r.nc", "--relax-every", "0"], "relax_every = 0"),
    (
        ["run", "small.toml", "-o", "r.nc", "--plot", "r.jpg"],
        "r.jpg: cannot write a picture of that kind; end its name",
    ),
    (["run", "small.toml", "-o", "r.nc", "--plot", "r.nc"], "r.nc: cannot write a picture of that kind"),
    (["run", "small.toml", "-o", "r.nc", "--plot", "none/r.png"], "none/r.png: cannot write"),
    (["run", "small.toml", "-o", "broken.toml/r.nc"], "Not a directory"),
    (["run", "small.toml", "-o", "/dev/null"], "no regular file"),
    (["run", "none.nc", "-o", "r.nc"], "none.nc: cannot read as netCDF: No such file"),
    (["plot", "none.nc"], "none.nc: cannot read as netCDF: No such file"),
    (["plot", "small.toml"], "small.toml: cannot read as netCDF"),
    (["plot", "."], "cannot read as netCDF"),
    (["plot", ""], "cannot read as netCDF"),
    (["presets", "papre"], "preset 'papre': there is none of that name; choose paper or gravel"),
    (["presets", "paper", "more"], "unrecognized arguments: more"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=lambda v: " ".join(v)[:40] if isinstance(v, list) else "")
def test_bad_input(arguments, words, capsys, folder):
    (folder / "broken.toml").write_text("road = ")
    (folder / "binary").write_bytes(b"\xff\x00")
    status, out, err = run(capsys, *arguments)
    assert status == 2 and words in err and err.startswith("traffic-road: ")
    assert err.count("\n") == 1 and out == ""
    assert written() == ["binary"]
    assert tr.Scene.from_toml("small.toml") == SMALL


def test_an_old_result_outlives_an_error(capsys, folder):
    (folder / "c.nc").write_bytes(b"old")
    assert run(capsys, "compare", "small.toml", "-o", "c.nc", "--hold", "2")[0] == 2
    assert (folder / "c.nc").read_bytes() == b"old" and written() == ["c.nc"]


def test_a_foreign_file_is_not_drawn(capsys):
    xr.Dataset({"a": ("b", [1.0])}).to_netcdf("foreign.nc")
    assert run(capsys, "plot", "foreign.nc")[0] == 2
    tr.save(tr.to_si(tr.simulate(SMALL, "continuum", samples=3), tr.Scales(11, 11, 200)), "si.nc")
    status, _, err = run(capsys, "plot", "si.nc")
    assert status == 2 and "SI units" in err and written() == ["foreign.nc", "si.nc"]


# ---------------------------------------------------------------- failed runs: status 1


@pytest.mark.parametrize("model", ["cars", "continuum"])
def test_a_road_that_blows_up(model, capsys):
    arguments = [
        "run",
        "wild.toml",
        "-o",
        "w.nc",
        "--model",
        model,
        "--plot",
        "w.png",
        "--samples",
        "31",
        "--nodes",
        "64",
    ]
    status, out, err = run(capsys, *arguments)
    assert status == 1 and written() == ["w.nc", "w.png"]
    assert err.count("\n") == 1 and "the run diverged between time " in err
    ds = tr.open("w.nc")
    when, _, why = ds.attrs["status"].removeprefix("diverged between time ").partition(": ")
    before, after = (float(word) for word in when.split(" and "))
    assert "corrugation" in why
    assert before == pytest.approx(float(ds.time[-1]), rel=1e-5) and before < after <= before + 101
    assert 2 < ds.time.size < 31 and np.isfinite(ds.road_height).all() and ds.attrs["status"] in out


def test_compare_of_a_road_that_blows_up(capsys):
    status, _, err = run(capsys, "compare", "wild.toml", "--samples", "31", "--nodes", "64")
    assert status == 1 and "diverged" in err and written() == ["compare.nc", "compare.png"]
    assert all(line.startswith("traffic-road: ") for line in err.splitlines())


def test_debug_shows_the_trace(capsys):
    for arguments in (["--debug", "presets", "papre"], ["presets", "papre", "--debug"]):
        with pytest.raises(tr.SceneError):
            cli.main(arguments)
    done = process("presets", "papre", "--debug")
    assert done.returncode == 1 and "Traceback" in done.stderr


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (KeyboardInterrupt(), 1, "interrupted"),
        (MemoryError(), 1, "out of memory; use fewer nodes"),
        (ZeroDivisionError("by\nzero"), 1, "unexpected ZeroDivisionError: by zero; this is a fault of traffic_road"),
        (tr.StoreError("disk"), 2, "disk"),
        (tr.TrafficRoadError("lost"), 1, "lost"),
    ],
)
def test_whatever_happens_is_one_line(error, status, words, capsys, monkeypatch):
    def fail(*arguments, **keys):
        raise error

    monkeypatch.setattr("traffic_road.run.simulate", fail)
    found, _, err = run(capsys, "run", "small.toml", "-o", "r.nc")
    assert found == status and err.startswith(f"traffic-road: {words}") and err.count("\n") == 1 and not written()


def test_a_warning_is_one_line(capsys):
    status, _, err = run(capsys, "run", "small.toml", "-o", "r.nc", "--tolerance", "1e-13")
    assert status == 0 and err.startswith("traffic-road: warning: tolerance = 1e-13: not met") and err.count("\n") == 1


# ---------------------------------------------------------------- as a process


def test_help_is_quick_and_light():
    script = (
        "import sys\nfrom traffic_road.cli import main\ntry:\n    main(['{}', '--help'])\nexcept SystemExit:\n    pass\n"
        "print(sorted({{'numba', 'xarray', 'scipy', 'matplotlib', 'netCDF4', 'numpy'}} & set(sys.modules)))"
    )
    for command in ("compare", "run", "plan", "plot", "presets"):
        done = subprocess.run(
            [sys.executable, "-c", script.format(command)], capture_output=True, text=True, timeout=60
        )
        assert "usage: traffic-road" in done.stdout and done.stdout.endswith("[]\n"), done.stdout + done.stderr
    spent = []
    for _ in range(3):
        begin = time.perf_counter()
        assert process("--help").returncode == 0
        spent.append(time.perf_counter() - begin)
    assert min(spent) < 0.5


def test_silent_without_a_terminal():
    SMALL.to_toml("long.toml")
    arguments = ["run", "long.toml", "-o", "r.nc", "--samples", "3", "--model", "continuum", "--step", "0.001"]
    done = process(*arguments)
    assert done.returncode == 0 and done.stderr == ""
    assert "traffic-road" in process("run", "-h").stdout
    assert "-c run long.toml -o r.nc" in tr.open("r.nc").attrs["history"]


def test_a_reader_that_goes_away():
    command = f"set -o pipefail; '{sys.executable}' -c '{START}' presets gravel | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert done.returncode in (0, 1) and done.stderr == ""  # 0 where the pipe took it all before it broke


def test_bad_input_as_a_process():
    done = process("compare", "none.toml")
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1


def test_a_name_that_is_not_utf8():
    arguments = [sys.executable, "-X", "utf8", "-c", START, "run", "small.toml", "-o", b"\xff.nc", *FEW]
    done = subprocess.run(
        arguments, capture_output=True, timeout=60, env={**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    )
    assert (done.returncode, done.stderr) == (0, b"") and b"wrote \\udcff.nc" in done.stdout and len(written()) == 1
