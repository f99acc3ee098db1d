"""What localization returns: where the robot was at each row, and how sure the filter is."""

from __future__ import annotations

import importlib.metadata
import json
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.checks import file_name
from pmcl.errors import PosteriorError
from pmcl.filtering.tracker import Beliefs
from pmcl.hdf5 import stored_arrays
from pmcl.localization.metrics import coverage, nees, pose_errors, rmse
from pmcl.localization.setup import Prepared
from pmcl.localization.tum import write_tum
from pmcl.whole_file import replacing

__all__ = ["Track"]

Float = NDArray[np.float64]

FORMAT = "pmcl-track/1"
_POSE = ["x", "y", "heading"]


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """A localized log.

    Attributes
    ----------
    dataset : xarray.Dataset
        ``pose_mean`` (time, pose) [m, m, rad], ``pose_cov`` (time, pose, pose2), ``log_score`` (time) [nat], ``ess``
        and ``particles`` (time); when the log has a reference, ``position_error`` [m] and ``heading_error`` [rad]
        (time), and the attributes ``position_rmse`` [m], ``heading_rmse`` [rad] and ``coverage_95``.
    """

    dataset: xr.Dataset

    def __repr__(self) -> str:
        return f"<Track of {self.dataset.sizes['time']} poses, method {self.dataset.attrs.get('method', '?')}>"

    @property
    def times(self) -> Float:
        """Sample times [s], shape (T,)."""
        return np.asarray(self.dataset["time"].values)

    @property
    def pose_mean(self) -> Float:
        """Mean pose given everything read up to its time [m, m, rad], shape (T, 3); headings by the circular mean."""
        return np.asarray(self.dataset["pose_mean"].values)

    @property
    def pose_cov(self) -> Float:
        """Covariance about the mean, shape (T, 3, 3)."""
        return np.asarray(self.dataset["pose_cov"].values)

    @property
    def log_score(self) -> Float:
        """Log density of each row's readings given everything before [nat], shape (T,); 0 where nothing was read."""
        return np.asarray(self.dataset["log_score"].values)

    @property
    def ess(self) -> Float:
        """Effective sample size, shape (T,)."""
        return np.asarray(self.dataset["ess"].values)

    @property
    def position_rmse(self) -> float | None:
        """Root mean square distance to the reference [m]; None without a reference."""
        return self._score("position_rmse")

    @property
    def heading_rmse(self) -> float | None:
        """Root mean square heading error [rad]; None without a reference."""
        return self._score("heading_rmse")

    @property
    def coverage_95(self) -> float | None:
        """Share of rows whose true position lies in the 95 % ellipse; None without a reference."""
        return self._score("coverage_95")

    def _score(self, name: str) -> float | None:
        return float(self.dataset.attrs[name]) if name in self.dataset.attrs else None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a NetCDF file, all or nothing; raises PosteriorError when it cannot."""
        encoding = {str(name): {"_FillValue": None} for name in self.dataset.variables if name != "pose"}
        encoding = {name: value for name, value in encoding.items() if self.dataset[name].dtype.kind == "f"}
        with replacing(path, n_bytes=self.dataset.nbytes) as temporary:
            self.dataset.to_netcdf(temporary, engine="h5netcdf", encoding=encoding)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Track:
        """Read a file that :meth:`write` made.

        Raises
        ------
        PosteriorError
            When it is missing, damaged, no track, or points to other files (:mod:`pmcl.hdf5`).
        """
        where = os.fspath(path)
        try:
            stored_arrays(path)
            with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
                loaded = dataset.load()
        except Exception as error:  # HDF5 answers a damaged file with nearly any exception
            reason = " ".join(str(error).split())[:120]
            raise PosteriorError(
                f"{where}: expected a track that 'pmcl localize' wrote, got a file that cannot be read ({reason}): "
                "check the path, or localize again"
            ) from None
        if "pose_mean" not in loaded:
            raise PosteriorError(f"{where}: expected a track, got variables {sorted(map(str, loaded.data_vars))}")
        return cls(loaded)

    def write_tum(self, path: str | os.PathLike[str]) -> None:
        """Write the mean poses as TUM text, see :func:`pmcl.localization.tum.write_tum`."""
        write_tum(path, self.times, self.pose_mean)


def make_track(prepared: Prepared, beliefs: Beliefs, settings: dict[str, Any]) -> Track:
    """Label what a filter returned, and compare it with the reference if the log has one.

    States of a model that are no poses keep their own number of components; of those that are more than a pose, the
    pose is kept.

    Parameters
    ----------
    prepared : Prepared
        The filter and its log.
    beliefs : Beliefs
        What it returned for the T rows of the log.
    settings : dict
        Attributes of the track: how it was made.

    Returns
    -------
    Track
    """
    log = prepared.log
    size = min(beliefs.mean.shape[1], 3)
    mean, covariance = beliefs.mean[:, :size], beliefs.covariance[:, :size, :size]
    names = _POSE if size == 3 else [str(d) for d in range(size)]
    dataset = xr.Dataset(
        {
            "pose_mean": (("time", "pose"), mean, {"units": "m, m, rad", "long_name": "mean pose"}),
            "pose_cov": (("time", "pose", "pose2"), covariance, {"long_name": "covariance of the pose"}),
            "log_score": ("time", beliefs.log_score, {"units": "nat", "long_name": "log predictive density"}),
            "ess": ("time", beliefs.effective_size, {"long_name": "effective sample size"}),
            "particles": ("time", beliefs.particles, {"long_name": "number of particles"}),
        },
        coords={"time": ("time", log.times, {"units": "s"}), "pose": names, "pose2": names},
        attrs={
            "format": FORMAT,
            "pmcl_version": importlib.metadata.version("pmcl"),
            "robot": log.robot,
            "source": file_name(log.where),
            "log_fingerprint": log.fingerprint(),
            **settings,
            **_theta_attribute(prepared),
        },
    )
    if log.true_poses is None or size < 3:
        return Track(dataset)
    errors = pose_errors(mean, log.true_poses)
    dataset["position_error"] = ("time", errors.position, {"units": "m"})
    dataset["heading_error"] = ("time", errors.heading, {"units": "rad"})
    dataset.attrs |= {
        "position_rmse": float(rmse(errors.position)),
        "heading_rmse": float(rmse(errors.heading)),
        "coverage_95": coverage(nees(mean, covariance, log.true_poses)),
    }
    return Track(dataset)


def _theta_attribute(prepared: Prepared) -> dict[str, Any]:
    if len(prepared.theta) > 1:
        return {"draws": len(prepared.theta), "draws_per_reading": prepared.tracker.options.picks}
    values = dict(zip(prepared.bound.names, prepared.theta[0].tolist(), strict=True))
    return {"theta": json.dumps(values)}
