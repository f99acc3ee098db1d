"""How often which move of a sweep is made, and the rule by which it follows from how often they are accepted."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

__all__ = ["STRETCHED", "Schedule", "schedule_of_rates"]

# Stretched blocks of a redraw are so many times as long as the schedule says, each with the same chance. Short ones are
# accepted; where a robot saw nothing for long, only long ones move the path as a whole. Create 3 of MRCLAM, at four
# rows a second, sees nothing for up to 177 rows: there they took the effective draws of one run from 406 to 1238.
# Between walls, where edges refuse long blocks, they would cost a tenth (three seeds of the Amigobot).
STRETCHED = (1, 1, 1, 1, 2, 2, 4, 8)
# Independent proposals that are accepted at least this often are worth more than random walks, since they lead further:
# between walls, where both pass at 0.27, eight of them gave 1.4 times the effective draws of four and four walks. Some
# random walks are left, because they work from anywhere; with a tenth of them instead there are 3 to 10 % fewer
# effective draws.
_SOME_JUMPS, _FEW_WALKS = 0.1, 0.02
# Blocks of the path are as long that this share of them is accepted; shorter ones forget little, and longer ones are
# refused. Between walls, where 0.13 of the blocks of 24 rows are accepted, blocks of 6 rows or fewer serve better.
_ACCEPTED_BLOCKS = 0.6
_SHORTEST_BLOCK, _LONGEST_BLOCK = 4, 24
# Where this share of the blocks is accepted, and some independent proposals, theta and the path forget their past by
# these two alone. Particles then draw the path in one sweep of ten: they lead where the linearised model does not, and
# their estimates of the evidence tell whether a chain is lost.
_SOME_BLOCKS = 0.4
_SELDOM = 0.1
# A sweep has as many proposals as leave theta where it is with this probability, within bounds: more of them would
# move what has moved already. The most are what a sweep has where nothing is known. Where 0.7 are accepted, on landmark
# maps and with Create 1, two give 4 to 10 % more effective draws for the time than three, and one a quarter less.
_UNMOVED = 0.15
_FEWEST_MOVES = 2
# Where blocks of the path are shorter than this, between walls, stretched ones are refused.
_LONG_BLOCK = 12


class Schedule(NamedTuple):
    """What a sweep with transport moves is made of; frozen with the linearisation, as the chain's law demands.

    Attributes
    ----------
    moves : int
        Proposals of each sweep, where no other number is asked for.
    walk_share : float
        Probability that a proposal is a random walk; the others are independent draws.
    path_share : float
        Probability that a sweep also draws the trajectories by particles, and theta given them. Redrawing them block
        by block suffices for most sweeps where blocks are accepted.
    redraw_share : float
        Probability that a sweep redraws the trajectories block by block.
    block : int
        Rows of a block that is redrawn: short enough to be nearly Gaussian, long enough to forget its neighbours.
    stretched : bool
        Whether half of the redraws have longer blocks, see :data:`STRETCHED`.
    sweeps : int
        Sweeps from one stored draw to the next, where no other number is asked for.
    """

    moves: int = 6
    walk_share: float = 0.5
    path_share: float = 1.0
    redraw_share: float = 1.0
    block: int = 24
    stretched: bool = True
    sweeps: int = 2


def schedule_of_rates(jumps: float, blocks: float, used: Schedule) -> Schedule:
    """Return the schedule that serves where moves were accepted so often; it makes the usual number of sweeps a draw.

    Parameters
    ----------
    jumps : float
        Share of accepted independent proposals; 0 where none were made.
    blocks : float
        Share of accepted rows of the path's redraws; 0 where none were made.
    used : Schedule
        The schedule under which they were accepted.

    Returns
    -------
    Schedule
    """
    if used.stretched:
        # Half of them were longer than the schedule says; a longer block is accepted as all of its parts are.
        shares = np.linspace(0.0, 1.0, 1001)
        blocks = float(np.interp(blocks, np.mean([shares**times for times in STRETCHED], axis=0), shares))
    schedule = Schedule()
    if 0.0 < blocks < 1.0:
        # Each row refuses its block with some small probability, so that the logarithm grows with the length.
        rows = used.block * math.log(_ACCEPTED_BLOCKS) / math.log(blocks)
        block = int(np.clip(round(rows), _SHORTEST_BLOCK, _LONGEST_BLOCK))
        schedule = schedule._replace(block=block, stretched=block >= _LONG_BLOCK)
    if jumps >= _SOME_JUMPS:
        moves = math.ceil(math.log(_UNMOVED) / math.log(1.0 - jumps)) if jumps < 1.0 else 1
        moves = int(np.clip(moves, _FEWEST_MOVES, schedule.moves))
        schedule = schedule._replace(walk_share=_FEW_WALKS, moves=moves)
        if blocks >= _SOME_BLOCKS:
            # Every second sweep need not redraw the path where blocks are as long as they get.
            share = 0.5 if schedule.block == _LONGEST_BLOCK else 1.0
            schedule = schedule._replace(path_share=_SELDOM, redraw_share=share)
    return schedule
