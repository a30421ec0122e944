"""`traffic-road sweep`: its options, and what it says. Imports nothing heavy before it runs."""

from __future__ import annotations


def add_arguments(parser) -> None:
    """The options of `sweep` besides SCENE and the numerics."""
    parser.add_argument(
        "--over",
        required=True,
        action="append",
        metavar="PATH=VALUES",
        help="a field of the scene and its values: road.softness=0.004:0.006:9 (start:stop:number) or "
        "fleet.damping=0.05,0.1,0.2; more than one --over runs all combinations",
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="netCDF file; started again, it goes on")
    parser.add_argument("--model", choices=("auto", "linear", "cars", "continuum"), help="default: auto")
    parser.add_argument(
        "--measure",
        metavar="NAME,...",
        help="of growth_rate, phase_velocity, amplitude, sink_rate, airborne (default: all)",
    )
    parser.add_argument("--wavenumber", type=float, metavar="K", help="of the wave that is measured")
    parser.add_argument("--members", type=int, metavar="N", help="run N roads of the scene's noise, of their own seeds")
    parser.add_argument("--workers", type=int, metavar="N", help="processes on this machine (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="compute on the Dask cluster of this scheduler")


def run(scene, options, given: dict, complain):
    """Run the sweep; its Dataset. `complain` says that points failed."""
    from .sweeps import sweep
    from .sweeps.axes import parse_over

    if options.measure is not None:
        given = given | {"measure": options.measure.split(",")}
    where = {name: getattr(options, name) for name in ("members", "output", "workers")}
    ds = sweep(scene, parse_over(options.over), client=options.scheduler, **where, **given)
    points, failed = int(ds.attrs["points"]), int(ds.attrs["failed"])
    print(f"{points} points, {points - failed} ok")
    if failed:
        first = next(status for status in ds.status.values.ravel() if status != "ok")
        complain(f"{failed} of {points} points failed, the first with {first}; `status` in the file has them all")
    return ds
