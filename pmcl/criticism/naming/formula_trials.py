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
from pmcl.criticism.naming.probability import CREDIBLE
from pmcl.criticism.naming.waves import remarkable_waves
from pmcl.criticism.scoring.scores import Direction, directions_of, instance_key
from pmcl.criticism.settings import Settings
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect

__all__ = ["FormulaCandidates", "remarkable_formulas"]

# So many formulas are refitted, besides waves: many of them are one change in other words.
_REFITTED = 4
# A formula whose scores correlate so much, row by row, with those of an effect of the catalogue is the same change in
# other words, unless the log has evidence enough to tell them apart.
_SAME_CHANGE = 0.98
# Where an effect of the catalogue explains the log, a formula is refitted only if its score promises at least this
# share of the evidence that the effect's score promises. The share was 0.33 to 1.7 (in one log 13) for formulas that
# were right, and 0.1 to 0.9 for the best formulas where the effect was, on 20 logs of analyses/hidden_effects
# (block 97).
_LEAST_SHARE = 0.25

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


def remarkable_formulas(
    last: JudgedFit, judged: JudgedLog, log: RobotLog, settings: Settings, leading: Effect | None
) -> FormulaCandidates:
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
    leading : Effect or None
        The effect of the catalogue that explains the log best, if one explains it.
    """
    directions = directions_of(formulas(log, last.fit.tables, last.fit.path))
    if not directions:
        return FormulaCandidates([], (), last.judgement)
    with_formulas = with_directions(judged, directions, settings)
    judgement = with_formulas.judgement
    promised = _promised_evidence(judgement)
    known = _same_changes(with_formulas.scored.scores, judged.scored.scores, promised)
    least = 0.0
    if leading is not None:
        of_catalogue = zip(judged.directions, _promised_evidence(judged.judgement), strict=True)
        key = instance_key(leading)
        least = _LEAST_SHARE * max(float(of_one) for one, of_one in of_catalogue if instance_key(one.effect) == key)
    z = np.abs(judgement.z)
    eligible = (z > judgement.critical_z) & ~known & (promised >= least)
    order = [int(k) for k in np.argsort(-z) if eligible[k]]
    chosen = [RankedEffect(directions[k].effect, float(judgement.z[k])) for k in order[:_REFITTED]]
    waves = remarkable_waves(judged, log, last.fit.tables, settings)
    return FormulaCandidates([*chosen, *waves.found], directions, judgement)


def _promised_evidence(judgement: Judgement) -> Float:
    """Return the log likelihood ratio of each direction that its score promises, to second order [nat]."""
    return 0.5 * (judgement.score / np.maximum(judgement.score_std, 1e-300)) ** 2


def _same_changes(scores: Float, others: Float, promised: Float) -> NDArray[np.bool_]:
    """Return which formulas are an effect of the catalogue in other words.

    Parameters
    ----------
    scores : ndarray, shape (F, T)
        Row scores of the formulas.
    others : ndarray, shape (K, T)
        Row scores of the candidates of the catalogue.
    promised : ndarray, shape (F,)
        Evidence that each formula's score promises [nat].

    Notes
    -----
    Of two changes whose scores have correlation rho, the wrong one gets the share rho^2 of the right one's evidence to
    second order. A log tells them apart if the rest is more than the evidence that makes a name credible.
    """
    norms = np.sqrt(np.outer((scores**2).sum(axis=1), (others**2).sum(axis=1)))
    correlation = np.abs(scores @ others.T) / np.maximum(norms, 1e-300)
    greatest = correlation.max(axis=1, initial=0.0)
    told_apart = (1.0 - greatest**2) * promised
    return np.asarray((greatest > _SAME_CHANGE) & (told_apart < np.log(CREDIBLE / (1.0 - CREDIBLE))))
