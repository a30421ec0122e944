"""Every experiment runs in its quick form, asserts its numbers, and writes its data and picture."""

import os
import runpy
from pathlib import Path
from unittest.mock import patch

import cf
import numpy as np
import pytest
import xarray as xr

FOLDER = Path(__file__).parent.parent / "experiments"
SCRIPTS = sorted(p for p in FOLDER.glob("*.py") if "def main" in p.read_text())


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_experiment(script, tmp_path, monkeypatch):
    # as a script, but in this process: each of its own would load all libraries and compiled loops again, for 4 s
    monkeypatch.setattr("sys.argv", [str(script), "--quick", "--output", str(tmp_path)])
    monkeypatch.syspath_prepend(FOLDER)
    with patch.dict(os.environ):
        runpy.run_path(str(script), run_name="__main__")
    assert (tmp_path / f"{script.stem}.png").stat().st_size > 10_000  # an empty figure has less
    with xr.open_dataset(tmp_path / f"{script.stem}.nc", decode_times=False) as ds:
        numbers = [v.values for v in ds.data_vars.values() if v.dtype.kind == "f"]
    assert numbers and all(np.isfinite(v).any() for v in numbers)
    cf.check_by_hand(tmp_path / f"{script.stem}.nc")
