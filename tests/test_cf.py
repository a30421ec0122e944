"""Every kind of file that the package writes passes the public checker of the CF conventions, CF-1.11, without an error."""

import os
from dataclasses import replace
from pathlib import Path

import cf
import pytest
import xarray as xr

import traffic_road as tr

SCENE = replace(tr.preset("paper"), duration=30.0, scales=tr.Scales(11.0, 11.0, 200.0))
MIXED = replace(SCENE, fleet=tr.Fleet(3, 0.1, speed=(1.0, 1.1, 0.9)))
MADE = sorted(Path(os.environ.get("MADE", os.devnull)).glob("**/test_experiment_*/*.nc"))  # as .ci/run leaves them
KINDS = {
    "cars": lambda: tr.simulate(SCENE, "cars", samples=4, nodes=256),
    "mixed cars": lambda: tr.simulate(MIXED, "cars", samples=4, nodes=60),
    "continuum": lambda: tr.simulate(SCENE, "continuum", samples=[0.0, 1.0, 30.0]),
    "compare": lambda: tr.compare(SCENE, samples=4, nodes=256),
}


@pytest.fixture(scope="module", params=KINDS)
def ds(request):
    return KINDS[request.param]()


@pytest.mark.parametrize("si", [False, True], ids=["", "si"])
def test_no_errors(ds, si, tmp_path):
    path = tmp_path / "a.nc"
    tr.save(tr.to_si(ds, SCENE.scales) if si else ds, path)
    cf.check_by_hand(path)
    assert cf.errors(path, tmp_path) == []


@pytest.mark.parametrize("path", MADE, ids=lambda path: path.stem)
def test_no_errors_in_what_experiments_made(path, tmp_path):
    assert cf.errors(path, tmp_path) == []


def test_the_checker_bites(tmp_path):
    ds = KINDS["continuum"]()
    ds.time.attrs["axis"] = "T"
    ds.road_height.attrs["units"] = "furlongs per sixpence"
    ds.to_netcdf(tmp_path / "a.nc")
    found = "\n".join(cf.errors(tmp_path / "a.nc", tmp_path))
    assert "time does not have correct time units" in found and "road_height" in found
    with pytest.raises(AssertionError):
        cf.check_by_hand(tmp_path / "a.nc")


def test_si_is_in_si(tmp_path):
    si = tr.to_si(KINDS["cars"](), SCENE.scales)
    tr.save(si, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as stored:
        units = {name: stored[name].attrs["units"] for name in ("time", "x", "road_height", "car_position", "passages")}
    assert units == {"time": "s", "x": "m", "road_height": "m", "car_position": "m", "passages": "1"}
