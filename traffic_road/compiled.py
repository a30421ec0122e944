"""numba's `njit`, its cache on disk made safe for processes that compile at the same time, and for one that is killed.

numba numbers the specialisations of a function as they are compiled, writes the number to an index, then the code to a file
of that number. Two processes that compile different ones take the same number, and from then on one is run in the place of
the other, without a word (numba issues 4807 and 10128); so is the code of an older source, after a process that ended in
between. Here the file's number is a digest of what the code was compiled from, and the code is written before the index.

What a function calls becomes part of its code, and so do constants, from whatever file; numba looks at the function's own
alone, and after an upgrade that leaves this as it is would run the old code of others. Here it is as old as any of `sources`.

Threads that wait for each other spin, by GNU's OpenMP for some 3 ms, before they let go of the processor: beside another job
that has it, the one that they wait for does not come to run, and two threads took up to a hundred times as long as one.
After some tens of microseconds, between passages and relaxation, they have met or should let go.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from glob import escape
from hashlib import sha256
from pathlib import Path

import numba
from numba.core.caching import IndexDataCacheFile

if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "2000")  # read when the first parallel loop is loaded


def _save(self, key, data) -> None:
    """In the place of IndexDataCacheFile.save. What two processes lose at most is an entry of the index."""
    digest = sha256(self._dump((key, self._source_stamp))).digest()
    name = self._data_name(int.from_bytes(digest[:8]))
    fresh = not self._load_index()
    self._save_data(name, data)
    if fresh:  # no index leads to the code of older sources any more, and no number is used again
        for path in Path(self._cache_path).glob(
            escape(self._data_name_pattern.removesuffix("{number:d}.nbc")) + "*.nbc"
        ):
            if path.name != name:
                path.unlink(missing_ok=True)
    self._save_index(self._load_index() | {key: name})


IndexDataCacheFile.save = _save

FOLDERS = "models", "schemes", "theory"


def sources(package: Path) -> list[Path]:
    """The files that compiled code is made of."""
    return [package / "laws.py", *(path for folder in FOLDERS for path in sorted(package.glob(f"{folder}/*.py")))]


def age(package: Path) -> str:
    """Another one after any change of `sources`."""
    return sha256(b"".join(sha256(path.read_bytes()).digest() for path in sources(package))).hexdigest()


AGE = age(Path(__file__).parent)


def njit(**options) -> Callable:
    """numba's, with `cache` among its options."""

    def compiled(function):
        dispatcher = numba.njit(**options)(function)
        file = dispatcher._cache._cache_file
        file._source_stamp = file._source_stamp, AGE
        return dispatcher

    return compiled
