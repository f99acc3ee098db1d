"""Moves between the two explanations of readings that do not fit: gross errors, or a kink in the path.

A model with gross errors explains readings that no smooth path fits in two ways: they are wrong, or the robot made
unlikely steps to where they fit and back. Paths in between explain nothing, so that a chain rests in the explanation
that it found first: small moves of the path do not lead across, and particles drawn from the motion model miss the
kink. Where a log has some such rows, chains disagree about the noise of motion and readings. The move of this module
redraws the path near such readings as if they were sound, or as if they were gross errors
(:func:`pmcl.filtering.kernels.doubtful_rows.redraw_doubtful_rows`). It leaves the joint distribution unchanged; which
readings are doubtful decides only how often it helps, and is frozen with the linearisation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import LinearReadings, times_of
from pmcl.filtering.kernels.doubtful_rows import choose_blocks, redraw_doubtful_rows, squared_steps
from pmcl.models.tables import Tables

__all__ = ["Doubts", "doubts_at", "redrawn_where_doubtful", "shared_doubts"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Readings are doubtful if they are gross errors at the reference, more probably than not, and at least so large a share
# of the row's readings are: else the others hold the path where it is. All readings of a row are doubtful if a step to
# or from it lies farther from the motion's mean than this squared distance, which a Gaussian step of three dimensions
# exceeds once in 100 rows.
_GROSS_SHARE = 0.3
_SQUARED_STEP = 11.34
# A block reaches at most so many rows beyond a doubtful one on either side: a wrong sighting may be repeated for some
# time. Shorter blocks are as frequent, on a logarithmic scale.
_REACH = 64


class Doubts(NamedTuple):
    """The doubtful readings of one log.

    Attributes
    ----------
    rows : ndarray of int
        The rows that have some, in ascending order.
    of_sensors : tuple of ndarray of bool, or None
        For each sensor: whether each of its linearised readings is doubtful; None where it has no single readings.
    """

    rows: Int
    of_sensors: tuple[NDArray[np.bool_] | None, ...]


def doubts_at(tables: Tables, geometry: Sequence[Any], reference: Float, *, heavy_tails: bool = False) -> Doubts:
    """Return the readings that may be gross errors, or else show a kink of the path.

    Parameters
    ----------
    tables : Tables
        Coefficients at the parameters of the linearisation.
    geometry : sequence
        The linearised readings of each sensor.
    reference : ndarray, shape (T, D)
        The reference trajectory.
    heavy_tails : bool
        Whether the motion's noise has heavy tails: a far step is then no reason to doubt the readings.

    Returns
    -------
    Doubts
        Without any for a model without gross errors.
    """
    n_steps = reference.shape[0]
    single = [readings if isinstance(readings, LinearReadings) else None for readings in geometry]
    gross, count, mixed = np.zeros(n_steps), np.zeros(n_steps), False
    for readings in single:
        if readings is not None:
            times = times_of(readings)
            gross += np.bincount(times, 1.0 - readings.weight, minlength=n_steps)
            count += np.bincount(times, minlength=n_steps)
            mixed |= bool((readings.weight < 1.0).any())
    if not mixed:
        return Doubts(np.empty(0, dtype=np.int64), (None,) * len(single))
    far = np.zeros(n_steps, dtype=bool)
    if not heavy_tails:
        far = squared_steps(tables.motion, reference) > _SQUARED_STEP
        far[:-1] |= far[1:]
    most = gross >= _GROSS_SHARE * count
    return _doubts(geometry, [
        None
        if readings is None
        else (far[times_of(readings)] & (readings.weight < 1.0)) | (most[times_of(readings)] & (readings.weight < 0.5))
        for readings in single
    ])  # fmt: skip


def shared_doubts(doubts: Sequence[Doubts], geometries: Sequence[Sequence[Any]]) -> list[Doubts]:
    """Return the doubts of several chains about one log, each with those of all: another chain may rest elsewhere.

    Parameters
    ----------
    doubts : sequence of Doubts
        Those of each chain.
    geometries : sequence of sequence
        Each chain's linearised readings of each sensor.
    """
    shared = []
    for sensor in range(len(geometries[0])):
        of_chains = [
            None if one.of_sensors[sensor] is None else _codes(geometry[sensor])[one.of_sensors[sensor]]
            for one, geometry in zip(doubts, geometries, strict=True)
        ]
        known = [codes for codes in of_chains if codes is not None]
        shared.append(np.unique(np.concatenate(known)) if known else None)
    return [
        _doubts(geometry, [
            None if codes is None else np.isin(_codes(readings), codes)
            for readings, codes in zip(geometry, shared, strict=True)
        ])
        for geometry in geometries
    ]  # fmt: skip


def _codes(readings: LinearReadings) -> Int:
    """Return one number for each reading that is the same in all linearisations of a log."""
    return np.asarray((times_of(readings) * 2**24 + readings.channel) * 4 + readings.kind)


def _doubts(geometry: Sequence[Any], of_sensors: Sequence[NDArray[np.bool_] | None]) -> Doubts:
    rows = [
        times_of(readings)[doubtful]
        for readings, doubtful in zip(geometry, of_sensors, strict=True)
        if doubtful is not None
    ]
    return Doubts(np.unique(np.concatenate(rows)) if rows else np.empty(0, dtype=np.int64), tuple(of_sensors))


def redrawn_where_doubtful(
    tables: Tables,
    geometry: Sequence[Any],
    reference: Float,
    doubts: Doubts,
    path: Float,
    times: int,
    rng: np.random.Generator,
) -> tuple[Float, float]:
    """Redraw a path around doubtful readings.

    Parameters
    ----------
    tables : Tables
        Coefficients at the current theta.
    geometry : sequence
        The linearised readings of each sensor, at the current theta.
    reference : ndarray, shape (T, D)
        The reference trajectory.
    doubts : Doubts
        The doubtful readings, at least one.
    path : ndarray, shape (T, D)
        The current path; it is not changed.
    times : int
        How often blocks are chosen and redrawn.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    path : ndarray, shape (T, D)
        The new path.
    log_density : float
        log p(path, readings | theta).
    """
    new, of_rows, log_density = path.copy(), np.full(path.shape[0], np.nan), np.nan
    for _ in range(times):
        begins, stops, chance = _blocks(doubts.rows, path.shape[0], rng)
        sound, gross = list(geometry), list(geometry)
        for sensor, (readings, doubtful) in enumerate(zip(geometry, doubts.of_sensors, strict=True)):
            if doubtful is not None:
                changing = doubtful & (rng.random(doubtful.size) < chance[times_of(readings)])
                sound[sensor] = readings._replace(weight=np.where(changing, 1.0, readings.weight))
                gross[sensor] = readings._replace(weight=np.where(changing, 0.0, readings.weight))
        log_density = redraw_doubtful_rows(
            tables, tuple(sound), tuple(gross), reference, new, of_rows, begins, stops,
            rng.random(begins.size) < 0.5, rng.standard_normal(path.shape), np.log(rng.random(begins.size)),
        )  # fmt: skip
    return new, float(log_density)


def _blocks(rows: Int, n_steps: int, rng: np.random.Generator) -> tuple[Int, Int, Float]:
    """Return the blocks that are redrawn, and for each row of the log the chance of its doubtful readings to change.

    Those of a block's own row may change sides, or those of all its rows; of these all, or each with probability half.
    """
    before, after = np.exp(rng.uniform(0.0, math.log(_REACH), size=(2, rows.size))).astype(np.int64)
    blocks = choose_blocks(rows, rng.permutation(rows.size), before, after, n_steps)
    begins, stops, own = np.ascontiguousarray(blocks.T)
    everywhere, share = rng.random(begins.size) < 0.5, np.where(rng.random(begins.size) < 0.5, 1.0, 0.5)
    block = np.searchsorted(begins, rows, side="right") - 1
    inside = (block >= 0) & (rows < stops[block])
    chance = np.zeros(n_steps)
    chance[rows[inside]] = (everywhere * share)[block[inside]]
    chance[own] = share
    return begins, stops, chance
