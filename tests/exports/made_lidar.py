"""Posteriors of lidar calibrations made up for tests, with known draws."""

from __future__ import annotations

import numpy as np
import xarray as xr
from ruamel.yaml import YAML
from scipy import stats

from pmcl.posterior.compat import assemble

FIELD = {"alpha1": 0.05, "alpha2": 0.02, "alpha3": 0.1, "alpha4": 0.03, "sigma_hit": 0.04, "z_rand": 0.12}
BEAM = {**FIELD, "z_short": 0.2, "z_max": 0.05, "lambda_short": 0.7}
UNITS = {"sigma_hit": "m", "lambda_short": "1/m"}
MAX_RANGE = 25.0


def lidar_posterior(
    theta=None, *, model="likelihood-field", exponent=0.05, motion="differential", effects=(), fixed=None, unknown=(),
    beams=60, updates=True, spread=0.05, lasers=("",), logs=1, seed=0, resolution=None, **attributes,
):  # fmt: skip
    """A posterior whose draws scatter around `theta` by the share `spread`; those named in `unknown` are the prior."""
    theta = dict(FIELD if theta is None else theta)
    rng = np.random.default_rng(seed)
    posterior, prior = xr.Dataset(), xr.Dataset()
    for name, value in theta.items():
        belief = stats.gamma(2.0, scale=0.5 * value)
        draws = value * (1.0 + spread * rng.standard_normal((4, 500)))
        if name in unknown:
            draws = belief.rvs(size=(4, 500), random_state=rng)
        posterior[name] = (("chain", "draw"), draws, {"units": UNITS.get(name, "1")})
        prior[name] = (("chain", "draw"), belief.rvs(size=(1, 1000), random_state=rng))
    observed, constant = xr.Dataset(), xr.Dataset()
    for number in range(logs):
        ending = f"_{number}" if logs > 1 else ""
        if updates:
            observed.attrs |= {f"update_min_d{ending}": 0.25, f"update_min_a{ending}": 0.2}
            observed.attrs[f"update_rule{ending}"] = "nav2"
        for k, laser in enumerate(lasers):
            key = f"_{laser}{ending}" if laser else ending
            scan = {"min_range": 0.1, "max_range": MAX_RANGE, "pose": np.array([0.3, -0.1 * k, 0.2 * k])}
            observed[f"scan{key}"] = (f"scan{key}_reading", np.ones(3), scan)
            constant[f"scan_angle{key}"] = (f"ray{key}", np.linspace(-2.0, 2.0, beams))
        if resolution is not None:
            cells = {"map_resolution": resolution, "resolution": 4.0 * resolution}
            constant[f"grid_map{ending}"] = ((f"grid_row{ending}", f"grid_column{ending}"), np.zeros((2, 2)), cells)
        constant[f"odometry{ending}"] = ((f"time{ending}", "increment"), np.zeros((2, 3)))
    lines = [f'motion = "{motion}"', "[sensors.lidar]", f'model = "{model}"', f"exponent = {exponent}"]
    lines += ["[fixed]", *(f"{name} = {value}" for name, value in (fixed or {}).items())]
    for effect in effects:
        lines += ["[[effects]]", f'name = "{effect}"']
    lp = xr.Dataset({"lp": (("chain", "draw"), rng.normal(size=(4, 500)))})
    groups = {"posterior": posterior, "sample_stats": lp, "prior": prior, "observed_data": observed,
              "constant_data": constant}  # fmt: skip
    return assemble(groups, {"model": "\n".join(lines), **attributes})


def yaml_content(text):
    """Read a file as ROS does, whose parser follows YAML 1.1."""
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)
    return reader.load(text)
