"""Which parameters a log can tell, and how well, before it is calibrated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_flag, check_seed, check_type
from pmcl.criticism.fitting.quick_fit import LONG, quick_fit
from pmcl.errors import DensityError, FilterError, LogError, ModelError, PmclError
from pmcl.filtering.estimated_path import START_PARTICLES, plausible_theta, with_estimated_path
from pmcl.filtering.linearised_evidence import LinearisedEvidence, improved
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.identifiability.information import information_per_row
from pmcl.identifiability.result import CANNOT_TELL, Advice, Identification, Prediction
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import BoundModel, RobotModel, default_model
from pmcl.posterior.compat import bulk_ess
from pmcl.preflight.check import require_rows
from pmcl.sampling.approximate import WeightedDraws, equal_draws, log_posterior, mode_of, weighted_draws
from pmcl.sampling.transforms import Unconstrained
from pmcl.simulations.drives import Drive, drives_for, moves_sideways
from pmcl.streams import stream_seed

__all__ = ["identify"]

Float = NDArray[np.float64]

# Rounds of (path under theta, linearise there, theta that is most probable then). The first few find the path by a
# particle filter; the others go on until unconstrained parameters move by less than this.
_FILTERED_ROUNDS, _MOST_ROUNDS, _SETTLED = 3, 12, 0.05
# Paths drawn backward, whose mean is the reference.
_PATHS = 40
# Durations that an advice may have [min], and that of the table of drives [s].
_MINUTES = (1.0, 2.0, 5.0, 10.0)
_TABLE_SECONDS = 60.0
# Rows of a prior's quantiles, from which its spread in unconstrained parameters is computed.
_QUANTILES = 400
# Length of the chain for models with gross errors. It is continued, so many times at most, until each parameter has so
# many effective draws: standard deviations are then known to about a tenth.
_EFFORT, _CONTINUED, _ENOUGH_DRAWS = LONG, 4, 100.0
# Correlations above this are told.
_STRONG = 0.7
# Fewer effective draws than these are told: standard deviations are then uncertain by a tenth or more.
_FEW_DRAWS = 50.0


def identify(log: RobotLog, model: RobotModel | None = None, *, drives: bool = True, seed: int = 0) -> Identification:
    """Predict how well a calibration will know each parameter, and what to drive to learn the others.

    Parameters
    ----------
    log : RobotLog
        The log. Its reference trajectory and true parameters are never read.
    model : RobotModel, optional
        The default model of the log when left out (:func:`pmcl.models.robot_model.default_model`).
    drives : bool
        Whether to try drives that might tell more.
    seed : int
        All randomness follows from it.

    Returns
    -------
    Identification
        Cost: a few particle filters of 1000 particles and some thousand passes of a Kalman smoother; about a second
        for 400 rows. With sensors whose readings may be gross errors, such as lidars, a short chain.

    Raises
    ------
    LogError, ModelError, MapError
        When log and model do not fit each other.
    FilterError
        When the filter loses the robot whatever the noise.

    Notes
    -----
    The path is integrated out in the model that is linearised around the smoothed path
    (:mod:`pmcl.filtering.linearised_evidence`); the posterior of theta follows by importance sampling. Predictions are
    as good as that Gaussian approximation of the path: where the robot may be lost, they are too narrow. Densities that
    are mixtures with gross errors are no Gaussians even along a straight path; for such models one short chain
    (:func:`pmcl.criticism.fitting.quick_fit.quick_fit`) takes the place of the approximation.
    """
    check_type("log", log, RobotLog, error=LogError, advice="read one with pmcl.read_log")
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    check_flag("drives", drives, error=ModelError)
    seed = check_seed(seed, error=ModelError)
    require_rows(log)
    model = default_model(log) if model is None else model
    log = with_estimated_path(log.without_truth(), model, seed=seed)
    bound = model.bind(log)
    if bound.dimension == 0:
        raise ModelError("expected at least one free parameter, but the model fixes all of them; free one")
    transform = Unconstrained(bound.parameters)
    evidence, mode = _most_probable(bound, transform, seed)
    if evidence.is_gaussian:
        draws = weighted_draws(bound, log_posterior(evidence, transform), mode, transform, seed)
        path = evidence.references[0]
        effective_draws = draws.effective_size
    else:
        draws, path, effective_draws = _by_chain(bound, transform, seed)
    predictions, prior_spread = _predictions(bound.parameters, draws, transform)
    tried: dict[Drive, Float] = {}
    notes = []
    if effective_draws < _FEW_DRAWS:
        notes.append(f"the standard deviations are rough: they rest on {effective_draws:.0f} effective draws")
    if drives:
        tried, failures = _information_of_drives(log, path, model, draws, transform, seed)
        notes += failures
    of_motion = {parameter.name for parameter in model.motion.parameters}
    shares, predictions = _with_advice(log, predictions, prior_spread, draws, tried, of_motion)
    return Identification(
        where=log.where,
        robot=log.robot,
        rows=log.n_steps,
        readings=log.n_readings,
        duration=float(log.times[-1] - log.times[0]),
        predictions=predictions,
        drives=shares,
        correlations=_correlations(bound.names, draws),
        effective_draws=effective_draws,
        notes=tuple(notes),
    )


def _most_probable(bound: BoundModel, transform: Unconstrained, seed: int) -> tuple[LinearisedEvidence, Float]:
    """Return the evidence linearised at the most probable theta and path, and that theta in unconstrained form."""
    rng = make_rng(np.random.SeedSequence((seed, 61)))
    theta = plausible_theta(bound, rng)
    evidence: LinearisedEvidence | None = None
    for number in range(_MOST_ROUNDS):
        reference = None if evidence is None else evidence.references[0]
        if number < _FILTERED_ROUNDS:
            reference = _smoothed(bound, theta, rng, reference)
        assert reference is not None
        evidence = improved(LinearisedEvidence(bound, theta, [reference]), theta)
        density = log_posterior(evidence, transform)
        start = transform.to_line(theta)
        if not math.isfinite(density(start)):
            raise FilterError(
                f"{bound.logs[0].where}: the model cannot be linearised along the smoothed path, so nothing can be "
                "predicted; calibrate instead, and look at the posterior"
            )
        if not evidence.is_gaussian:
            break
        mode = mode_of(density, start)
        theta = transform.from_line(mode)[0]
        if number >= _FILTERED_ROUNDS - 1 and np.abs(mode - start).max() < _SETTLED:
            break
    assert evidence is not None
    return evidence, transform.to_line(theta)


def _by_chain(bound: BoundModel, transform: Unconstrained, seed: int) -> tuple[WeightedDraws, Float, float]:
    """Return draws of a chain, their mean path, and how many independent draws the slowest parameter has."""
    fit = quick_fit(bound, stream_seed(seed, "chain", 0), effort=_EFFORT)
    kept, effective = fit.draws, _effective_number(fit.draws)
    for number in range(_CONTINUED):
        if effective >= _ENOUGH_DRAWS:
            break
        fit = quick_fit(bound, stream_seed(seed, "chain", number + 1), path=fit.path, draws=fit.draws, effort=_EFFORT)
        kept = np.concatenate([kept, fit.draws])
        effective = _effective_number(kept)
    return equal_draws(kept, transform), fit.path, effective


def _effective_number(draws: Float) -> float:
    """Return the least effective number of a chain's draws (N, d) over the parameters."""
    return min(bulk_ess(column[None]) for column in draws.T)


def _smoothed(bound: BoundModel, theta: Float, rng: np.random.Generator, before: Float | None) -> Float:
    """Return the mean of some paths drawn by a particle filter under theta, or the path before where it is lost."""
    try:
        tables = bound.tables(theta)[0]
        filtered = run_filter(tables, bound.lengths[0], START_PARTICLES, rng)
        return np.asarray(draw_paths(tables, filtered, _PATHS, rng).mean(axis=0))
    except FilterError:
        # Noise that fits better may be too sharp for so few particles.
        if before is None:
            raise
        return before


def _predictions(
    parameters: tuple[Parameter, ...], draws: WeightedDraws, transform: Unconstrained
) -> tuple[tuple[Prediction, ...], Float]:
    """Return what is predicted of each parameter, and the spread of each prior in unconstrained form (d,)."""
    share = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    quantiles = np.column_stack([np.asarray(parameter.prior.ppf(share), dtype=float) for parameter in parameters])
    prior_spread = transform.to_line(quantiles).std(axis=0)
    mean, std, limit = draws.mean(), draws.std(), draws.quantile(0.95)
    spread = np.sqrt(np.diag(draws.moments()[1]))
    predictions = []
    for k, parameter in enumerate(parameters):
        prior_std = float(parameter.prior.std())
        if not math.isfinite(prior_std):
            prior_std = float(quantiles[:, k].std())
        predictions.append(
            Prediction(
                name=parameter.name,
                unit=parameter.unit,
                description=parameter.description,
                relative=parameter.scales_noise,
                mean=float(mean[k]),
                std=float(std[k]),
                limit=float(limit[k]),
                prior_mean=float(parameter.prior.mean()),
                prior_std=prior_std,
                share=float(min(std[k] / prior_std, spread[k] / prior_spread[k])),
            )
        )
    return tuple(predictions), prior_spread


def _information_of_drives(
    log: RobotLog, path: Float, model: RobotModel, draws: WeightedDraws, transform: Unconstrained, seed: int
) -> tuple[dict[Drive, Float], list[str]]:
    """Return the information of each drive per row, and what hindered any."""
    theta = transform.from_line(draws.moments()[0])[0]
    if path.shape[1] < 3:
        return {}, ["no drives were tried: the state of this model is no pose"]
    found: dict[Drive, Float] = {}
    problems = []
    for drive in drives_for(log, path, sideways=moves_sideways(log, model)):
        try:
            found[drive] = information_per_row(drive, log, path, model, theta, seed)
        except DensityError:
            raise
        except PmclError as error:
            problems.append(str(error))
    # A sensor that cannot be simulated, for example, lets no drive be tried.
    return found, [] if found else [f"no drives were tried: {problems[0]}"]


def _with_advice(
    log: RobotLog,
    predictions: tuple[Prediction, ...],
    prior_spread: Float,
    draws: WeightedDraws,
    tried: Mapping[Drive, Float],
    of_motion: set[str],
) -> tuple[dict[str, tuple[float, ...]], tuple[Prediction, ...]]:
    """Return the shares after a minute of each drive, and the predictions with what to drive."""
    covariance = draws.moments()[1]
    precision = np.linalg.inv(covariance + 1e-12 * np.eye(len(predictions)))
    spread = np.sqrt(np.diag(covariance))
    rows_per_second = 1.0 / float(np.median(np.diff(log.times)))

    def factors(information: Float, seconds: float) -> Float:
        """By what each standard deviation is multiplied."""
        total = precision + seconds * rows_per_second * information
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(total))) / spread)

    own = np.array([prediction.share for prediction in predictions])
    driven = np.array([prediction.name in of_motion for prediction in predictions])
    shares = {}
    for drive, each in tried.items():
        after = own * factors(each, _TABLE_SECONDS)
        # How a robot drives is learnt from driving.
        shares[drive.name] = tuple((after if drive.moves else np.where(driven, own, after)).tolist())
    advised = []
    for k, prediction in enumerate(predictions):
        advice = None
        if not prediction.can_tell and tried:
            for minutes in _MINUTES:
                by_drive = {
                    drive.name: float(factors(each, 60.0 * minutes)[k])
                    for drive, each in tried.items()
                    if drive.moves or prediction.name not in of_motion
                }
                best = min(by_drive, key=lambda name: by_drive[name])
                share = float(spread[k] / prior_spread[k]) * by_drive[best]
                if share <= CANNOT_TELL:
                    advice = Advice(best, minutes, prediction.std * by_drive[best], share)
                    break
        advised.append(dataclasses.replace(prediction, advice=advice, tried=bool(tried)))
    return shares, tuple(advised)


def _correlations(names: tuple[str, ...], draws: WeightedDraws) -> tuple[tuple[str, str, float], ...]:
    covariance = draws.moments()[1]
    std = np.sqrt(np.diag(covariance))
    matrix = covariance / np.outer(std, std)
    pairs = [
        (names[j], names[i], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(matrix[i, j]) > _STRONG
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))
