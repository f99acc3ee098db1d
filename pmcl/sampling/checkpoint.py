"""The checkpoint file: which run it belongs to, and all that resuming the run needs.

The file is HDF5 with one group for each stage, after a head that tells whose it is and whether it is whole, see
:mod:`pmcl.sampling.checkpoint_head`. Chains, log densities and blobs lie where emcee's own ``HDFBackend`` looks for
them, trajectories beside them. Each time the whole file is written anew under another name, which then takes the place
of the old one: whatever happens in between, there is always one complete file.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import emcee
import h5py
import numpy as np

from pmcl.engine.file_lock import FileLock
from pmcl.errors import SamplingError
from pmcl.hdf5 import UnsafeFileError, stored_arrays
from pmcl.models.effects.formula import Formula
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.backends import StageBackend
from pmcl.sampling.checkpoint_head import LAYOUT, N_BYTES, read_head, seal
from pmcl.whole_file import remove_rests, write_whole

__all__ = ["Checkpoint", "fingerprint", "the_only_run"]

_logger = logging.getLogger("pmcl.sampling")

# Seconds between two writes: at least so many, and so many times as long as the last write took. So a run that is
# killed loses a few seconds, and writing takes at most a twentieth of the time.
_LEAST_PAUSE, _PAUSE_PER_WRITE = 5.0, 20.0
# Quantiles of the priors at which the tables of a run are compared with those of the run that is to be resumed.
_QUANTILES = (0.3, 0.8)
_ARRAYS = ("chain", "log_prob", "blobs")


def fingerprint(bound: BoundModel, settings: Mapping[str, Any]) -> str:
    """Return a hash of logs, model, priors, settings and pmcl's version: a run may be resumed only by the same run.

    Parameters
    ----------
    bound : BoundModel
        The model, bound to its logs.
    settings : mapping of str to object
        All settings of the method and of the run that change its result.

    Returns
    -------
    str
        SHA-256 in hexadecimal.
    """
    digest = hashlib.sha256()
    for log in bound.logs:
        digest.update(log.fingerprint().encode())
    for parameter in bound.parameters:
        prior = parameter.prior
        described = (parameter.name, getattr(getattr(prior, "dist", None), "name", repr(prior)))
        shapes = (getattr(prior, "args", ()), sorted(getattr(prior, "kwds", {}).items()))
        digest.update(repr((described, shapes)).encode())
    for part in bound.model.parts:
        digest.update(f"{type(part).__module__}.{type(part).__qualname__}".encode())
    for effect in bound.model.effects:
        digest.update(f"{effect.name} {sorted((key, tuple(value)) for key, value in effect.where.items())}".encode())
        if isinstance(effect.change, Formula):
            digest.update(repr(effect.change).encode())
    # What the code of effects and parts does shows in their tables. At the prior mean many effects do nothing.
    # Formulas are told by their text above; here they stay at their nulls, since some depend on an estimated path.
    formulas = {
        parameter.name: null
        for effect in bound.effects
        if isinstance(effect.change, Formula)
        for parameter, null in zip(effect.parameters, effect.null, strict=True)
    }
    for quantile in _QUANTILES:
        theta = np.array(
            [formulas.get(parameter.name, float(parameter.prior.ppf(quantile))) for parameter in bound.parameters]
        )
        for tables in bound.tables(theta):
            for table in (tables.start, tables.motion, *tables.sensors):
                _digest_table(digest, table)
    digest.update(f"pmcl {version('pmcl')}".encode())
    digest.update(json.dumps(dict(settings), sort_keys=True, default=str).encode())
    return digest.hexdigest()


def _digest_table(digest: Any, table: Any) -> None:
    for name, value in zip(type(table)._fields, table, strict=True):
        if isinstance(value, tuple):
            _digest_table(digest, value)
        else:
            digest.update(name.encode() + np.asarray(value).tobytes())


@contextmanager
def the_only_run(path: str | None) -> Iterator[None]:
    """Let no other run use a checkpoint while this one does.

    Parameters
    ----------
    path : str, optional
        The checkpoint; nothing is locked without one. A file beside it holds the lock and tells whose it is. The
        operating system releases the lock of a process that dies.

    Raises
    ------
    SamplingError
        When another run has the lock.
    """
    if path is None:
        yield
        return
    file = Path(os.path.realpath(path))
    began = datetime.now().astimezone().isoformat(" ", "seconds")
    owner = f"process {os.getpid()} on {socket.gethostname()} since {began}"
    with FileLock(file.with_name(f".{file.name}.lock"), owner) as lock:
        if not lock.acquire():
            raise SamplingError(
                f"{path}: expected a checkpoint of its own, but another run is writing this one "
                f"({lock.owner() or 'it does not say which'}); let that run end, or choose another output or checkpoint"
            )
        yield


class Checkpoint:
    """The checkpoint file of one run, which must be the only one with this file, see :func:`the_only_run`.

    Parameters
    ----------
    path : str
        The HDF5 file.
    expected : str
        Fingerprint of the run.
    resume : bool
        Whether an existing file is continued; otherwise it is an error, so that no chain is destroyed.

    Raises
    ------
    SamplingError
        When the file belongs to another run, is damaged or no checkpoint, is in use, exists though nothing is to be
        resumed, or cannot be written.
    """

    def __init__(self, path: str, expected: str, *, resume: bool) -> None:
        self.path, self.expected = Path(path), expected
        self._stages: dict[str, StageBackend] = {}
        self._steps_written = 0
        self._due = time.monotonic() + _LEAST_PAUSE
        remove_rests(self.path)
        if not self.path.exists():
            if resume:
                _logger.info("there is no checkpoint %s yet: the run starts from the beginning", self.path)
            self._try_folder()
        elif not resume:
            raise SamplingError(
                f"{path}: expected no checkpoint, but there is one of a run that was interrupted or kept; "
                "resume it (--resume), or remove it to start anew"
            )
        else:
            self._check_run()

    def backend(self, name: str, steps: int, window: int, keep_every: int) -> StageBackend:
        """Return the backend of a stage, with the steps that the file holds of it.

        Parameters
        ----------
        name : str
            Name of the stage. Stages must be asked for in their order.
        steps, window, keep_every : int
            See :class:`~pmcl.sampling.backends.StageBackend`.

        Returns
        -------
        StageBackend

        Raises
        ------
        SamplingError
            When the file is damaged.
        """
        backend = StageBackend(steps, window, keep_every)
        if self.path.exists():
            try:
                with h5py.File(self.path, "r") as file:
                    if name in file:
                        _read_stage(file[name], backend)
            # HDF5 raises nearly anything on damaged files: KeyError and RuntimeError besides OSError and ValueError.
            except Exception as error:
                raise self._unreadable(error) from None
        # Only now: a stage that was read in part must not be written over the file when the run ends by this error.
        self._stages[name] = backend
        self._steps_written = self._steps()
        return backend

    def step_done(self) -> None:
        """Write the file when the last time is long enough ago.

        A file that cannot be written now, say because the disk is full, is no reason to lose the run: the
        checkpoint before is still there, a warning is logged, and the next attempt comes later.
        """
        if time.monotonic() >= self._due:
            self.write()

    def write(self) -> None:
        """Write what was done since the last time, if anything was; see :meth:`step_done` for errors."""
        if self._steps() == self._steps_written or not all(backend.whole for backend in self._stages.values()):
            return
        start = time.monotonic()
        try:
            # In memory first: HDF5 crashes, or leaves a file open, where the disk gets full.
            content = io.BytesIO()
            with h5py.File(content, "w", userblock_size=N_BYTES) as file:
                self._fill(file)
            seal(content.getbuffer(), self.expected)
            write_whole(self.path, content.getbuffer(), error=SamplingError)
            self._steps_written = self._steps()
        except SamplingError as error:
            _logger.warning("%s: the checkpoint could not be written (%s); the run goes on", self.path, error)
        finally:
            now = time.monotonic()
            self._due = now + max(_LEAST_PAUSE, _PAUSE_PER_WRITE * (now - start))

    @property
    def steps_written(self) -> int:
        """How many steps of all stages the file holds."""
        return self._steps_written

    def _steps(self) -> int:
        return sum(int(backend.iteration) for backend in self._stages.values())

    def _try_folder(self) -> None:
        """Find out now, not after hours, whether the file can be written."""
        temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        try:
            temporary.touch()
            temporary.unlink()
        except OSError as error:
            raise SamplingError(
                f"{self.path}: the checkpoint cannot be written ({error}); choose another folder"
            ) from None

    def _unreadable(self, error: Exception) -> SamplingError:
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, BlockingIOError) or "unable to lock file" in reason:
            return SamplingError(
                f"{self.path}: expected a checkpoint that can be read, but another program has it open; "
                "wait until it is done, or close it"
            )
        if isinstance(error, UnsafeFileError):
            return SamplingError(
                f"{self.path}: expected a checkpoint with its own data and no more, but got {reason[:200]}; "
                "remove it to start anew"
            )
        return SamplingError(
            f"{self.path}: expected an HDF5 checkpoint, but it cannot be read ({reason[:120]}); "
            "remove it to start anew"
        )

    def _check_run(self) -> None:
        """Refuse a file of another run, a damaged one, and one that is no checkpoint, before anything in it is used."""
        if self.path.is_file():
            self._check_head()
        try:
            stored_arrays(self.path)
        except Exception as error:
            raise self._unreadable(error) from None

    def _check_head(self) -> None:
        try:
            head = read_head(self.path)
        except OSError as error:
            raise self._unreadable(error) from None
        if head is None:
            raise SamplingError(
                f"{self.path}: expected a checkpoint of this version of pmcl, but its first line is another: an older "
                "version or another program wrote it, or it is damaged; remove it to start anew"
            )
        if head.layout != LAYOUT:
            raise SamplingError(
                f"{self.path}: expected a checkpoint of this version of pmcl, but another version wrote it (layout "
                f"{head.layout} instead of {LAYOUT}); resume with that version, or remove it to start anew"
            )
        if not head.whole:
            raise SamplingError(
                f"{self.path}: expected the bytes that were written, but the checkpoint is damaged (its SHA-256 is not "
                "the one in its head); remove it to start anew"
            )
        if head.run != self.expected:
            raise SamplingError(
                f"{self.path}: the checkpoint belongs to another run (log, model, priors, settings or pmcl's version "
                "differ); resume with the settings it was begun with, or remove it to start anew"
            )

    def _fill(self, file: Any) -> None:
        stages = [(name, backend) for name, backend in self._stages.items() if backend.iteration]
        for number, (name, backend) in enumerate(stages):
            group = file.create_group(name)
            _write_stage(group, backend)
            if number == len(stages) - 1:
                group["last_path"] = backend.last_path
            # The linearisation of the next stage is made from the trajectories of this one.
            if number >= len(stages) - 2:
                if backend.path_sum is not None:
                    group["path_sum"] = backend.path_sum
                if backend.first_path is not None:
                    group["first_path"] = backend.first_path
                    group["kept_offsets"] = np.array(backend.kept_offsets)


def _write_stage(group: Any, backend: StageBackend) -> None:
    steps = int(backend.iteration)
    # The attributes that emcee's HDFBackend has.
    group.attrs["version"] = emcee.__version__
    group.attrs["nwalkers"], group.attrs["ndim"] = backend.shape
    group.attrs["has_blobs"], group.attrs["iteration"] = True, steps
    for number, part in enumerate(backend.random_state):
        group.attrs[f"random_state_{number}"] = part
    group.attrs["window_start"] = backend.window_start
    group["accepted"] = backend.accepted
    for name in _ARRAYS:
        values = getattr(backend, name)[:steps]
        group.create_dataset(name, data=values, compression="gzip", compression_opts=1, shuffle=True)


def _read_stage(group: Any, backend: StageBackend) -> None:
    backend.reset(int(group.attrs["nwalkers"]), int(group.attrs["ndim"]))
    backend.iteration = int(group.attrs["iteration"])
    backend.window_start = int(group.attrs["window_start"])
    backend.random_state = tuple(group.attrs[f"random_state_{number}"] for number in range(5))
    backend.accepted = group["accepted"][...]
    for name in _ARRAYS:
        setattr(backend, name, _shaped(group, name, (backend.iteration, *backend.shape))[...])
    for name in ("last_path", "path_sum", "first_path"):
        if name in group:
            setattr(backend, name, group[name][...])
    if "kept_offsets" in group:
        backend.kept_offsets = list(group["kept_offsets"][...])
    n_kept = -(-backend.iteration // backend.keep_every) if backend.keep_every else 0
    if backend.complete and backend.window_start < backend.steps and not backend.kept_offsets:
        n_kept = 0  # a stage of burn-in after which the next has been tuned
    if len(backend.kept_offsets) != n_kept or (n_kept and backend.first_path is None):
        raise ValueError(f"'{group.name}' has not the {n_kept} trajectories that were kept")
    if not backend.complete and backend.last_path is None:
        raise ValueError(f"'{group.name}' has no last trajectories")


def _shaped(group: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Return an array of a stage that has a row for each step; the draws have a column for each parameter as well."""
    expected = shape if name == "chain" else shape[:2]
    if group[name].shape != expected:
        raise ValueError(f"'{group[name].name}' has shape {group[name].shape}, not {expected}")
    return group[name]
