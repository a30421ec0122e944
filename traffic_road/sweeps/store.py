"""Finished points of a sweep that is not complete: one SQLite file beside the output.

A point counts when its transaction is on the disk; a process killed in one leaves the store as it was before. The file is
locked while a sweep runs, and removed when the netCDF file is complete.
"""

from __future__ import annotations

import json
import os
import sqlite3

from ..errors import StoreError

APPLICATION = 0x74726F61  # how a store is known from any other SQLite file


class PointStore:
    """The store at `path`, made if there is none. StoreError if it cannot be used or is of another sweep.

    identity: dict of plain values that say which sweep it is. `rows`: the points found, number -> row.
    """

    def __init__(self, path, identity: dict):
        self.path = os.fspath(path)
        self._connection = None
        try:
            self._connection = sqlite3.connect(self.path, timeout=0.5, isolation_level=None, check_same_thread=False)
            self._open(identity)
            self.rows = {n: json.loads(row) for n, row in self._connection.execute("SELECT number, row FROM points")}
        except (sqlite3.Error, ValueError) as error:
            self.close()
            raise StoreError(f"{self.path}: {_reason(error)}") from None
        except BaseException:
            self.close()
            raise

    def _open(self, identity):
        execute = self._connection.execute
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA synchronous = FULL")
        execute("BEGIN EXCLUSIVE")
        (application,) = execute("PRAGMA application_id").fetchone()
        (tables,) = execute("SELECT count(*) FROM sqlite_master").fetchone()
        if tables and application != APPLICATION:
            raise StoreError(f"{self.path}: is no store of a sweep; delete it or name another output")
        if not tables:  # new, or killed before its first transaction was whole
            execute(f"PRAGMA application_id = {APPLICATION}")
            execute("CREATE TABLE sweep (identity TEXT NOT NULL)")
            execute("CREATE TABLE points (number INTEGER PRIMARY KEY, row TEXT NOT NULL)")
            execute("INSERT INTO sweep VALUES (?)", (json.dumps(identity),))
        (found,) = execute("SELECT identity FROM sweep").fetchone()
        refuse_other(self.path, json.loads(found), identity)
        execute("COMMIT")

    def add(self, rows: list[tuple[int, dict]]) -> None:
        """Put finished points on the disk, all or none. StoreError if that fails, or if one is there already."""
        try:
            self._connection.execute("BEGIN")
            self._connection.executemany(
                "INSERT INTO points VALUES (?, ?)", ((number, json.dumps(row)) for number, row in rows)
            )
            self._connection.execute("COMMIT")
        except sqlite3.Error as error:
            raise StoreError(f"{self.path}: {_reason(error)}; the points stored before are kept") from None
        finally:
            if self._connection.in_transaction:  # an error or Ctrl-C came before the commit
                self._connection.execute("ROLLBACK")

    def finished(self) -> int:
        """How many points are on the disk."""
        return self._connection.execute("SELECT count(*) FROM points").fetchone()[0]

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def remove(self) -> None:
        """Delete the file: the sweep is complete elsewhere."""
        self.close()
        discard(self.path)


def discard(path) -> None:
    """Delete the store at `path`, if there is one, with what SQLite keeps beside it."""
    for name in (f"{path}-journal", os.fspath(path)):
        if os.path.exists(name):
            os.unlink(name)


def refuse_other(path, found: dict, identity: dict) -> None:
    """StoreError unless `found` is the `identity` of this very sweep."""
    # through JSON as the one that was found: tuples are lists there
    identity = json.loads(json.dumps(identity))
    for name in [*identity, *(name for name in found if name not in identity)]:
        if found.get(name) != identity.get(name):
            raise StoreError(f"{path}: belongs to another sweep, its {name} differs; delete it or name another output")


def _reason(error: Exception) -> str:
    text = str(error)
    if "locked" in text:
        return "another sweep is writing it; wait for its end or name another output"
    if "not a database" in text or isinstance(error, ValueError):
        return "is no store of a sweep or is damaged; delete it or name another output"
    return f"cannot write: {text}"
