"""traffic-road: the command line. Heavy imports wait until a command needs them."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path

from .errors import SceneError, StabilityError, StoreError, TrafficRoadError, shown
from .sweep_command import add_arguments as add_sweep_arguments

BAD_INPUT, FAILED_RUN = 2, 1
PICTURES = (".png", ".pdf", ".svg")


def main(arguments=None) -> int:
    """Run one command; the exit status is 0, 2 for bad input, 1 for a failed run."""
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *where: _complain(f"warning: {message}")
            status = options.command(options)
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where a broken pipe is caught
        return status
    except BrokenPipeError:  # the reader of our output went away, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains on its way out
        return FAILED_RUN
    except KeyboardInterrupt as stopped:
        _complain(stopped.args[0] if stopped.args else "interrupted; a file is either whole or not there")
        return FAILED_RUN
    except Exception as error:
        if options.debug:
            raise
        if isinstance(error, TrafficRoadError):
            _complain(error)
        elif isinstance(error, MemoryError):
            _complain("out of memory; use fewer nodes, samples or cars")
        else:
            _complain(
                f"unexpected {type(error).__name__}: {error}; this is a fault of traffic_road, --debug shows where"
            )
        return BAD_INPUT if isinstance(error, (SceneError, StabilityError, StoreError)) else FAILED_RUN


def _complain(message) -> None:
    """One line on stderr, whatever the message holds."""
    print("traffic-road:", " ".join(str(message).split()), file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """Errors in one line."""

    def error(self, message):
        _complain(f"{message}; see {self.prog} --help")
        self.exit(BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="traffic-road", description="How traffic corrugates roads: discrete cars, the continuum, and their theory."
    )
    parser.add_argument("--debug", action="store_true", help="show the trace of an error")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    compare = commands.add_parser("compare", help="cars, continuum and dispersion relation on one scene")
    compare.add_argument("scene", nargs="?", default="paper", metavar="SCENE", help=_SCENE_HELP + " (default: paper)")
    compare.add_argument(
        "-o", "--output", default="compare.nc", metavar="FILE", help="default: compare.nc, with a .png beside it"
    )
    compare.add_argument("--wavenumber", type=float, metavar="K", help="default: the fastest growing wave of the road")
    _add_numerics(compare)
    compare.set_defaults(command=_compare)

    run = commands.add_parser(
        "run", help="run a scene, or what a stored result was computed from, and store the result"
    )
    run.add_argument(
        "scene",
        nargs="?",
        metavar="SCENE",
        help=_SCENE_HELP + ", or a netCDF file of `run`: to run that again as it was run",
    )
    run.add_argument("-o", "--output", metavar="FILE", help="netCDF file to write")
    run.add_argument("--checkpoint", metavar="FILE", help="keep what is needed to go on, should the run be stopped")
    run.add_argument(
        "--resume", metavar="FILE", help="go on from a checkpoint: no SCENE, and no -o unless it has changed"
    )
    run.add_argument("--model", choices=("auto", "linear", "continuum", "cars"), help="default: auto")
    run.add_argument("--plot", metavar="PICTURE", help="draw the result, too (.png, .pdf, .svg)")
    _add_numerics(run)
    run.set_defaults(command=_run)

    plan = commands.add_parser("plan", help="what a run would use, and why: model, resolution, error, cost")
    plan.add_argument("scene", metavar="SCENE", help=_SCENE_HELP)
    plan.add_argument("--tolerance", type=float, default=1e-3, help="relative error of the corrugation (default 1e-3)")
    plan.set_defaults(command=_plan)

    sweep = commands.add_parser("sweep", help="run a scene with many values of its fields")
    sweep.add_argument("scene", metavar="SCENE", help=_SCENE_HELP)
    add_sweep_arguments(sweep)
    _add_numerics(sweep)
    sweep.set_defaults(command=_sweep)

    plot = commands.add_parser("plot", help="draw a stored result")
    plot.add_argument("file", metavar="FILE", help="netCDF file of `run` or `compare`")
    plot.add_argument("-o", "--output", metavar="PICTURE", help="default: FILE with the ending .png")
    plot.set_defaults(command=_plot)

    presets = commands.add_parser("presets", help="list the named scenes, or print one as TOML")
    presets.add_argument("name", nargs="?", help="the scene to print")
    presets.set_defaults(command=_presets)
    for command in (compare, run, plan, sweep, plot, presets):
        command.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    return parser


_SCENE_HELP = "a preset's name or a TOML file"


def _add_numerics(parser):
    parser.add_argument("--tolerance", type=float, help="relative error of the corrugation (default 1e-3)")
    parser.add_argument("--samples", type=int, help="number of times stored (default 101)")
    parser.add_argument("--nodes", type=int, help="road nodes in all")
    parser.add_argument("--hold", type=int, help="cars: degree of the road under a wheel, 1, 3 or 5")
    parser.add_argument("--relax-every", type=int, metavar="N", help="cars: headways from one relaxation to the next")
    parser.add_argument("--step", type=float, help="continuum: time step")


def _given(options) -> dict:
    """What was said of a run: the rest is left to its defaults."""
    names = ("model", "tolerance", "samples", "wavenumber", "nodes", "hold", "relax_every", "step")
    return {name: getattr(options, name) for name in names if getattr(options, name, None) is not None}


def _scene(name: str):
    from .presets import PRESETS, preset
    from .scene import Scene

    if name in PRESETS:
        return preset(name)
    if not os.path.isfile(name) and not name.endswith(".toml"):
        raise SceneError(f"scene {shown(name)}: neither a preset ({', '.join(PRESETS)}) nor a TOML file that exists")
    return Scene.from_toml(name)


def _is_netcdf(path: str) -> bool:
    """Whether `path` is named as netCDF, or is a file that begins as one."""
    if path.endswith(".nc") or not os.path.isfile(path):
        return path.endswith(".nc")
    try:
        with open(path, "rb") as file:
            return file.read(4) in (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")
    except OSError:
        return False


def _refuse_output(options) -> None:
    """StoreError before a long run, if the result could not be written or would overwrite the scene."""
    from .store import refuse_unwritable

    if Path(options.output).suffix in PICTURES:
        raise StoreError(f"{options.output}: the ending of a picture; the result is netCDF, name it .nc")
    _refuse_scene(options.output, options)
    refuse_unwritable(options.output)


def _refuse_scene(path, options) -> None:
    if options.scene is not None and os.path.realpath(path) == os.path.realpath(options.scene):
        raise StoreError(f"{path}: would overwrite the scene; name another file")


def _refuse_picture(path) -> None:
    from .store import refuse_unwritable

    if Path(path).suffix not in PICTURES:
        raise StoreError(f"{path}: cannot write a picture of that kind; end its name in {', '.join(PICTURES)}")
    refuse_unwritable(path)


def _finish(*diverged: str) -> int:
    for line in diverged:
        _complain(f"the run {line}; the file holds what came before")
    return FAILED_RUN if diverged else 0


def _say_written(*paths) -> None:
    line = "wrote " + " and ".join(map(str, paths))
    print(line.encode(errors="backslashreplace").decode())  # a name that is not UTF-8 cannot be printed as it is


def _compare(options) -> int:
    scene = _scene(options.scene)
    _refuse_output(options)
    picture = Path(options.output).with_suffix(".png")
    _refuse_scene(picture, options)
    _refuse_picture(picture)
    from .comparison import compare
    from .plots import compare_figure, save_figure
    from .store import save

    ds = compare(scene, **_given(options))
    print(_table(ds))
    save(ds, options.output)
    save_figure(compare_figure(ds), picture)
    _say_written(options.output, picture)
    status = {name: ds.attrs[f"{name}_status"] for name in ("cars", "continuum")}
    return _finish(*(f"of the {name} {line}" for name, line in status.items() if line != "ok"))


def _table(ds) -> str:
    window = f"time {ds.attrs['window_begin']:.4g} to {ds.attrs['window_end']:.4g}"
    lines = [
        f"wavenumber {ds.attrs['wavenumber']:.6g}, {window}; differences are relative to the cars",
        f"{'':<34} {'growth rate':>13} {'diff.':>9} {'phase velocity':>15} {'diff.':>9}",
    ]
    for source in ds.source.values:
        row = ds.sel(source=source)
        values = (row.growth_rate, row.growth_rate_difference, row.phase_velocity, row.phase_velocity_difference)
        formats = ("13.8f", "9.1e", "15.8f", "9.1e")
        cells = [
            format(float(v), f) if float(v) == float(v) else format("-", f">{f.split('.')[0]}")
            for v, f in zip(values, formats, strict=True)
        ]
        if source == "cars":
            cells[1], cells[3] = f"{'':>9}", f"{'':>9}"
        lines.append(f"{source:<34} {' '.join(cells)}".rstrip())
    costs = (
        f"{name}: corrugation right to {ds.attrs[f'{name}_error_estimate']:.1e} of itself by its own equations, "
        f"{ds.attrs[f'{name}_wall_time']:.2g} s, {ds.attrs[f'{name}_numerics']}"
        for name in ("cars", "continuum")
    )
    return "\n".join([*lines, *costs])


def _run(options) -> int:
    ds = _resumed(options) if options.resume is not None else _begun(options)
    print(
        f"{ds.attrs['model']}: {ds.attrs['status']}, error estimate {ds.attrs['error_estimate']:.1e} "
        f"({ds.attrs['error_method']}), {ds.attrs['updates']} node updates in {ds.attrs['wall_time']:.3g} s"
    )
    _say_written(options.output)
    if options.plot is not None:
        from .plots import run_figure, save_figure

        save_figure(run_figure(ds), options.plot)
        _say_written(options.plot)
    return _finish(*([ds.attrs["status"]] if ds.attrs["status"] != "ok" else []))


def _begun(options):
    for value, name in ((options.scene, "SCENE"), (options.output, "-o/--output")):
        if value is None:
            raise SceneError(f"{name} is missing: name it, or go on from a checkpoint with --resume; see --help")
    stored = _is_netcdf(options.scene)
    if stored:
        from .store import open_dataset

        before = open_dataset(options.scene)
    else:
        scene = _scene(options.scene)
    _refuse_output(options)
    for path in (options.plot, options.checkpoint):
        if path is not None:
            _refuse_scene(path, options)
    if options.plot is not None:
        _refuse_picture(options.plot)
    from .run import rerun, simulate

    arguments = {"output": options.output, "checkpoint": options.checkpoint, **_given(options)}
    return rerun(before, **arguments) if stored else simulate(scene, **arguments)


def _resumed(options):
    if _given(options) or options.checkpoint is not None:
        raise SceneError(
            "--resume: a run goes on as it began and where it did; leave out --checkpoint and all but -o and --plot"
        )
    if options.output is None:
        from .checkpoint import read

        options.output = read(options.resume)[0]["output"]
    if options.output is None:
        raise StoreError(f"{options.resume}: the run had no output; name one with -o")
    _refuse_output(options)
    if options.plot is not None:
        _refuse_picture(options.plot)
    from .run import resume

    return resume(options.resume, scene=_scene(options.scene) if options.scene else None, output=options.output)


def _plan(options) -> int:
    from .planning import plan

    print(plan(_scene(options.scene), options.tolerance))
    return 0


def _sweep(options) -> int:
    scene = _scene(options.scene)
    _refuse_output(options)
    from .sweep_command import run

    ds = run(scene, options, _given(options), _complain)
    _say_written(options.output)
    return FAILED_RUN if ds.attrs["failed"] == ds.attrs["points"] else 0


def _plot(options) -> int:
    from .plots import plot, save_figure
    from .store import open_dataset

    ds = open_dataset(options.file)
    if ds.attrs.get("unit_system") == "SI":
        raise StoreError(
            f"{options.file}: in SI units, figures are drawn in the paper's; name the file from before to_si"
        )
    picture = options.output if options.output is not None else Path(options.file).with_suffix(".png")
    _refuse_picture(picture)
    save_figure(plot(ds), picture)
    _say_written(picture)
    return 0


def _presets(options) -> int:
    from .presets import PRESETS, preset

    if options.name is not None:
        print(preset(options.name).to_toml(), end="")
        return 0
    for name, build in PRESETS.items():
        print(f"{name:<8} {build.__doc__.splitlines()[0]}")
    return 0
