"""Scores of readings that share their errors: a scan is judged by a few numbers, not by each of its beams.

The density of a lidar's scan is tempered, because its beams are not independent
(:mod:`pmcl.models.sensors.lidar.tempering`). Their scores are not independent either, so what sixty of them show
together must not be compared with what sixty independent ones would show. A density with exponent e is that of a row
whose n readings form n e groups of neighbours, where all readings of a group have the same error. That is the
hypothesis here. Each row is therefore reduced to the medians of the scores in a few sectors, two for each group, and
the sectors of one group have one score in common when the hypothesis is simulated.

Readings that share less than that make medians that scatter less. The model does not exclude it, so it is no fault.
Gross errors of a few readings, such as those of people and furniture, do not move a median.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_ROWS", "Sectors", "sectors_of", "shared_normals"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

MOST_ROWS = 150
"""Deviations that so many scans would not show are no fault, however long the log is.

A belief that is wide on purpose is not quite right: when beams share nothing, the filter follows each error too slowly,
and readings near edges are foreseen a little askew. With this number none of 8 logs of 600 rows of a simulated room was
objected to, and none of 48 of 120 rows, which are too short for it to count; it was chosen on these. A mount that is
wrong by 0.05 rad was, in 7 of 8 logs of 120 rows and in 4 of 4 of 600; walls that stand 0.3 m off in 10 of 11."""

# With two sectors for each group a scan that is worth two beams still tells what is ahead, behind, left and right.
_SECTORS_PER_GROUP = 2


class Sectors(NamedTuple):
    """Median scores of sectors.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Time of the row of each score [s]; not decreasing.
    sector : ndarray of int, shape (N,)
        Its sector.
    score : ndarray, shape (N,)
        Median of the scores in the sector.
    members : tuple of tuple of int
        The channels of each sector.
    """

    time: Float
    sector: Int
    score: Float
    members: tuple[tuple[int, ...], ...]


def sectors_of(time: Float, channel: Int, score: Float, exponent: float) -> Sectors:
    """Reduce each row to the medians of its sectors.

    Parameters
    ----------
    time, channel, score : ndarray, shape (N,)
        As in :class:`~pmcl.posterior.score_statistics.ScoreSeries`, of C channels in the order in which they are
        neighbours.
    exponent : float
        Exponent of each reading's density in the density of its row, in (0, 1).

    Returns
    -------
    Sectors
        Twice as many sectors as groups, of which there are C times `exponent`, at least one; no more than channels.
    """
    channels, position = np.unique(channel, return_inverse=True)
    n_sectors = min(_SECTORS_PER_GROUP * max(1, round(channels.size * exponent)), channels.size)
    sector_of = np.arange(channels.size) * n_sectors // channels.size
    times, row = np.unique(time, return_inverse=True)
    place = row * n_sectors + sector_of[position]
    order = np.argsort(place, kind="stable")
    places, first = np.unique(place[order], return_index=True)
    median = np.array([np.median(values) for values in np.split(score[order], first[1:])])
    members = tuple(tuple(channels[sector_of == number].tolist()) for number in range(n_sectors))
    return Sectors(times[places // n_sectors], places % n_sectors, median, members)


def shared_normals(time: Float, sector: Int, n_sectors: int, simulations: int, rng: np.random.Generator) -> Float:
    """Draw scores of sectors under the hypothesis that the sectors of a group share one error.

    Parameters
    ----------
    time, sector : ndarray, shape (N,)
        Their places.
    n_sectors : int
        Number of sectors.
    simulations : int
        Number of draws M.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (N, M)
        Standard normals. Where the first group of a row begins is random; after the last sector comes the first one.
    """
    n_groups = max(1, n_sectors // _SECTORS_PER_GROUP)
    times, row = np.unique(time, return_inverse=True)
    begin = rng.random(times.size)[row]
    group = np.floor((sector / n_sectors + begin) * n_groups).astype(np.int64) % n_groups
    return np.asarray(rng.standard_normal((times.size * n_groups, simulations))[row * n_groups + group])
