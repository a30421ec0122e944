"""Compiled code on the disk: what is read back is what was compiled, whoever else compiles, or is killed, meanwhile."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import pytest
from numba.core import caching

from traffic_road import compiled  # replaces what numba's own cache would do
from traffic_road.models import even_layout


def own():
    return caching.IndexDataCacheFile


def numbas():
    """The class as numba has it."""
    spec = find_spec("numba.core.caching")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.IndexDataCacheFile


def meanwhile(kind, folder):
    """What is found for each of two keys after one process has saved "one" while another saved "two"."""
    first, second = kind(str(folder), "f", "source"), kind(str(folder), "f", "source")
    before, write = second._load_index(), first._save_data
    second._load_index = lambda: dict(before)

    def interrupted(name, data):
        second.save("two", 2)
        write(name, data)

    first._save_data = interrupted
    first.save("one", 1)
    return [kind(str(folder), "f", "source").load(key) for key in ("one", "two")]


def killed(kind, folder):
    """What is found for a key, known from an older source, after a process was killed before the new code was written."""
    kind(str(folder), "f", "old source").save("key", "old code")
    cache = kind(str(folder), "f", "source")

    def kill(name, data):
        raise KeyboardInterrupt

    cache._save_data = kill
    with pytest.raises(KeyboardInterrupt):
        cache.save("key", "code")
    return kind(str(folder), "f", "source").load("key")


def test_two_processes_that_compile_at_the_same_time(tmp_path):
    for found, wanted in zip(meanwhile(own(), tmp_path), (1, 2), strict=True):
        assert found in (wanted, None)  # None: compiled once more


def test_a_process_that_is_killed_before_the_code_is_written(tmp_path):
    assert killed(own(), tmp_path) is None


def test_what_is_saved_is_found(tmp_path):
    cache = own()(str(tmp_path), "f", "source")
    for key in range(5):
        cache.save(key, str(key))
    assert [own()(str(tmp_path), "f", "source").load(key) for key in range(6)] == ["0", "1", "2", "3", "4", None]
    assert own()(str(tmp_path), "f", "other source").load(0) is None


def test_code_of_older_sources_is_removed(tmp_path):
    for key in range(3):
        own()(str(tmp_path), "f", "source").save(key, "old")
        own()(str(tmp_path), "f2", "source").save(key, "other")
    own()(str(tmp_path), "f", "new source").save(0, "new")
    own()(str(tmp_path), "f", "new source").save(1, "new")
    assert len(list(tmp_path.glob("f.*.nbc"))) == 2 and len(list(tmp_path.glob("f2.*.nbc"))) == 3
    assert own()(str(tmp_path), "f", "new source").load(0) == own()(str(tmp_path), "f", "new source").load(1) == "new"


def test_numba_still_needs_this(tmp_path):
    # if this fails numba has mended it: traffic_road/compiled.py can go
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    assert meanwhile(numbas(), tmp_path / "a")[1] == 1 and killed(numbas(), tmp_path / "b") == "old code"


def test_nothing_is_compiled_without():
    sources = {path.name: path.read_text() for path in Path(compiled.__file__).parent.rglob("*.py")}
    assert sum("@njit(" in text for text in sources.values()) > 5
    assert [
        name for name, text in sources.items() if re.search(r"^from numba import .*jit|numba\.njit", text, re.M)
    ] == ["compiled.py"]


def test_code_is_as_old_as_all_that_it_is_made_of(tmp_path):
    package = Path(compiled.__file__).parent
    known = set(compiled.sources(package))
    made = [path for path in package.rglob("*.py") if "@njit(" in path.read_text()]
    # and what those files take constants from, or functions
    for path in made:
        for module in re.findall(r"^from (\.+[\w.]*) import", path.read_text(), re.M):
            dots = len(module) - len(module.lstrip("."))
            found = path.parents[dots - 1].joinpath(*module[dots:].split("."))
            named = found.with_suffix(".py") if found.with_suffix(".py").exists() else found / "__init__.py"
            made += [named] if named not in made and named.name not in ("compiled.py", "errors.py") else []
    assert known >= set(made) - {package / "compiled.py"}, set(made) - known
    shutil.copytree(package, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__"))
    assert compiled.age(tmp_path / "copy") == compiled.AGE
    for name in ("laws.py", "models/even_layout.py", "schemes/passage.py"):
        path = tmp_path / "copy" / name
        text = path.read_text()
        path.write_text(text + "\n")
        assert compiled.age(tmp_path / "copy") != compiled.AGE
        path.write_text(text)
    assert even_layout.place._cache._cache_file._source_stamp[1] == compiled.AGE


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="tells what is loaded on Linux alone")
@pytest.mark.parametrize(
    ("given", "spins"), [({}, "2000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, None)]
)
def test_threads_let_go_of_the_processor(given, spins):
    """Said before OpenMP is loaded, which reads it but once; what the user has said stays."""
    loaded = "'gomp' in open('/proc/self/maps').read()"
    code = f"import os, traffic_road.models.cars; print(os.environ.get('GOMP_SPINCOUNT'), {loaded})"
    plain = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run([sys.executable, "-c", code], env=plain | given, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(spins), "False"]
