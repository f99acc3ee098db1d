"""The checkpoint file: which run it belongs to, and where its stages are."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel

__all__ = ["check_fingerprint", "fingerprint", "stored_steps"]


def fingerprint(bound: BoundModel, settings: Mapping[str, Any]) -> str:
    """Return a hash of logs, model, priors and settings: a run may be resumed only by the same run."""
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
    for tables in bound.tables(bound.prior_mean()):
        for table in (tables.start, tables.motion, *tables.sensors):
            _digest_table(digest, table)
    digest.update(json.dumps(dict(settings), sort_keys=True, default=str).encode())
    return digest.hexdigest()


def _digest_table(digest: Any, table: Any) -> None:
    for name, value in zip(type(table)._fields, table, strict=True):
        if isinstance(value, tuple):
            _digest_table(digest, value)
        else:
            digest.update(name.encode() + np.asarray(value).tobytes())


def check_fingerprint(path: str, expected: str, *, resume: bool) -> None:
    """Prepare a checkpoint file for a run.

    Parameters
    ----------
    path : str
        The HDF5 file.
    expected : str
        Fingerprint of the run.
    resume : bool
        Whether an existing file is continued; otherwise it is an error, so that no finished chain is destroyed.

    Raises
    ------
    SamplingError
        When the file belongs to another run, is no checkpoint, or exists though nothing is to be resumed.
    """
    if os.path.exists(path):
        if not resume:
            raise SamplingError(
                f"{path}: expected no checkpoint, but there is one; resume it, or remove it to start anew"
            )
        try:
            with h5py.File(path, "r") as file:
                found = str(file.attrs.get("pmcl_fingerprint", ""))
        except OSError as error:
            raise SamplingError(
                f"{path}: expected an HDF5 checkpoint, but it cannot be read ({error}); remove it to start anew"
            ) from None
        if found != expected:
            raise SamplingError(
                f"{path}: the checkpoint belongs to another run (log, model, priors or settings differ); "
                "resume with the settings it was begun with, or remove it to start anew"
            )
        return
    try:
        with h5py.File(path, "w") as file:
            file.attrs["pmcl_fingerprint"] = expected
    except OSError as error:
        raise SamplingError(f"{path}: the checkpoint cannot be written ({error}); choose another folder") from None


def stored_steps(path: str, name: str) -> int:
    """Return how many steps of stage `name` a checkpoint file holds; 0 when it has none."""
    with h5py.File(path, "r") as file:
        return int(file[name].attrs["iteration"]) if name in file else 0
