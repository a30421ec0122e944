"""The public checker of the CF conventions, where it is installed (extra `cf`), and the rules that need no checker."""

import json
import re

import pytest
import xarray as xr

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
# The checker asks this of any dimension that bears one of these names; CF-1.11 does not, and for time it could not be met:
# a standard name "time" needs units with a date, which time in 1/omega_0, or of traffic, has not.
# https://github.com/ioos/compliance-checker/issues/1245
NOT_OF_CF = re.compile(r"Coordinate variable '(time|height)' should have standard_name='\1', found: 'None'")


def check_by_hand(path):
    """What CF asks of names and attributes, and what a reader asks besides: a long_name throughout."""
    with xr.open_dataset(path, decode_times=False) as ds:
        assert ds.attrs["Conventions"] == "CF-1.11" and ds.attrs["title"] and ds.attrs["history"]
        for name in [*ds.variables, *ds.dims, *ds.attrs]:
            assert NAME.fullmatch(name), name
        for name, values in ds.variables.items():
            assert values.attrs.get("long_name"), name
            # axis T, or a date in the units, makes a time coordinate, which must have both
            assert values.attrs.get("axis") != "T" and "since" not in values.attrs.get("units", ""), name
            assert name not in ds.dims or "_FillValue" not in values.encoding, name


def errors(path, folder) -> list[str]:
    """What the checker calls errors in the netCDF file at `path`; the test is skipped where it is not installed."""
    runner = pytest.importorskip("compliance_checker.runner", reason="pip install '.[cf]'")
    runner.CheckSuite.load_all_available_checkers()
    report = folder / "report.json"
    arguments = {"verbose": 0, "criteria": "strict", "output_format": "json", "output_filename": str(report)}
    runner.ComplianceChecker.run_checker(str(path), ["cf:1.11"], **arguments)
    found = json.loads(report.read_text())["cf:1.11"]["high_priorities"]
    assert found
    messages = [message for check in found for message in check["msgs"]]
    return [message for message in messages if not NOT_OF_CF.fullmatch(message)]
