"""The evidence by Kalman filters: extended and unscented, for every model whose motion has a linearisation.

Both keep a Gaussian belief about the state. They differ in how motion and readings are made linear: by slopes at the
mean, or by regression over sigma points. Sensors' rooms linearise the readings of a whole log around a path, so the
filter is run again and again, each time with readings linearised around the means that the run before predicted, until
these do not change: that fixed point is the filter that linearises at its own predictions. A few runs are enough,
because a filter forgets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import BEARING, LinearReadings, times_of
from pmcl.errors import ModelError
from pmcl.filtering.kernels.gaussian import gaussian_pass, information_rows
from pmcl.filtering.kernels.smc import sensor_terms
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.filtering.reading_information import information_of
from pmcl.geometry import wrap
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables
from pmcl.sampling.random_walk import Evaluated

__all__ = ["KalmanPass", "KalmanTarget", "draw_path", "kalman_filter"]

Float = NDArray[np.float64]

# Runs of the filter until the predicted means settle, to this distance [m, m, rad]. Where a beam crosses an edge it may
# be used in one run and not in the next; the runs then end after the most.
_MOST_RUNS, _SETTLED = 10, 1e-5
# Sigma points lie sqrt(3) standard deviations away: with weights of 1/6 they match the fourth moment of a Gaussian
# (Julier, Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92, 2004, section III).
_SIGMA_SPREAD = math.sqrt(3.0)


class KalmanPass(NamedTuple):
    """A Kalman filter over one log.

    Attributes
    ----------
    log_evidence : float
        Log of its estimate of p(readings | theta) [nat]; minus infinity where a covariance is not positive.
    increments : ndarray, shape (T,)
        Its share of each row.
    predicted, filtered : ndarray, shape (T, D)
        Means before and after the readings of each row.
    predicted_covariance, covariance : ndarray, shape (T, D, D)
        Their covariances.
    gain : ndarray, shape (T, D, D)
        The smoother's gains: a deviation at t + 1 times ``gain[t]`` is the expected deviation at t.
    """

    log_evidence: float
    increments: Float
    predicted: Float
    filtered: Float
    predicted_covariance: Float
    covariance: Float
    gain: Float


def kalman_filter(tables: Tables, first_reference: Float, *, unscented: bool) -> KalmanPass:
    """Filter one log.

    Parameters
    ----------
    tables : Tables
        Coefficients of the model.
    first_reference : ndarray, shape (T, D)
        A path near the robot's, around which the first run is linearised.
    unscented : bool
        Whether the filter is the unscented one.

    Returns
    -------
    KalmanPass
        Cost: a linearisation of all readings for each run, 2 D + 1 of them for the unscented filter.
    """
    reference, covariance = np.ascontiguousarray(first_reference), None
    result = None
    for _ in range(_MOST_RUNS):
        check_interrupt()
        log_reference = np.zeros(len(reference))
        sensors: list[Any] = []
        readings: list[Any] = []
        for table in tables.sensors:
            log_reference += sensor_terms(table, np.ascontiguousarray(reference.T[None]))[0]
            linear = sensor_of(table).linearise(table, reference)
            if linear is None:
                table = linear = information_of(table, reference)
            elif unscented and covariance is not None and isinstance(linear, LinearReadings):
                linear, change = _unscented(tables, table, linear, reference, covariance)
                log_reference += change
            sensors.append(table)
            readings.append(linear)
        known = tables._replace(sensors=tuple(sensors))
        precision, shift = information_rows(known, tuple(readings), len(reference))
        increments, predicted, filtered, before, after, gain = gaussian_pass(
            tables.start, tables.motion, precision, shift, reference, log_reference, _SIGMA_SPREAD * unscented
        )
        total = float(increments.sum())
        result = KalmanPass(
            total if math.isfinite(total) else -math.inf, increments, predicted, filtered, before, after, gain
        )
        if not math.isfinite(total) or not np.isfinite(predicted).all():
            return result._replace(log_evidence=-math.inf)
        settled = np.abs(predicted - reference).max() < _SETTLED and (covariance is not None or not unscented)
        reference, covariance = predicted, before
        if settled:
            break
    assert result is not None
    return result


def _unscented(
    tables: Tables, table: Any, linear: LinearReadings, reference: Float, covariance: Float
) -> tuple[LinearReadings, Float]:
    """Return readings with slopes and values by regression over sigma points, and by what log densities change, (T,).

    What a straight line does not explain counts as noise of the reading.
    """
    size, rows, time = reference.shape[1], len(reference), times_of(linear)
    key = _keys(linear, time)
    values, offsets, shares = [linear.value], [np.zeros_like(reference)], [1.0 - size / _SIGMA_SPREAD**2]
    roots = np.linalg.cholesky(covariance)
    for d in range(size):
        for sign in (1.0, -1.0):
            offset = np.asarray(sign * _SIGMA_SPREAD * roots[:, :, d], dtype=np.float64)
            moved = sensor_of(table).linearise(table, np.ascontiguousarray(reference + offset))
            found = np.full(key.size, np.nan)
            _, place, other = np.intersect1d(key, _keys(moved, times_of(moved)), return_indices=True)
            found[place] = moved.value[other]
            turned = np.flatnonzero(linear.kind == BEARING)
            found[turned] = linear.value[turned] + wrap(found[turned] - linear.value[turned])
            values.append(found)
            offsets.append(offset)
            shares.append(0.5 / _SIGMA_SPREAD**2)
    h, x, share = np.array(values), np.array(offsets)[:, time], np.array(shares)
    # A reading that some sigma point does not have keeps its slope at the mean.
    whole = np.asarray(np.isfinite(h).all(axis=0))
    h = np.where(whole, h, linear.value)
    mean = share @ h
    cross = np.einsum("k,kmd,km->md", share, x, h - mean)
    slope = np.where(whole[:, None], np.linalg.solve(covariance[time], cross[..., None])[..., 0], linear.jacobian)
    explained = np.einsum("md,mde,me->m", slope, covariance[time], slope)
    rest = np.where(whole, np.maximum(share @ (h - mean) ** 2 - explained, 0.0), 0.0)
    variance, residual = _scalar_readings(tables, table, linear, rows)
    weight = linear.weight * variance / (variance + rest)
    away = residual + linear.value - mean
    change = linear.weight * (
        0.5 * residual**2 / variance - 0.5 * away**2 / (variance + rest) - 0.5 * np.log1p(rest / variance)
    )
    regressed = linear._replace(
        value=mean, jacobian=np.ascontiguousarray(slope), weight=np.ascontiguousarray(weight)
    )
    return regressed, np.asarray(np.bincount(time, weights=change, minlength=rows), dtype=np.float64)


def _keys(linear: LinearReadings, time: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray((time * 4096 + linear.channel) * 4 + linear.kind)


def _scalar_readings(tables: Tables, table: Any, linear: LinearReadings, rows: int) -> tuple[Float, Float]:
    """Return the variance of each reading, and how far it is from what is expected at the reference, (M,) each.

    Both in units of the ideal reading. Kernels say only what all readings of a row tell about the state; so each
    reading is given to them as the only one of its row, with a slope of 1 along the first component.
    """
    first, time = linear.first, times_of(linear)
    place = np.arange(time.size) - first[time]
    size = linear.jacobian.shape[1]
    slope = np.zeros((time.size, size))
    slope[:, 0] = 1.0
    variance, residual = np.ones(time.size), np.zeros(time.size)
    alone = tables._replace(sensors=(table,))
    for k in range(int(place.max(initial=-1)) + 1):
        one = np.flatnonzero(place == k)
        extras: Any = type(linear.extras)
        chosen = LinearReadings(
            first=np.searchsorted(time[one], np.arange(rows + 1)).astype(np.int64),
            channel=np.ascontiguousarray(linear.channel[one]),
            kind=np.ascontiguousarray(linear.kind[one]),
            reading=np.ascontiguousarray(linear.reading[one]),
            value=np.ascontiguousarray(linear.value[one]),
            jacobian=np.ascontiguousarray(slope[one]),
            weight=np.ones(one.size),
            extras=extras(*(np.ascontiguousarray(column[one]) for column in linear.extras)),
        )
        precision, shift = information_rows(alone, (chosen,), rows)
        at = time[one]
        variance[one] = 1.0 / precision[at, 0, 0]
        residual[one] = shift[at, 0] / precision[at, 0, 0]
    return variance, residual


def draw_path(found: KalmanPass, rng: np.random.Generator) -> Float:
    """Draw a trajectory backward from a Kalman filter, (T, D)."""
    path = np.empty_like(found.filtered)
    noise = rng.standard_normal(path.shape)
    spread = found.covariance[:-1] - np.einsum(
        "tij,tjk,tlk->til", found.gain[:-1], found.predicted_covariance[1:], found.gain[:-1]
    )
    values, vectors = np.linalg.eigh(np.concatenate([spread, found.covariance[-1:]]))
    steps = np.einsum("tij,tj,tj->ti", vectors, np.sqrt(np.maximum(values, 0.0)), noise)
    path[-1] = found.filtered[-1] + steps[-1]
    for t in range(len(path) - 2, -1, -1):
        path[t] = found.filtered[t] + found.gain[t] @ (path[t + 1] - found.predicted[t + 1]) + steps[t]
    return path


class KalmanTarget:
    """An :class:`~pmcl.sampling.random_walk.EvidenceTarget` by Kalman filters.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    references : sequence of ndarray, shape (T_l, D)
        Paths near the robot's.
    unscented : bool
        Whether the filter is the unscented one.

    Raises
    ------
    ModelError
        When the robot may start anywhere: a Gaussian belief cannot say so.
    """

    blocks = 0

    def __init__(self, bound: BoundModel, references: Sequence[Float], *, unscented: bool) -> None:
        self.bound, self.references, self.unscented = bound, tuple(references), unscented
        for log, tables in zip(bound.logs, bound.tables(bound.prior_mean()), strict=True):
            if not np.isfinite(getattr(tables.start, "std", 0.0)).all():
                raise ModelError(
                    f"{log.where}: expected a start that is roughly known, but it is anywhere on the map, which a "
                    "Kalman filter's Gaussian belief cannot express; give start_mean and start_std, or use method "
                    "particle-gibbs"
                )

    def passes(self, theta: Float) -> list[KalmanPass]:
        """Return the filters of all logs; empty where theta is impossible."""
        try:
            self.bound.check(theta)
            return [
                kalman_filter(tables, reference, unscented=self.unscented)
                for tables, reference in zip(self.bound.tables(theta), self.references, strict=True)
            ]
        except (ModelError, np.linalg.LinAlgError):
            return []

    def __call__(self, theta: Float, numbers: NDArray[np.uint64]) -> Evaluated:
        """Return the evidence; the only random number is that of the trajectory."""
        passes = self.passes(theta)

        def finish() -> tuple[Float, float]:
            rng = make_rng(np.random.SeedSequence(int(numbers[-1])))
            paths = [draw_path(found, rng) for found in passes]
            tables = self.bound.tables(theta)
            return np.concatenate(paths), math.fsum(
                log_joint(table, np.ascontiguousarray(path)) for table, path in zip(tables, paths, strict=True)
            )

        return Evaluated(math.fsum(found.log_evidence for found in passes) if passes else -math.inf, finish)
