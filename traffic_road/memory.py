"""What does not fit in memory is refused before it is asked for: a machine that swaps, or kills, says nothing of use."""

from __future__ import annotations

import os
from pathlib import Path

from .errors import SceneError

# folder, limit and use of the group of processes that this one is in: cgroup 2, then 1, as containers show them
GROUPS = (
    ("/sys/fs/cgroup", "memory.max", "memory.current"),
    ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"),
)
CACHE = {"inactive_file", "active_file"}  # counted as used, but given back when needed
SMALL = 10_000_000  # numbers that no machine of today lacks room for


def available() -> float:
    """Bytes that this process may still take: of the machine, of its group, of its own limit; inf where none is known."""
    return min(_of_machine(), _of_group(), _of_process())


def _of_machine() -> float:
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError):
        return float("inf")


def _of_group() -> float:
    for folder, limit, use in GROUPS:
        try:
            free = float(Path(folder, limit).read_text(encoding="ascii"))
            free -= float(Path(folder, use).read_text(encoding="ascii"))
            counts = (line.split() for line in Path(folder, "memory.stat").read_text(encoding="ascii").splitlines())
            return free + sum(float(count) for name, count in counts if name in CACHE)
        except (OSError, ValueError):  # ValueError: "max"
            continue
    return float("inf")


def _of_process() -> float:
    try:
        import resource  # unknown to Windows

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return float("inf")
        return float(
            limit - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        )
    except (ImportError, OSError, ValueError):
        return float("inf")


def refuse_beyond_memory(values: float, what: str, remedy: str) -> None:
    """SceneError if `values` numbers of 8 bytes, for `what`, are more than memory holds."""
    if values < SMALL:
        return
    needed, free = 8.0 * values, available()
    if needed > free:
        raise SceneError(f"{what}: {needed / 1e9:.3g} GB of memory are needed, {free / 1e9:.3g} GB are free; {remedy}")
