"""The samples of a run on disk: a journal, one record after another, and the netCDF file that is built from it.

An HDF5 file that is being written cannot be read. So samples go to a journal that only this run knows, and from time to
time a whole netCDF file is built from it, block by block, and takes the place of the one before: whoever opens that
file, at any moment, finds a whole one. Memory is that of one sample and one block, whatever the number of samples.
"""

from __future__ import annotations

import os
import tempfile
import zlib

import numpy as np
import xarray as xr

from .errors import StoreError
from .models import Sample
from .store import TEMPORARY, dataset, write_blocks

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # Windows: nothing keeps two runs from the same checkpoint apart
    flock = None

MAGIC = b"traffic_road samples 1".ljust(32, b"\n")
VALUES = ("road_height", "car_height", "contact_force", "car_position")
BLOCK = 1 << 24  # bytes read at a time


class Journal:
    """Samples as records of one size, in a file. `count`, `last`: how many, and the last one; `crc`: their checksum."""

    def __init__(self, file, name, sizes: dict | None = None):
        self.file, self.name, self.sizes = file, name, sizes
        self.count, self.crc, self.last = 0, 0, None
        if sizes is not None:
            self._shape()

    @classmethod
    def nameless(cls, folder) -> Journal:
        """An empty one, in a file that vanishes with the process. OSError if `folder` cannot be written."""
        file = tempfile.TemporaryFile(dir=folder, prefix=TEMPORARY)  # noqa: SIM115
        file.write(MAGIC)
        return cls(file, folder)

    @classmethod
    def new(cls, path) -> Journal:
        """An empty one at `path`, in the place of an older journal but of no other file. OSError if it cannot be written."""
        file = _locked(path, os.O_CREAT)
        if file.read(len(MAGIC)) not in (b"", MAGIC):
            file.close()
            raise StoreError(f"{path}: holds something else than samples of a run; name another checkpoint")
        file.seek(0)
        file.truncate()
        file.write(MAGIC)
        return cls(file, path)

    @classmethod
    def reopened(cls, path, sizes: dict | None, count: int, crc: int) -> Journal:
        """The first `count` samples of the one at `path`; what came after them is cut off. StoreError if they are damaged."""
        try:
            file = _locked(path, 0)
        except FileNotFoundError:
            raise StoreError(f"{path}: missing, it holds the samples of the checkpoint; start the run again") from None
        journal = cls(file, path, sizes)
        try:
            journal._check(count, crc)
        except BaseException:
            file.close()
            raise
        return journal

    def _check(self, count, crc):
        end = len(MAGIC) + count * (self.kind.itemsize if self.sizes else 0)
        if self.file.read(len(MAGIC)) != MAGIC or os.fstat(self.file.fileno()).st_size < end:
            raise StoreError(f"{self.name}: truncated, or no samples of a run; start the run again")
        self.count = count
        for _, records in self.blocks():
            self.crc = zlib.crc32(records.view(np.uint8), self.crc)
            self.last = _sample(records[-1])
        if self.crc != crc:
            raise StoreError(f"{self.name}: damaged, these are not the samples of the checkpoint; start the run again")
        self.file.seek(end)
        self.file.truncate()

    def _shape(self):
        fields = [("time", "<f8"), ("updates", "<i8"), ("airborne", "<i8")]
        self.kind = np.dtype(fields + [(name, "<f8", (size,)) for name, size in self.sizes.items()])
        self.record = np.zeros(1, self.kind)
        self.floats, self.wholes = self.record.view("<f8"), self.record.view("<i8")

    @property
    def nbytes(self) -> int:
        return self.count * self.kind.itemsize

    def append(self, sample: Sample) -> None:
        """Add a sample. OSError if it cannot be written."""
        values = [sample.road_height, sample.car_height, sample.contact_force]
        if sample.where is not None:
            values.append(sample.where)
        if self.sizes is None:
            self.sizes = {name: value.size for name, value in zip(VALUES, values, strict=False)}
            self._shape()
        self.floats[0] = sample.time
        self.wholes[1], self.wholes[2] = sample.updates, -1 if sample.airborne is None else sample.airborne
        np.concatenate(values, out=self.floats[3:])
        raw = self.record.view(np.uint8)
        self.file.write(raw)
        self.count, self.crc, self.last = self.count + 1, zlib.crc32(raw, self.crc), sample

    def flush(self) -> None:
        """All samples on the disk, whatever happens to the machine. OSError if that is impossible."""
        self.file.flush()
        os.fsync(self.file.fileno())

    def blocks(self):
        """Pairs of the number of the first and the records of consecutive samples."""
        if not self.count:
            return
        many = max(1, BLOCK // self.kind.itemsize)
        self.file.seek(len(MAGIC))
        for first in range(0, self.count, many):
            records = np.empty(min(many, self.count - first), self.kind)
            if self.file.readinto(records.view(np.uint8)) != records.nbytes:
                raise StoreError(
                    f"{self.name}: the samples cannot be read back; see to the disk and start the run again"
                )
            yield first, records

    def columns(self) -> dict:
        """All samples: arrays by name, time first."""
        whole = np.empty(self.count, self.kind)
        for first, records in self.blocks():
            whole[first : first + records.size] = records
        return {name: np.ascontiguousarray(whole[name]) for name in ("time", *self.sizes)}

    def publish(self, path, scene, model: str, numerics: dict, outcome: dict) -> None:
        """Write the netCDF file of the run so far, whole or not at all. StoreError if that is impossible."""
        first = next(self.blocks())[1][:1]
        template = dataset(scene, model, numerics, {name: first[name] for name in ("time", *self.sizes)}, outcome)
        write_blocks(path, template, self.count, self.blocks)


def _locked(path, flags):
    """The file at `path`, for reading and writing, ours alone for as long as it is open. StoreError if it is another's."""
    file = os.fdopen(os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0) | flags, 0o666), "r+b")
    try:
        if flock is not None:
            flock(file, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        file.close()
        raise StoreError(f"{path}: another process is running from this checkpoint; wait for it, or stop it") from None
    except OSError:  # a file system without locks
        pass
    return file


def _sample(record) -> Sample:
    fields = [record[name].copy() if name in record.dtype.names else None for name in VALUES]
    airborne = int(record["airborne"])
    return Sample(float(record["time"]), *fields, int(record["updates"]), None if airborne < 0 else airborne)


def opened(path) -> xr.Dataset:
    """The file at `path` whose variables stay on disk until they are asked for."""
    return xr.open_dataset(path, engine="netcdf4", decode_times=False, cache=False)
