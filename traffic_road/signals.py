"""Signals that ask a run to end: it does so where it can be left, and says what was kept."""

from __future__ import annotations

import _thread
import signal
import threading
from contextlib import contextmanager

from .errors import SceneError, StabilityError

PATIENCE = 1.2  # seconds after a signal until the run is stopped wherever it is


@contextmanager
def guarded(disk):
    """Let SIGINT or SIGTERM stop the run of a `keeper.Disk` at its next breath, or wherever it is if that is not soon.

    Only in the main thread, as Python has it; handlers are put back. KeyboardInterrupt says what was kept.
    """
    timers = []

    def stop(number, frame):
        if timers or not disk.stepping:  # the second signal, or the clock's, or nothing to wait for
            raise KeyboardInterrupt
        disk.stop = True
        timers.append(threading.Timer(PATIENCE, _thread.interrupt_main, (number,)))
        timers[0].daemon = True
        timers[0].start()

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):  # None: not of Python, it could not be put back
                before[number] = signal.signal(number, stop)
    try:
        yield
    except KeyboardInterrupt as stopped:
        if stopped.args:
            raise
        raise KeyboardInterrupt(disk.farewell()) from None
    except (SceneError, StabilityError):
        disk.discard()
        raise
    finally:
        for timer in timers:
            timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)
        disk.close()
