"""Formulas with remarkable scores, refitted beside the best effect of the catalogue or without one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.judging.judged_log import JudgedLog, with_directions
from pmcl.criticism.naming.formulas import formulas
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.naming.shortlist import RankedEffect
from pmcl.criticism.naming.waves import remarkable_waves
from pmcl.criticism.scoring.scores import Direction, directions_of

__all__ = ["FormulaTrials", "refit_formulas"]

Float = NDArray[np.float64]

# So many formulas are refitted, besides waves (chosen by hand).
_REFITTED = 4
# A formula competes with an effect if its score is greater. With an absorber it competes from this share of the
# absorber's score on, because correlated or larger noise also has the score of what the formula describes. Chosen by
# hand on effects from outside the catalogue (block 2 of analyses/hidden_effects).
_SHARE_OF_ABSORBER = 0.5
# A formula whose scores, row by row, correlate this much with those of the effect is the same change in other words,
# and does not compete (chosen by hand).
_SAME_CHANGE = 0.98


class FormulaTrials(NamedTuple):
    """Formulas that were refitted.

    Attributes
    ----------
    trials : list of Trial
        The refitted formulas.
    directions : tuple of Direction
        All formulas that were scored.
    judgement : Judgement
        Tests of the log with their scores.
    critical_z : float
        Critical value of the scores of formulas and waves.
    """

    trials: list[Trial]
    directions: tuple[Direction, ...]
    judgement: Judgement
    critical_z: float


def refit_formulas(
    last: JudgedFit,
    judged: JudgedLog,
    directions: tuple[Direction, ...],
    current: Trial,
    refits: Refits,
    best: Trial | None = None,
) -> FormulaTrials:
    """Refit the formulas with remarkable scores.

    Parameters
    ----------
    last : JudgedFit
        The current model fitted to the whole log.
    judged : JudgedLog
        The log judged under it.
    directions : tuple of Direction
        The candidates of the catalogue, in the order of the scores of `judged`.
    current : Trial
        The current model fitted on the fit part.
    refits : Refits
        Refits the formulas.
    best : Trial, optional
        The best effect of the catalogue, if one explains the log; only formulas that may be better are refitted then.
    """
    log, split, settings = refits.log, refits.split, refits.settings
    absorbs = best is not None and best.absorber
    # The catalogue knows how noise grows with motion. Formulas of noise are needed without a known effect, or when
    # noise has only a general name.
    offered = formulas(log, last.fit.tables, last.fit.path, of_noise=best is None or absorbs)
    formula_directions = directions_of(offered)
    if not formula_directions:
        return FormulaTrials([], (), last.judgement, np.inf)
    scored, judgement, z, _ = with_directions(judged, formula_directions, split, settings)
    least_z = (_SHARE_OF_ABSORBER if absorbs else 1.0) * abs(best.z) if best is not None else 0.0
    remarkable = (np.abs(judgement.z) > judgement.critical_z) & (np.abs(z) > least_z)
    order = [int(k) for k in np.argsort(-np.abs(z)) if remarkable[k]]
    if best is not None:
        of_best = [
            score
            for score, direction in zip(judged.scored.scores, directions, strict=True)
            if direction.effect is best.effect
        ]
        order = [k for k in order if not any(_same_change(scored.scores[k], score) for score in of_best)]
    waves = remarkable_waves(judged, log, last.fit.tables, split, settings, least_z)
    chosen = [RankedEffect(formula_directions[k].effect, float(z[k])) for k in order[:_REFITTED]] + waves.found
    rivals = [best] if best is not None else []
    trials = refits.refit_leaders(current, refits.refit(current, chosen, rivals), rivals)
    critical = max(judgement.critical_z, waves.critical_z)
    if best is None or any(trial.merit > best.merit for trial in trials):
        _, trials = refits.with_more_particles(current, trials, critical)
    return FormulaTrials(trials, formula_directions, judgement, critical)


def _same_change(score: Float, other: Float) -> bool:
    """Return whether two scores, (T,) each, are proportional to each other but for a little."""
    norm = float(np.sqrt((score @ score) * (other @ other)))
    return norm > 0.0 and abs(float(score @ other)) > _SAME_CHANGE * norm
