"""Every experiment runs in its quick form, asserts its numbers, and writes its data and picture."""

import subprocess
import sys
from pathlib import Path

import cf
import numpy as np
import pytest
import xarray as xr

FOLDER = Path(__file__).parent.parent / "experiments"
SCRIPTS = sorted(p for p in FOLDER.glob("*.py") if "def main" in p.read_text())


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_experiment(script, tmp_path):
    command = [sys.executable, str(script), "--quick", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"{script.stem}.png").stat().st_size > 10_000  # an empty figure has less
    with xr.open_dataset(tmp_path / f"{script.stem}.nc", decode_times=False) as ds:
        numbers = [v.values for v in ds.data_vars.values() if v.dtype.kind == "f"]
    assert numbers and all(np.isfinite(v).any() for v in numbers)
    cf.check_by_hand(tmp_path / f"{script.stem}.nc")
