"""Who computes the points: processes of this machine, or the workers of a Dask cluster.

Both take batches from one queue and give back rows as they come; what a worker that died was at is computed again. A
local process is a Python of its own that is fed through a pipe: it starts with one thread for each numerical library,
needs no guarded main module, hears no Ctrl-C, and ends when the pipe does, however its parent ended.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
from collections import Counter, deque
from contextlib import suppress
from queue import SimpleQueue

from ..errors import SceneError, TrafficRoadError, shown
from .points import Task, compute, warm_up

BATCH_SECONDS = 0.3  # small scenes go out by the dozen, so that messages and transactions cost little
MOST_IN_BATCH = 1000
LIVES = 2  # processes that may die over one point before it counts as failed
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
# as where Dask is not installed: xarray loads it wherever it is, a sixth of what a process takes to its first point
START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); sys.modules['dask'] = None; "
    "from traffic_road.sweeps.pool import work; work()"
)


class Batches:
    """Points to compute, in batches that grow until one lasts BATCH_SECONDS; safe to share between threads."""

    def __init__(self, points, workers: int):
        self._left = deque(points)
        self._suspects: deque = deque()  # points of batches that were lost, handed out one by one
        self._deaths: Counter = Counter()
        self._workers = workers
        self._open = len(self._left)
        self._seconds, self._timed = 0.0, 0
        self._closed = False
        self._change = threading.Condition()

    def take(self, wait: bool = True) -> list[int]:
        """The next batch; empty when all points are done or, without `wait`, when all are under way."""
        with self._change:
            # after `close` what is still done counts below 0
            while wait and self._open > 0 and not self._left and not self._suspects:
                self._change.wait()  # a lost batch may still come back
            if self._suspects:
                return [self._suspects.popleft()]
            size = int(BATCH_SECONDS * self._timed / max(self._seconds, 1e-9)) if self._timed else 1
            # towards the end smaller ones, so that all workers end together
            size = max(1, min(size, MOST_IN_BATCH, len(self._left) // (2 * self._workers)))
            return [self._left.popleft() for _ in range(min(size, len(self._left)))]

    def done(self, batch, seconds: float) -> None:
        with self._change:
            self._open -= len(batch)
            self._timed += len(batch)
            self._seconds += seconds
            self._change.notify_all()

    def lost(self, batch, why: str) -> list[tuple[int, dict]]:
        """Take back the batch of a worker that died. The row of a point that has cost LIVES workers, if it is one."""
        with self._change:
            if self._closed:
                return []
            if len(batch) == 1:
                self._deaths[batch[0]] += 1
                if self._deaths[batch[0]] >= LIVES:
                    self._open -= 1
                    self._change.notify_all()
                    return [(batch[0], {"status": f"WorkerError: {why}, {LIVES} times; too large for its memory?"})]
            self._suspects.extend(batch)
            self._change.notify_all()
            return []

    def close(self) -> None:
        with self._change:
            self._left.clear()
            self._suspects.clear()
            self._open, self._closed = 0, True
            self._change.notify_all()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def local(task: Task, points, workers: int):
    """Yield the rows (number, row) of `points`, in lists as they are finished by so many processes."""
    workers = min(workers, len(points))
    batches, finished, processes, warm = Batches(points, workers), SimpleQueue(), set(), threading.Event()
    servants = [
        threading.Thread(target=_serve, args=(task, batches, finished, processes, warm), daemon=True)
        for _ in range(workers)
    ]
    for servant in servants:
        servant.start()
    left = len(points)
    try:
        if left:
            warm_up(task)  # while the others start, which would else all compile, and write to one cache at once
        warm.set()
        while left:
            ready = [finished.get()]
            while not finished.empty():  # what else is there goes on the disk in the same transaction
                ready.append(finished.get())
            for rows in ready:
                if isinstance(rows, BaseException):
                    raise rows
            rows = [row for rows in ready for row in rows]
            left -= len(rows)
            yield rows
    finally:
        batches.close()
        warm.set()
        while any(servant.is_alive() for servant in servants):
            for process in list(processes):  # anew each time: one may just have started
                process.kill()
            for servant in servants:
                servant.join(0.05)


def _serve(task, batches, finished, processes, warm):
    """A thread: one process, started again when it dies, and its batches."""
    process = None
    try:
        process = _start(task, processes)
        warm.wait()
        while batch := batches.take():
            if process is None:
                process = _start(task, processes)
            try:
                pickle.dump(batch, process.stdin)
                process.stdin.flush()
                while batch:
                    rows, seconds = pickle.load(process.stdout)
                    batch = batch[1:]
                    batches.done(rows, seconds)
                    finished.put(rows)
            except (EOFError, OSError, pickle.UnpicklingError):
                _end(process, processes)
                finished.put(batches.lost(batch, f"the process that computed it ended with {process.returncode}"))
                process = None
    except BaseException as error:
        finished.put(error)
    finally:
        if process is not None:
            _end(process, processes)


def _start(task, processes):
    process = subprocess.Popen(
        [sys.executable, "-c", START, json.dumps(sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, **{f"{name}_NUM_THREADS": "1" for name in THREADS}},
        start_new_session=True,
    )
    processes.add(process)
    try:
        pickle.dump(task, process.stdin)
        process.stdin.flush()
        pickle.load(process.stdout)  # it is up
    except (EOFError, OSError, pickle.UnpicklingError):
        _end(process, processes)
        raise TrafficRoadError(f"a process of the sweep did not start: status {process.returncode}") from None
    return process


def _end(process, processes) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with suppress(OSError):  # what was not sent cannot be any more
            pipe.close()
    processes.discard(process)


def work() -> None:
    """The life of a local process: a task, then batches, from stdin; each row at once to stdout, until stdin ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not print into the answers
    task = pickle.load(sys.stdin.buffer)
    batches = SimpleQueue()

    def listen():
        while True:
            try:
                batches.put(pickle.load(sys.stdin.buffer))
            except (EOFError, OSError, pickle.UnpicklingError):  # no more, or half a batch: whoever sent it is gone
                os._exit(0)  # in the midst of a point, too: nobody waits for it

    threading.Thread(target=listen, daemon=True).start()
    pickle.dump("up", answers)
    answers.flush()
    while True:
        for point in batches.get():
            answer = compute(task, [point])
            try:
                pickle.dump(answer, answers)
                answers.flush()
            except OSError:  # whoever asked has been killed: no trace of that, and no wait for other threads
                os._exit(0)


def on_cluster(task: Task, points, client):
    """Yield the rows (number, row) of `points`, in lists as the workers of a Dask cluster finish them.

    client: a distributed.Client, or the address of a scheduler. TrafficRoadError if there is no such cluster.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise TrafficRoadError("a sweep on a cluster needs Dask: pip install 'traffic_road[cluster]'") from None
    if isinstance(client, str):
        try:
            own = Client(client, timeout=10, set_as_default=False)  # or one that fails would be in xarray's way
        except (OSError, ValueError) as error:
            raise TrafficRoadError(f"{client}: no Dask scheduler answers there: {error}") from None
        with own:
            yield from on_cluster(task, points, own)
        return
    if not isinstance(client, Client):
        raise SceneError(f"client = {shown(client)}: must be a distributed.Client or the address of a scheduler")
    batches, left = Batches(points, _threads(client)), len(points)
    running: dict = {}
    pending = as_completed()

    def submit():
        while len(running) < 2 * _threads(client) and (batch := batches.take(wait=False)):
            future = client.submit(compute, task, batch, pure=False)
            running[future] = batch
            pending.add(future)

    try:
        submit()
        for future in pending:
            batch = running.pop(future)
            error = future.exception() if future.status == "error" else None
            if isinstance(error, KilledWorker):
                rows = batches.lost(batch, "the worker that computed it died")
            elif error is not None:
                raise error
            elif future.status != "finished":
                raise TrafficRoadError(f"the cluster has dropped a batch ({future.status}); is its scheduler alive?")
            else:
                rows, seconds = future.result()
                batches.done(batch, seconds)
            left -= len(rows)
            if rows:
                yield rows
            submit()
        if left:
            raise TrafficRoadError("the cluster gave up; is its scheduler alive?")
    finally:
        client.cancel(list(running))


def _threads(client) -> int:
    return max(1, sum(client.ncores().values()))
