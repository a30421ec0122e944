"""A checkpoint: one file from which a run goes on, whole or not there, with a checksum of all that is in it.

A line that says what it is, a line of JSON (version, scene, numerics, numbers of the state, and the names, types and
shapes of its arrays), the bytes of the arrays, and the SHA-256 of everything before it. Nothing in it is executed.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress

import numpy as np

from .errors import StoreError, shown
from .store import VERSION, clear_unfinished, replace_file

MAGIC = b"traffic_road checkpoint 1\n"
DIGEST = hashlib.sha256().digest_size
LONGEST_LINE = 1 << 31


def write(path, facts: dict, state: dict | None) -> None:
    """Store `facts` (what JSON can say) and `state` (numbers and arrays by name). StoreError if that is impossible."""
    state = state or {}
    arrays = {name: np.ascontiguousarray(value) for name, value in state.items() if isinstance(value, np.ndarray)}
    numbers = {name: value for name, value in state.items() if name not in arrays}
    table = [[name, value.dtype.str, value.shape] for name, value in arrays.items()]
    head = {"version": VERSION, "facts": facts, "numbers": numbers, "arrays": table}
    line = json.dumps(head, default=lambda value: value.item()).encode() + b"\n"  # .item(): a number of numpy

    def put(temporary):
        digest = hashlib.sha256()
        with open(temporary, "wb") as file:
            for part in (MAGIC, line, *(value.reshape(-1).view(np.uint8) for value in arrays.values())):
                file.write(part)
                digest.update(part)
            file.write(digest.digest())
            file.flush()
            os.fsync(file.fileno())

    replace_file(path, put)


def read(path) -> tuple[dict, dict | None]:
    """The facts and the state at `path`; StoreError for anything but a whole checkpoint of this version."""
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(len(MAGIC)) != MAGIC:
                raise StoreError(f"{path}: no checkpoint of traffic_road; name the file of checkpoint=")
            if not _is_whole(file, size):
                raise StoreError(f"{path}: truncated or damaged checkpoint, its checksum is wrong; start the run again")
            file.seek(len(MAGIC))
            head = json.loads(file.readline(LONGEST_LINE))
            if head["version"] != VERSION:
                raise StoreError(
                    f"{path}: a checkpoint of version {shown(head['version'])}, this is {VERSION}, whose bits may differ; "
                    "finish it with the version that began it, or start the run again"
                )
            state = head["numbers"]
            for name, kind, shape in head["arrays"]:
                values = np.empty(shape, kind)
                file.readinto(values.reshape(-1).view(np.uint8))
                state[name] = values
    except FileNotFoundError:
        raise StoreError(
            f"{path}: no such checkpoint; a run that has finished has removed it, and one that has not begun has none"
        ) from None
    except (OSError, ValueError, TypeError) as error:
        if isinstance(error, StoreError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise StoreError(f"{path}: cannot read the checkpoint: {reason}; name the file of checkpoint=") from None
    return head["facts"], state or None


def _is_whole(file, size) -> bool:
    digest, left = hashlib.sha256(MAGIC), size - len(MAGIC) - DIGEST
    while left > 0:
        part = file.read(min(left, 1 << 24))
        if not part:
            break
        digest.update(part)
        left -= len(part)
    return left == 0 and file.read() == digest.digest()


def remove(path) -> None:
    """No checkpoint at `path` any more, nor what a killed process has left of one."""
    clear_unfinished(path)
    with suppress(FileNotFoundError):
        os.unlink(path)
