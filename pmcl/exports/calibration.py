"""What a posterior says of a robot, collected for the programs that take its parameters."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_choice
from pmcl.errors import PosteriorError
from pmcl.posterior.access import parameter_names, parameter_units, theta_draws
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.estimates import map_estimate, posterior_mean
from pmcl.posterior.settings import settings

__all__ = ["ESTIMATES", "Calibration", "Laser", "calibration_of"]

Float = NDArray[np.float64]

ESTIMATES = ("mean", "map")
"""Which single value of theta is exported: the posterior mean, or the draw of the greatest joint density."""

# Attributes of a log by which AMCL chose its rows.
_UPDATES = ("update_min_d", "update_min_a", "update_rule")


class Laser(NamedTuple):
    """A laser of the calibrated log.

    Attributes
    ----------
    name : str
        Empty for the only one.
    beams : int
        Rays of a scan in the log.
    min_range, max_range : float
        Between which a reading is a distance [m].
    pose : tuple of float
        (x [m], y [m], yaw [rad]) on the robot, as the log describes it.
    """

    name: str
    beams: int
    min_range: float
    max_range: float
    pose: tuple[float, float, float]


@dataclass(frozen=True)
class Calibration:
    """A posterior as plain numbers.

    Attributes
    ----------
    method : {"mean", "map"}
        Which estimate `theta` is.
    theta : dict of str to float
        The estimate, and the values of parameters that the model fixes.
    draws, prior : dict of str to ndarray
        Draws of the posterior, shape (S,), and of the prior, of the parameters that are not fixed.
    units : dict of str to str
        SI units.
    model : dict
        The model file's content; empty for a model that no file can hold.
    updates : dict of str to object
        ``update_min_d`` [m], ``update_min_a`` [rad] and ``update_rule`` of the logs, where these agree.
    lasers : tuple of Laser
        Those of the first log.
    resolution : float
        Side of a cell of the first log's grid map [m]; 0 without one.
    remarks : tuple of str
        What a user must know before these numbers drive a robot.
    """

    method: str
    theta: dict[str, float]
    draws: dict[str, Float]
    prior: dict[str, Float]
    units: dict[str, str]
    model: dict[str, Any]
    updates: dict[str, Any]
    lasers: tuple[Laser, ...]
    resolution: float
    remarks: tuple[str, ...]

    @property
    def motion(self) -> str:
        """Name of the motion model in model files; empty when it is unknown."""
        return str(self.model.get("motion", ""))

    @property
    def lidar(self) -> dict[str, Any] | None:
        """Settings of the lidar's model; None when the model has no lidar."""
        found = self.model.get("sensors", {}).get("lidar")
        return dict(found) if isinstance(found, Mapping) else None

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model, in its order."""
        return tuple(str(effect.get("name", "")) for effect in self.model.get("effects", []))

    def derived(self, function: Callable[..., Any], *names: str) -> Any:
        """Apply a function of some parameters to their draws.

        Parameters
        ----------
        function : callable
            Takes one array or number for each of `names`.
        names : str
            Parameters; the fixed ones are handed over as numbers.

        Returns
        -------
        object
            What `function` returns.
        """
        return function(*(self.draws.get(name, self.theta[name]) for name in names))


def calibration_of(data: Posterior, method: str = "mean") -> Calibration:
    """Collect what a posterior says.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
        What :func:`pmcl.calibrate` returned, or was read from a file.
    method : {"mean", "map"}
        The estimate.

    Returns
    -------
    Calibration

    Raises
    ------
    PosteriorError
        When the posterior has no draws, or the method is unknown or not possible with it.
    """
    check_choice("estimate", method, ESTIMATES, error=PosteriorError)
    names = parameter_names(data)
    flat = theta_draws(data).reshape(-1, len(names))
    prior = find_group(data, "prior")
    model = _model(data)
    fixed = {name: float(value) for name, value in model.get("fixed", {}).items()}
    estimate = posterior_mean(data) if method == "mean" else map_estimate(data)
    return Calibration(
        method=method,
        theta={**fixed, **estimate},
        draws={name: flat[:, k] for k, name in enumerate(names)},
        prior={name: np.asarray(prior[name].values, dtype=np.float64).ravel() for name in names if name in prior},
        units=dict(zip(names, parameter_units(data), strict=True)),
        model=model,
        updates=_updates(data),
        lasers=_lasers(data),
        resolution=_resolution(data),
        remarks=_remarks(data),
    )


def _model(data: Posterior) -> dict[str, Any]:
    text = settings(data).get("model")
    try:
        return tomllib.loads(text) if isinstance(text, str) else {}
    except tomllib.TOMLDecodeError as error:
        raise PosteriorError(
            f"expected a model file in the posterior's attribute 'model', got text that is not TOML ({error}): "
            "calibrate again"
        ) from None


def _updates(data: Posterior) -> dict[str, Any]:
    given = find_group(data, "observed_data").attrs
    found: dict[str, Any] = {}
    for name in _UPDATES:
        values = {str(value): value for key, value in given.items() if key == name or _numbered(key, name)}
        if len(values) == 1:
            found[name] = next(iter(values.values()))
    return found


def _numbered(key: object, name: str) -> bool:
    """Return whether a key is that of one of several logs, such as ``update_min_d_1``."""
    return str(key).startswith(f"{name}_") and str(key).removeprefix(f"{name}_").isdecimal()


def _resolution(data: Posterior) -> float:
    constant = find_group(data, "constant_data")
    grids = [constant[key] for key in ("grid_map", "grid_map_0") if key in constant]
    return float(grids[0].attrs.get("map_resolution", 0.0)) if grids else 0.0


def _lasers(data: Posterior) -> tuple[Laser, ...]:
    observed, constant = find_group(data, "observed_data"), find_group(data, "constant_data")
    several = "odometry" not in constant
    lasers = []
    for key, angles in constant.data_vars.items():
        rest = str(key).removeprefix("scan_angle")
        if rest == str(key) or (several and not rest.endswith("_0")):
            continue
        attrs = observed[f"scan{rest}"].attrs if f"scan{rest}" in observed else {}
        pose = np.asarray(attrs.get("pose", (0.0, 0.0, 0.0)), dtype=np.float64)
        x, y, yaw = (float(value) for value in pose)
        low, high = float(attrs.get("min_range", 0.0)), float(attrs.get("max_range", np.nan))
        name = (rest.removesuffix("_0") if several else rest).removeprefix("_")
        lasers.append(Laser(name, angles.size, low, high, (x, y, yaw)))
    return tuple(lasers)


def _remarks(data: Posterior) -> tuple[str, ...]:
    known = settings(data)
    remarks = []
    if known.get("converged") == 0:
        remarks.append("the chains have not converged: these numbers are provisional")
    if known.get("adequate") == 0:
        remarks.append("readings and model disagree ('pmcl report' says how): these numbers may mislead")
    return tuple(remarks)
