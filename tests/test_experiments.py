"""Every experiment runs in its quick form, asserts its numbers, and writes its data and picture."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cf
import numpy as np
import pytest
import xarray as xr

FOLDER = Path(__file__).parent.parent / "experiments"
SCRIPTS = sorted(p for p in FOLDER.glob("*.py") if "def main" in p.read_text())


@pytest.fixture(scope="module")
def runs(request, tmp_path_factory):
    """What the selected scripts do, as many at once as there are cores: (process, folder) by script, to be waited for."""

    def run(script, folder):
        command = [sys.executable, str(script), "--quick", "--output", str(folder)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120), folder

    scripts = [item.callspec.params["script"] for item in request.session.items if item.path == request.path]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield {s: pool.submit(run, s, tmp_path_factory.mktemp(f"test_experiment_{s.stem}")) for s in scripts}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_experiment(script, runs):
    done, folder = runs[script].result()
    assert done.returncode == 0, done.stderr
    assert (folder / f"{script.stem}.png").stat().st_size > 10_000  # an empty figure has less
    with xr.open_dataset(folder / f"{script.stem}.nc", decode_times=False) as ds:
        numbers = [v.values for v in ds.data_vars.values() if v.dtype.kind == "f"]
    assert numbers and all(np.isfinite(v).any() for v in numbers)
    cf.check_by_hand(folder / f"{script.stem}.nc")
