"""NumPyro's NUTS on theta and the path: the density in JAX, and chains with it.

The density is written anew, for models of landmarks whose motion has constant noise. NUTS moves in u, the unconstrained
parameters, and in z, the standardised path: x = m + L z with the mean m and the factor L of the path of the linearised
model at a theta near the mode, which never change. So z is nearly standard normal, and the determinant is constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.kernels.linear import factorise
from pmcl.interrupts import check_interrupt, stopping_on_interrupt
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.parameters import FAMILIES, prior_table
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.starts.table import GaussianStart, PoseStart
from pmcl.sampling.chains import Chains
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.options import RunOptions, SettingValue
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.transforms import Unconstrained

__all__ = ["log_density", "require_smooth", "run_no_u_turn"]

Float = NDArray[np.float64]

# Chains start this much wider than the posterior is thought to be, so that R-hat can see chains that have not met.
_START_WIDTH = 1.5
# A run that a stopwatch ends stores no more draws than this, for which memory is kept.
_MOST_DRAWS = 100_000
_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


def require_smooth(bound: BoundModel) -> None:
    """Refuse a model whose density is not written here, or that NumPyro is not installed for.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.

    Raises
    ------
    ModelError
        When it is no plain model of landmarks with a Gaussian start.
    SamplingError
        When NumPyro is not installed.
    """
    model, advice = bound.model, "use method particle-gibbs"
    if not model.sensors or any(type(sensor) is not LandmarkNoise for sensor in model.sensors):
        others = ", ".join(type(part).__name__ for part in model.sensors if type(part) is not LandmarkNoise) or "none"
        raise ModelError(
            f"expected smooth sensors for method nuts, that is landmarks alone, but got {others}; {advice}"
        )
    if type(model.motion) is not IncrementNoise:
        raise ModelError(
            f"expected motion with constant noise for method nuts, but got {type(model.motion).__name__}; {advice}"
        )
    if model.effects:
        names = ", ".join(effect.name for effect in model.effects)
        raise ModelError(f"expected a model without effects for method nuts, but got {names}; {advice}")
    table = prior_table(bound.parameters)
    if table is None or not set(table.family.tolist()) <= {FAMILIES[name] for name in _PRIORS}:
        raise ModelError(f"expected priors out of {', '.join(_PRIORS)} for method nuts; choose such, or {advice}")
    for log, tables in zip(bound.logs, bound.tables(bound.prior_mean()), strict=True):
        start = tables.start
        if not (isinstance(start, PoseStart | GaussianStart) and np.isfinite(start.std).all()):
            raise ModelError(f"{log.where}: expected a start that is known roughly for method nuts; {advice}")
    _numpyro()


def _numpyro() -> Any:
    try:
        import numpyro.infer
    except ModuleNotFoundError as error:
        raise SamplingError(
            f"expected the library numpyro for method nuts, but {error.name} is not installed; pip install 'pmcl[nuts]'"
        ) from None
    return numpyro.infer


# Log densities of standardised values, up to their constants.
_PRIORS: dict[str, Callable[[Any, float, float, Any], Any]] = {
    "norm": lambda y, a, b, jnp: -0.5 * y**2,
    "halfnorm": lambda y, a, b, jnp: -0.5 * y**2,
    "gamma": lambda y, a, b, jnp: (a - 1.0) * jnp.log(y) - y,
    "lognorm": lambda y, a, b, jnp: -jnp.log(y) - 0.5 * (jnp.log(y) / a) ** 2,
    "uniform": lambda y, a, b, jnp: 0.0,
    "beta": lambda y, a, b, jnp: (a - 1.0) * jnp.log(y) + (b - 1.0) * jnp.log1p(-y),
    "expon": lambda y, a, b, jnp: -y,
    "invgamma": lambda y, a, b, jnp: -(a + 1.0) * jnp.log(y) - 1.0 / y,
}


class _LogArrays(NamedTuple):
    """What the density takes from one log.

    Attributes
    ----------
    start_mean, start_std : ndarray, shape (3,)
        Belief about the first pose.
    odometry : ndarray, shape (T, 3)
        Increments.
    sightings : tuple of LandmarkSightings
        One for each sensor.
    """

    start_mean: Float
    start_std: Float
    odometry: Float
    sightings: tuple[Any, ...]


def _arrays(bound: BoundModel) -> list[_LogArrays]:
    return [
        _LogArrays(np.array(start.mean), np.array(start.std), np.array(log.odometry), tables.sensors)
        for log, tables in zip(bound.logs, bound.tables(bound.prior_mean()), strict=True)
        if isinstance(start := tables.start, PoseStart | GaussianStart)
    ]


def log_density(bound: BoundModel) -> Callable[[Any, Any], Any]:
    """Return log p(theta, paths, readings) as a function that JAX can differentiate.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs; :func:`require_smooth` must hold.

    Returns
    -------
    callable
        (theta (d,), list of paths (T_l, 3)) to the log density [nat].
    """
    import jax.numpy as jnp

    priors, logs = prior_table(bound.parameters), _arrays(bound)
    assert priors is not None
    families = {code: _PRIORS[name] for name, code in FAMILIES.items() if name in _PRIORS}
    fixed = {name: float(value) for name, value in bound.model.fixed.items()}
    position = {name: k for k, name in enumerate(bound.names)}

    def value_of(theta: Any, name: str) -> Any:
        return theta[position[name]] if name in position else fixed[name]

    def gaussian(residual: Any, std: Any) -> Any:
        return -0.5 * (residual / std) ** 2 - jnp.log(std) - _HALF_LOG_2PI

    def of_sightings(theta: Any, path: Any, seen: Any) -> Any:
        pose, where = path[seen.time], seen.position[seen.landmark]
        c, s = jnp.cos(pose[:, 2]), jnp.sin(pose[:, 2])
        dx, dy = where[:, 0] - pose[:, 0], where[:, 1] - pose[:, 1]
        ahead, aside = c * dx + s * dy - seen.sensor_pose[0], c * dy - s * dx - seen.sensor_pose[1]
        distance = jnp.sqrt(ahead**2 + aside**2)
        log_inlier, log_gross = jnp.zeros(seen.time.size), np.zeros(seen.time.size)
        if np.isfinite(seen.range).any():
            has = ~np.isnan(seen.range)
            term = gaussian(np.where(has, seen.range, 0.0) - distance, value_of(theta, "sigma_landmark_range"))
            log_inlier, log_gross = log_inlier + jnp.where(has, term, 0.0), log_gross - has * math.log(seen.max_range)
        if np.isfinite(seen.bearing).any():
            has = ~np.isnan(seen.bearing)
            turn = np.where(has, seen.bearing, 0.0) + seen.sensor_pose[2] - jnp.arctan2(aside, ahead)
            term = gaussian(jnp.arctan2(jnp.sin(turn), jnp.cos(turn)), value_of(theta, "sigma_bearing"))
            log_inlier, log_gross = log_inlier + jnp.where(has, term, 0.0), log_gross - has * math.log(2.0 * math.pi)
        if np.isfinite(seen.size).any():
            has = ~np.isnan(seen.size)
            ideal = seen.size_constant[seen.landmark] / distance**2
            ratio = np.where(has, seen.size, 1.0) / ideal
            term = gaussian(ratio - 1.0, value_of(theta, "sigma_size")) - jnp.log(ideal)
            log_inlier = log_inlier + jnp.where(has, term, 0.0)
            log_gross = log_gross - has * np.log(seen.size_constant[seen.landmark])
        if "landmark_outlier_weight" in position or "landmark_outlier_weight" in fixed:
            weight = value_of(theta, "landmark_outlier_weight")
            log_inlier = jnp.logaddexp(jnp.log1p(-weight) + log_inlier, jnp.log(weight) + log_gross)
        return log_inlier.sum()

    def density(theta: Any, paths: Any) -> Any:
        value = jnp.sum(priors.constant)
        for k, code in enumerate(priors.family.tolist()):
            standard = (theta[k] - priors.loc[k]) / priors.scale[k]
            value += families[code](standard, float(priors.shape_a[k]), float(priors.shape_b[k]), jnp)
        noise = jnp.stack([value_of(theta, name) * jnp.ones(()) for name in _MOTION])
        for log, path in zip(logs, paths, strict=True):
            step, heading = path[1:] - path[:-1], path[:-1, 2]
            c, s = jnp.cos(heading), jnp.sin(heading)
            moved = jnp.stack([c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0], step[:, 2]], axis=1)
            value += gaussian(path[0] - log.start_mean, log.start_std).sum()
            value += gaussian(moved - log.odometry[1:], noise).sum()
            for seen in log.sightings:
                value += of_sightings(theta, path, seen)
        return value

    return density


_MOTION = ("sigma_forward", "sigma_left", "sigma_turn")


def _potential(bound: BoundModel, near: NearMode) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return minus the log density of a dict of u and one z for each log, and the function to theta and paths."""
    import jax
    import jax.numpy as jnp

    transform, density = Unconstrained(bound.parameters), log_density(bound)
    centre = transform.from_line(near.centre)[0]
    maps = []
    for tables, reference in zip(bound.tables(centre), near.references, strict=True):
        readings = tuple(sensor_of(table).linearise(table, reference) for table in tables.sensors)
        log_determinant, factor, gain, mean = factorise(tables, readings, reference)
        if not math.isfinite(log_determinant):
            raise SamplingError("the linearised path has no factorisation; use method particle-gibbs")
        size = reference.shape[1]
        lower = np.tril(factor.reshape(-1, size, size))
        root = np.transpose(np.linalg.inv(lower), (0, 2, 1))
        maps.append((reference, root, gain.reshape(-1, size, size), mean))
    half, interval = transform.kind == 1, transform.kind == 2
    low = np.where(np.isfinite(transform.low), transform.low, 0.0)
    width = np.where(interval, transform.high - transform.low, 1.0)

    def realised(place: Any) -> Any:
        u = place["u"]
        theta = jnp.where(half, low + jnp.exp(u), jnp.where(interval, low + width * jax.nn.sigmoid(u), u))
        paths = []
        for number, (reference, root, gain, mean) in enumerate(maps):
            own = mean + jnp.einsum("tij,tj->ti", root, place[f"z{number}"])

            def step(later: Any, row: Any) -> Any:
                deviation = row[0] + row[1] @ later
                return deviation, deviation

            _, deviation = jax.lax.scan(step, jnp.zeros(reference.shape[1]), (own, jnp.asarray(gain)), reverse=True)
            paths.append(reference + deviation)
        return theta, paths

    def potential(place: Any) -> Any:
        u = place["u"]
        size = jnp.abs(u)
        of_interval = jnp.log(width) - size - 2.0 * jnp.log1p(jnp.exp(-size))
        jacobian = jnp.where(half, u, jnp.where(interval, of_interval, 0.0))
        return -density(*realised(place)) - jacobian.sum()

    return potential, realised


def run_no_u_turn(
    bound: BoundModel,
    near: NearMode,
    warm_up: int,
    target: float,
    options: RunOptions,
    settings: Mapping[str, SettingValue],
) -> Chains:
    """Run chains of NUTS, one after the other at each draw.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs; :func:`require_smooth` must hold.
    near : NearMode
        Where the chains start, and the path around which the standardisation is made.
    warm_up : int
        Draws in which step size and mass matrix are adapted.
    target : float
        Mean acceptance probability.
    options : RunOptions
        How the run is carried out.
    settings : mapping of str to scalar
        Settings of the result.

    Returns
    -------
    Chains
        With the leapfrog steps of each draw, and whether it diverged, as statistics.

    Raises
    ------
    SamplingError
        When the time is over before the first draw.
    """
    import jax

    infer, stopwatch = _numpyro(), options.stopwatch or Stopwatch()
    rng = np.random.default_rng((options.seed, 79))
    spread = np.linalg.cholesky(near.covariance)
    # JAX computes in single precision unless told otherwise; the setting holds for this run alone.
    with jax.enable_x64(True), stopping_on_interrupt():
        potential, realised = _potential(bound, near)
        kernel = infer.NUTS(
            potential_fn=potential, target_accept_prob=target, dense_mass=[("u",)], max_tree_depth=10
        )
        states = []
        for key in jax.random.split(jax.random.PRNGKey(options.seed % 2**32), options.chains):
            first = {"u": near.centre + _START_WIDTH * spread @ rng.standard_normal(near.centre.size)}
            for number, length in enumerate(bound.lengths):
                first[f"z{number}"] = 0.1 * rng.standard_normal((length, 3))
            states.append(kernel.init(key, warm_up, first, model_args=(), model_kwargs={}))
        advance: Any = jax.jit(lambda state: kernel.sample(state, (), {}))
        recorded: Any = jax.jit(realised)
        draws = min(options.draws, _MOST_DRAWS) if options.limited else options.draws
        collected = _Collected(bound, options.chains)
        for number in range(warm_up + draws):
            check_interrupt()
            if stopwatch.now() >= stopwatch.limit:
                break
            states = [advance(state) for state in states]
            wait: Any = jax.block_until_ready
            wait(states)
            if number >= warm_up:
                keep = (number - warm_up) % options.keep_every == 0
                collected.add([(state, recorded(state.z)) for state in states], keep)
            stopwatch.step()
    return collected.chains({**settings, **options.attributes})


class _Collected:
    """Draws of all chains as they come."""

    def __init__(self, bound: BoundModel, chains: int) -> None:
        self.bound, self.n_chains, self.transform = bound, chains, Unconstrained(bound.parameters)
        self.theta: list[Float] = []
        self.numbers: list[Float] = []
        self.paths: list[list[list[Float]]] = []
        self.kept: list[int] = []

    def add(self, drawn: list[tuple[Any, Any]], keep: bool) -> None:
        """Store one draw of each chain, and its paths where `keep` says so."""
        if keep:
            self.kept.append(len(self.theta))
            self.paths.append([[np.array(path) for path in paths] for _, (_, paths) in drawn])
        self.theta.append(np.array([np.array(theta) for _, (theta, _) in drawn]))
        rows = []
        for state, _ in drawn:
            jacobian = self.transform.from_line(np.array(state.z["u"]))[1]
            rows.append((-float(state.potential_energy) - jacobian, float(state.num_steps), float(state.diverging)))
        self.numbers.append(np.array(rows))

    def chains(self, settings: Mapping[str, SettingValue]) -> Chains:
        """Return what was stored."""
        if not self.theta:
            raise SamplingError("the time was over before the first draw; give more time, or a shorter log")
        numbers = np.moveaxis(np.array(self.numbers), 0, 1)
        trajectories = tuple(
            np.moveaxis(np.array([[paths[number] for paths in draw] for draw in self.paths]), 0, 1)
            for number in range(len(self.bound.logs))
        )
        return Chains(
            names=self.bound.names,
            units=tuple(parameter.unit for parameter in self.bound.parameters),
            theta=np.moveaxis(np.array(self.theta), 0, 1),
            log_joint=numbers[..., 0],
            statistics={"leapfrog_steps": numbers[..., 1], "diverging": numbers[..., 2]},
            trajectories=trajectories,
            trajectory_draw=np.array(self.kept, dtype=np.int64),
            settings={**settings, "draws": len(self.theta)},
        )
