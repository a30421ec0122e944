"""Every experiment runs in its quick form, asserts its numbers, and writes its data and picture."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "experiments"
SCRIPTS = sorted(p for p in FOLDER.glob("*.py") if "def main" in p.read_text())


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_experiment(script, tmp_path):
    command = [sys.executable, str(script), "--quick", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for ending in (".nc", ".png"):
        assert (tmp_path / f"{script.stem}{ending}").stat().st_size > 10_000
