"""Formulas with remarkable scores, which compete with the effects of the catalogue."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.judging.judged_log import JudgedLog, with_directions
from pmcl.criticism.naming.candidates import RankedEffect
from pmcl.criticism.naming.formulas import formulas
from pmcl.criticism.naming.waves import remarkable_waves
from pmcl.criticism.scoring.scores import Direction, directions_of
from pmcl.criticism.settings import Settings
from pmcl.logs.robot_log import RobotLog

__all__ = ["FormulaCandidates", "remarkable_formulas"]

# So many formulas are refitted, besides waves: many of them are one change in other words.
_REFITTED = 4
# A formula whose scores correlate so much, row by row, with those of an effect of the catalogue is the same change in
# other words, and no other explanation.
_SAME_CHANGE = 0.98

Float = NDArray[np.float64]


class FormulaCandidates(NamedTuple):
    """Formulas with remarkable scores.

    Attributes
    ----------
    chosen : list of RankedEffect
        Those to refit.
    directions : tuple of Direction
        All formulas that were scored.
    judgement : Judgement
        Tests of the log with their scores.
    """

    chosen: list[RankedEffect]
    directions: tuple[Direction, ...]
    judgement: Judgement


def remarkable_formulas(last: JudgedFit, judged: JudgedLog, log: RobotLog, settings: Settings) -> FormulaCandidates:
    """Return the formulas whose scores exceed what the best of them has by chance, unless the catalogue has them.

    Parameters
    ----------
    last : JudgedFit
        The current model, fitted and judged.
    judged : JudgedLog
        The log judged under it, and the simulated logs.
    log : RobotLog
        The log.
    settings : Settings
        Settings of the run.
    """
    directions = directions_of(formulas(log, last.fit.tables, last.fit.path))
    if not directions:
        return FormulaCandidates([], (), last.judgement)
    with_formulas = with_directions(judged, directions, settings)
    judgement, known = with_formulas.judgement, _same_changes(with_formulas.scored.scores, judged.scored.scores)
    z = np.abs(judgement.z)
    order = [int(k) for k in np.argsort(-z) if z[k] > judgement.critical_z and not known[k]]
    chosen = [RankedEffect(directions[k].effect, float(judgement.z[k])) for k in order[:_REFITTED]]
    waves = remarkable_waves(judged, log, last.fit.tables, settings)
    return FormulaCandidates([*chosen, *waves.found], directions, judgement)


def _same_changes(scores: Float, others: Float) -> NDArray[np.bool_]:
    """Return which of some row scores, (F, T), are proportional to one of others, (K, T), but for a little."""
    norms = np.sqrt(np.outer((scores**2).sum(axis=1), (others**2).sum(axis=1)))
    return np.asarray((np.abs(scores @ others.T) > _SAME_CHANGE * np.maximum(norms, 1e-300)).any(axis=1))
