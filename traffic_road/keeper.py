"""Where the samples of a run go, and what is left of it if it ends before its time.

`Memory` holds them. `Disk` streams them to a journal, publishes the netCDF file of the run so far on a schedule whose cost
is bounded, and writes checkpoints, from which `run.resume` goes on. Both have what `run` calls:

begin(attempt, numerics)   samples follow, from the first or, for what a checkpoint left, from where it stood
append(sample)             .count of them, the .last one
breathe(breath)            the run stands where it can be left
stepped(status)            no more samples
finish(outcome)            the Dataset
"""

from __future__ import annotations

import os
import shlex
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import xarray as xr

from . import checkpoint
from .errors import StoreError
from .scene import Scene
from .store import assemble, clear_unfinished, dataset, history, unwritable
from .stream import Journal, opened

IN_MEMORY = 1 << 26  # bytes of samples up to which the Dataset is given back in memory
SHARE = 0.05  # of the time, at most, for writing files: the next is written after this many times what the last took
FIRST = 1.0  # seconds until the first netCDF file


class Job(NamedTuple):
    """What was asked for. `given`: numerics that were; `times`: of the samples, `even`: whether their number tells them;
    `allow_unstable`: whether it may run where it cannot be trusted; `plan`: that of model="auto", as a dict.
    """

    scene: Scene
    model: str
    tolerance: float
    given: dict
    times: np.ndarray
    even: bool
    allow_unstable: bool
    plan: dict | None = None

    def facts(self) -> dict:
        """All but the times, as JSON can say it."""
        return self._asdict() | {"scene": self.scene.to_dict(), "times": None}

    @classmethod
    def of(cls, facts: dict, times) -> Job:
        """The job whose `facts` these are."""
        return cls(
            Scene.from_dict(facts["scene"]),
            facts["model"],
            facts["tolerance"],
            facts["given"],
            times,
            facts["even"],
            facts["allow_unstable"],
            facts["plan"],
        )


class Memory:
    """Samples in memory; nothing is left of a run that ends early."""

    output = numerics = state = status = None
    attempt, elapsed = 0, 0.0

    def __init__(self, job):
        self.job = job

    def begin(self, attempt, numerics):
        self.numerics, self.samples = numerics, []

    def append(self, sample):
        self.samples.append(sample)

    @property
    def count(self):
        return len(self.samples)

    @property
    def last(self):
        return self.samples[-1]

    def breathe(self, breath):
        pass

    def stepped(self, status):
        pass

    def finish(self, outcome) -> xr.Dataset:
        return assemble(self.job.scene, self.job.model, self.numerics, self.samples, outcome)


class Disk:
    """Samples in a journal, the netCDF file `output` and the file `checkpoint`, either of which may be None."""

    def __init__(self, job, output, path, every, left: tuple | None = None):
        self.job, self.every = job, every
        self.output = None if output is None else os.path.abspath(output)
        self.path = None if path is None else os.path.abspath(path)
        self.attempt, self.elapsed, self.numerics, self.status, self.state = 0, 0.0, None, None, None
        self.journal = self.resumed = None
        self.stepping = False  # whether a breath is to come
        self.stop = False  # whether the run is to end there
        self.kept = None  # the time up to which a checkpoint has what is needed
        self.wrote = self.published = perf_counter()
        self.cost = {"checkpoint": 0.0, "publish": 0.0}
        if left is not None:
            facts, self.state = left
            self.attempt, self.elapsed, self.numerics = facts["attempt"], facts["elapsed"], facts["numerics"]
            self.status, self.resumed, self.kept = facts["status"], facts["journal"], facts["time"]

    def _journal_path(self, attempt):
        return f"{self.path}.samples-{attempt}"

    @property
    def count(self):
        return self.journal.count

    @property
    def last(self):
        return self.journal.last

    def begin(self, attempt, numerics):
        before, self.stepping = self.journal, True
        self.attempt, self.numerics = attempt, numerics
        self.began = perf_counter() - self.elapsed
        if self.resumed is not None:
            self.journal = Journal.reopened(self._journal_path(attempt), **self.resumed)
            self.resumed = None
            self._clear()
            return
        self.state = self.status = None
        self.elapsed, self.began = 0.0, perf_counter()
        if self.path is None:
            folder = Path(os.path.realpath(self.output)).parent
            with _writing(folder):
                self.journal = Journal.nameless(folder)
            return
        with _writing(self._journal_path(attempt)):
            self.journal = Journal.new(self._journal_path(attempt))
        if before is None:
            self._clear()
        self._checkpoint(None, 0.0)
        if before is not None:
            before.file.close()
            os.unlink(before.name)

    def _clear(self):
        """Remove what a killed process has left; the journal is locked, so that it is dead."""
        for name in filter(None, (self.path, self.output)):
            clear_unfinished(name)

    def append(self, sample):
        with _writing(self.journal.name, self._remedy()):
            self.journal.append(sample)
        self._publish_if_due()

    def breathe(self, breath):
        due = perf_counter() > self.wrote + max(self.every, self.cost["checkpoint"] / SHARE)
        if self.path is not None and (self.stop or due):
            self._checkpoint(breath.state(), breath.time)
        if self.stop:
            raise KeyboardInterrupt(self.farewell())
        self._publish_if_due()

    def stepped(self, status):
        """The samples are complete; what follows, an estimate of the error, can be asked for again."""
        self.stepping, self.status = False, status
        if self.path is not None:
            self._checkpoint(None, float(self.last.time))
        if self.stop:
            raise KeyboardInterrupt(self.farewell())

    def _checkpoint(self, state, time):
        begin = perf_counter()
        journal = {"sizes": self.journal.sizes, "count": self.count, "crc": self.journal.crc}
        facts = {
            **self.job.facts(), "numerics": self.numerics, "attempt": self.attempt, "output": self.output,
            "every": self.every, "status": self.status, "elapsed": begin - self.began, "time": time, "journal": journal,
        }  # fmt: skip
        with _writing(self.journal.name, self._remedy()):
            self.journal.flush()
            checkpoint.write(self.path, facts, {**(state or {}), "times": self.job.times})
        self.kept, self.wrote = time, perf_counter()
        self.cost["checkpoint"] = self.wrote - begin

    def _publish_if_due(self):
        wait = max(FIRST, self.cost["publish"] / SHARE)
        if self.output is not None and self.count and perf_counter() > self.published + wait:
            reached = f"unfinished: has reached time {self.last.time:.6g} of {self.job.times[-1]:.6g}"
            self._publish(self.unfinished(reached))

    def unfinished(self, status) -> dict:
        """The attributes of a file of the run so far."""
        outcome = {
            "tolerance": self.job.tolerance,
            "error_estimate": np.nan,
            "error_method": "none: the run is unfinished",
        }
        return outcome | {"wall_time": perf_counter() - self.began, "updates": self.last.updates, "status": status}

    def _publish(self, outcome):
        begin = perf_counter()
        with _writing(self.output, self._remedy()):
            self.journal.publish(self.output, self.job.scene, self.job.model, self.numerics, outcome)
        self.published = perf_counter()
        self.cost["publish"] = self.published - begin

    def finish(self, outcome) -> xr.Dataset:
        outcome = outcome | {"history": history()}  # one time: what is given back is what stands in the file
        if self.output is not None:
            self._publish(outcome)
        if self.output is not None and self.journal.nbytes > IN_MEMORY:
            ds = opened(self.output)
        else:
            ds = dataset(self.job.scene, self.job.model, self.numerics, self.journal.columns(), outcome)
        if self.path is not None:
            checkpoint.remove(self.path)
        self.close()
        if self.path is not None:
            for attempt in range(self.attempt + 1):
                Path(self._journal_path(attempt)).unlink(missing_ok=True)
        return ds

    def close(self):
        if self.journal is not None:
            with suppress(OSError):  # a full disk has been complained of already
                self.journal.file.close()

    def discard(self):
        """Leave nothing of a run that could not begin."""
        if self.path is not None and self.journal is not None and not self.count:
            checkpoint.remove(self.path)
            os.unlink(self.journal.name)

    def _remedy(self):
        return "" if self.kept is None else f"; then go on with {self._how_to_go_on()}"

    def _how_to_go_on(self):
        return f"tr.resume({self.path!r}) or traffic-road run --resume {shlex.quote(self.path)}"

    def farewell(self) -> str:
        """What is kept of a run that was interrupted, and how to go on, in one line."""
        if self.kept is not None:
            return (
                f"interrupted: time {self.kept:.6g} of {self.job.times[-1]:.6g} is kept; "
                f"go on with {self._how_to_go_on()}"
            )
        if self.output is not None and self.journal is not None and self.count and self.cost["publish"] < 1.0:
            self._publish(self.unfinished(f"interrupted at time {self.last.time:.6g}"))
            return (
                f"interrupted: {self.output} has all up to time {self.last.time:.6g} of {self.job.times[-1]:.6g}; "
                "to be able to go on, start with a checkpoint"
            )
        return "interrupted: nothing was kept; to be able to go on, start with a checkpoint"


@contextmanager
def _writing(name, remedy=""):
    """A StoreError in one line for whatever goes wrong with the file `name`."""
    try:
        yield
    except StoreError as error:
        raise StoreError(f"{error}{remedy}") from error
    except OSError as error:
        raise StoreError(f"{unwritable(name, error)}{remedy}") from error
