"""The search for the effect that explains an alarm, in the catalogue and among formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pmcl.criticism.findings.assemble import found_effect
from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.findings.verdict import WORTH_A_FORMULA
from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.fitting.trials import PRACTICAL, Trial
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.judging.judged_log import JudgedLog, judge_log, with_more_simulations, with_split
from pmcl.criticism.naming.choice import choose, with_formulas, worth_it
from pmcl.criticism.naming.formula_trials import FormulaTrials, refit_formulas
from pmcl.criticism.naming.lost_robot import Recovery, recover
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.naming.scan import scan
from pmcl.criticism.naming.shortlist import (
    RankedEffect,
    of_carrier,
    of_whole_robot,
    same_instance,
    shortlist,
    untried,
    untried_twins,
)
from pmcl.criticism.scoring.scores import Direction, candidate_directions
from pmcl.criticism.settings import Settings
from pmcl.errors import CriticismError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import readings
from pmcl.models.effects.effect import Effect

__all__ = ["FIT_SHARE", "LATE_FIT_SHARE", "Outcome", "Search"]

# Both shares are chosen by hand.
FIT_SHARE = 0.6
"""Share of the rows on which models are fitted."""
LATE_FIT_SHARE = 0.8
"""Share of the rows on which models are fitted when an effect begins too late for :data:`FIT_SHARE`."""
# Both parts of a log must have so many readings (chosen by hand).
_LEAST_READINGS = 20
# An effect comes late when the score of the fit part is less than this share of the score of the whole log; the square
# root of the fit part's share, 0.77, is expected of an effect that is always there (chosen by hand).
_LATE_SCORE_SHARE = 0.5


class Outcome(NamedTuple):
    """The result of a search.

    Attributes
    ----------
    accepted : Trial or None
        The model with the effect that explains the alarms.
    found : FoundEffect or None
        The description of that effect.
    trials : list of Trial
        All candidates that were refitted.
    """

    accepted: Trial | None
    found: FoundEffect | None
    trials: list[Trial]

    @property
    def certain(self) -> bool:
        """Whether the effect is confirmed so clearly that an alarm in doubt need not be judged again."""
        return self.accepted is not None and self.accepted.confirmed


class Search:
    """Searches through the candidates for one log.

    Attributes
    ----------
    log : RobotLog
        The log.
    held_out : RobotLog or None
        Another log, which is held out as a whole.
    offered : tuple of Effect
        Candidates of the catalogue.
    refits : Refits
        Refits candidates.
    directions : tuple of Direction
        Directions of the candidates that the last judged model lacks.
    judged : JudgedLog
        The log judged under that model.
    n_formulas : int
        Formulas that the last search compared.
    """

    def __init__(
        self, log: RobotLog, offered: Sequence[Effect], settings: Settings, held_out: RobotLog | None = None
    ) -> None:
        self.log, self.held_out, self.offered = log, held_out, tuple(offered)
        split = int(FIT_SHARE * log.n_steps) if held_out is None else log.n_steps
        self.refits = Refits(log, settings, split, held_out)
        parts = [_readings(log, rows) for rows in (slice(0, split), slice(split, None))]
        if held_out is not None:
            parts[1] = _readings(held_out, slice(None))
            if min(parts) < _LEAST_READINGS:
                raise CriticismError(
                    f"expected at least {_LEAST_READINGS} readings in each log, but got {parts[0]} in {log.where} and "
                    f"{parts[1]} in {held_out.where}; record more"
                )
        if min(parts) < _LEAST_READINGS:
            raise CriticismError(
                f"{log.where}: expected at least {_LEAST_READINGS} readings in the first 60 % of the log and in the "
                f"rest, but got {parts[0]} and {parts[1]}; record more"
            )
        self.directions: tuple[Direction, ...] = ()
        self.judged: JudgedLog
        self.n_formulas = 0
        # Candidates of the last search that were tried for their scores on all rows only.
        self._only_by_all_rows: list[Effect] = []

    @property
    def settings(self) -> Settings:
        """Settings of the run; the numbers of particles may have grown."""
        return self.refits.settings

    @property
    def split(self) -> int:
        """First row of the held-out part."""
        return self.refits.split

    def use_particles(self, particles: int, finer: int) -> None:
        """Use other numbers of particles from now on.

        Parameters
        ----------
        particles : int
            Particles of a scored pass.
        finer : int
            Comparisons of log scores use so many times as many.
        """
        self.refits.settings = replace(self.settings, particles=particles, finer=finer)

    def judge(self, fit: Fit) -> JudgedFit:
        """Judge the log under a fit of the whole log."""
        self.directions = self._directions_without(fit)
        self.judged = judge_log(self.log, fit, self.directions, self.split, self.settings)
        self.refits.forget()
        return JudgedFit(fit, self.judged.scored, self.judged.judgement)

    def judge_again(self, last: JudgedFit) -> JudgedFit:
        """Judge a model with more simulated logs; refitted candidates are kept."""
        self.judged = with_more_simulations(
            self.judged, self.log, last.fit, self.directions, self.split, self.settings
        )
        return replace(last, scored=self.judged.scored, judgement=self.judged.judgement)

    def _directions_without(self, fit: Fit) -> tuple[Direction, ...]:
        return candidate_directions(fit.bound.model.effects, fit.tables, self.log, self.offered)

    def trial_of(self, last: JudgedFit) -> Trial:
        """Fit the model of a judged fit on the fit part; gaps are always those of held-out data."""
        return self.refits.base_trial(last.fit)

    def recover(self, fit: Fit, follow: Callable[[Fit], None]) -> Recovery | None:
        """Look for an effect with which the filter follows, see :func:`pmcl.criticism.naming.lost_robot.recover`.

        Parameters
        ----------
        fit : Fit
            A fit of the base model, whose filter loses the robot.
        follow : callable
            ``follow(fit)`` raises FilterError when the filter of a fitted model does not follow the robot.
        """
        self.directions = self._directions_without(fit)
        return recover(fit, self.directions, self.refits, follow)

    def effect_shown_by_data(self, last: JudgedFit) -> Outcome | None:
        """Return an effect that the data show without a fit, as rounding shows in the digits of readings.

        The spread of readings says little about such an effect. It is accepted unless it makes predictions worse.

        Parameters
        ----------
        last : JudgedFit
            The current model.
        """
        shown = [
            direction.effect
            for direction in self.directions
            if direction.effect.tells is not None and direction.effect.tells(self.log)
        ]
        for effect in shown:
            trials = self.refits.refit(self.trial_of(last), [RankedEffect(effect, 0.0)])
            for trial in trials:
                if trial.on_all.total > -max(PRACTICAL, 2.0 * trial.on_all.se):
                    found = found_effect(trial, (), last.judgement, self.directions)
                    return Outcome(trial, replace(found, p_value=0.0), [trial])
        return None

    def explain(self, last: JudgedFit, current: Trial, thorough: bool = True) -> Outcome:
        """Look for the effect that explains the alarms of a model.

        The likeliest candidates of the catalogue come first. If they do not explain the alarms, all effects of the
        whole robot and formulas follow.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted to the whole log.
        current : Trial
            The same model, fitted on the fit part.
        thorough : bool
            Whether to go on if the likeliest candidates do not explain the alarms.
        """
        refits, z = self.refits, self.judged.z
        scanned = scan(
            current.fit.bound, current.fit.theta, self.directions, z, self.settings.seed, self.settings.particles
        )
        chosen = shortlist(self.directions, z, scanned, last.judgement)
        on_fit_part = [ranked.effect for ranked in shortlist(self.directions, z, scanned, None)]
        self._only_by_all_rows = [
            ranked.effect
            for ranked in chosen
            if not any(same_instance(ranked.effect, effect) for effect in on_fit_part)
        ]
        trials = refits.refit(current, chosen)
        best, _ = choose(trials)
        if best is not None and best.absorber:
            more = shortlist(self.directions, z, scanned, last.judgement, more=True)
            trials += refits.refit(current, untried(more, trials), trials)
            best, _ = choose(trials)
        if best is not None and best.effect is not None:
            trials += refits.refit(current, untried_twins(best.effect, self.directions, z, trials), trials)
        critical_z = last.judgement.critical_z
        current, trials = refits.with_more_particles(current, refits.refit_leaders(current, trials), critical_z)
        best, _ = choose(trials)
        late = thorough and self.comes_late(last)
        # What the fit part does not show is sought on a longer one first, if the log says that it begins late.
        if best is not None and worth_it(best, critical_z) and (best.on_fit.significant or not late):
            if thorough and _explains_too_little(best, last.judgement):
                return self._search_further(last, current, trials)
            return self._beside_formulas(last, current, trials, self._formula_trials(last, current, best))
        if not thorough or last.judgement.p_value > WORTH_A_FORMULA or late:
            return Outcome(None, None, trials)
        return self._search_further(last, current, trials)

    def explain_by_formula(self, last: JudgedFit, current: Trial) -> Outcome:
        """Look for a formula only.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted to the whole log.
        current : Trial
            The same model, fitted on the fit part.
        """
        return self._best_formula(self._formula_trials(last, current))

    def _formula_trials(self, last: JudgedFit, current: Trial, best: Trial | None = None) -> FormulaTrials:
        found = refit_formulas(last, self.judged, self.directions, current, self.refits, best)
        self.n_formulas = len(found.directions)
        return found

    def _search_further(self, last: JudgedFit, current: Trial, trials: list[Trial]) -> Outcome:
        """Look among formulas and all effects of the whole robot, whatever their scores.

        Formulas come first: beside one that explains the log, most of those effects gain next to nothing at a glance
        and cost little time. Without one they all get a thorough fit.
        """
        formulas = self._formula_trials(last, current)
        formula = self._best_formula(formulas).accepted
        rivals = [formula] if formula is not None else []
        everything = of_whole_robot(self.directions, self.judged.z)
        refits = self.refits
        if rivals:
            trials = trials + refits.refit(current, untried(everything, trials), trials + rivals)
        else:
            trials = refits.refit_thoroughly(current, trials, everything)
        trials = refits.refit_leaders(current, trials, rivals)
        critical_z = last.judgement.critical_z
        best, _ = choose(trials)
        if best is None or not worth_it(best, critical_z):
            # What explains the fit part best may be an accident of that part. Held-out rows confirm hardly one wrong
            # effect in ten thousand, so that they may be asked about the others, too.
            confirmed = [trial for trial in trials if trial.merit > 0.0 and worth_it(trial, critical_z)]
            if not confirmed or self.comes_late(last):
                outcome = self._best_formula(formulas)
                return outcome._replace(trials=trials + outcome.trials)
            outcome = self._beside_formulas(last, current, confirmed, formulas)
            denied = [trial for trial in trials if not any(trial is other for other in confirmed)]
            return outcome._replace(trials=outcome.trials + denied)
        return self._beside_formulas(last, current, trials, formulas)

    def _best_formula(self, formulas: FormulaTrials) -> Outcome:
        """Return the best formula, if held-out rows confirm it, when no effect of the catalogue is confirmed."""
        best, _ = choose(formulas.trials)
        if best is None or not worth_it(best, formulas.critical_z):
            return Outcome(None, None, formulas.trials)
        found = self._found(best, (), formulas.judgement, formulas.directions, formulas.critical_z)
        return Outcome(best, found, formulas.trials)

    def _beside_formulas(
        self, last: JudgedFit, current: Trial, trials: list[Trial], formulas: FormulaTrials
    ) -> Outcome:
        """Return the best effect of the catalogue, which is confirmed, or the formula that replaces it."""
        best, twins = choose(trials)
        assert best is not None
        winner, _ = with_formulas(best, twins, formulas.trials, formulas.critical_z)
        if winner is not best and winner.effect is not None:
            # A formula is accepted only after all known effects of its carrier have been refitted.
            known = untried(of_carrier(self.directions, self.judged.z, winner.effect.carrier), trials)
            refits = self.refits
            more = refits.refit_leaders(current, refits.refit(current, known, [best, winner]), [best])
            confirmed = [trial for trial in more if worth_it(trial, last.judgement.critical_z)]
            best, twins = choose([best, *confirmed, *(trial for trial in trials if trial is not best)])
            assert best is not None
            trials = trials + more
        best, twins = with_formulas(best, twins, formulas.trials, formulas.critical_z)
        if any(best is trial for trial in formulas.trials):
            found = self._found(best, twins, formulas.judgement, formulas.directions, formulas.critical_z)
        else:
            found = self._found(best, twins, last.judgement, self.directions)
        return Outcome(best, found, trials + formulas.trials)

    def _found(
        self,
        best: Trial,
        twins: Sequence[Trial],
        judgement: Judgement,
        directions: Sequence[Direction],
        least_z: float = 0.0,
    ) -> FoundEffect:
        """Return an accepted effect, and say whether held-out rows helped to choose it.

        They did when all rows moved the held-out part to the end of the log, when only the score on all rows made the
        effect a candidate, or when its score on the fit part is not above `least_z`.
        """
        assert best.effect is not None
        moved = self.held_out is None and self.split != int(FIT_SHARE * self.log.n_steps)
        by_all_rows = any(same_instance(best.effect, effect) for effect in self._only_by_all_rows)
        return replace(
            found_effect(best, twins, judgement, directions),
            chosen_on_all_rows=moved or by_all_rows or abs(best.z) < least_z,
        )

    def comes_late(self, last: JudgedFit) -> bool:
        """Return whether some candidate has a remarkable score in the whole log and hardly one in the fit part."""
        if self.split != int(FIT_SHARE * self.log.n_steps):
            return False
        later = int(LATE_FIT_SHARE * self.log.n_steps)
        if _readings(self.log, slice(later, None)) < _LEAST_READINGS or last.judgement.p_value > WORTH_A_FORMULA:
            return False
        whole, early = np.abs(last.judgement.z), np.abs(self.judged.z)
        return bool(((whole > last.judgement.critical_z) & (early < _LATE_SCORE_SHARE * whole)).any())

    def split_at(self, share: float) -> None:
        """Fit models on this share of the rows from now on, and hold out the rest."""
        self.settings.tell(f"holding out the last {100 * (1 - share):.0f} % of the rows", "searching again")
        self.refits.split = int(share * self.log.n_steps)
        self.judged = with_split(self.judged, self.directions, self.split, self.settings)


def _explains_too_little(best: Trial, judgement: Judgement) -> bool:
    """Return whether a model gains less than the missing effect must be worth.

    A number that deviates by z standard errors costs a model at least z^2 / 2 nats. A candidate that gains less may be
    only related to the missing effect, and the best of many such candidates by chance.
    """
    return best.on_all.total < max((0.5 * alarm.z**2 for alarm in judgement.raised), default=0.0)


def _readings(log: RobotLog, rows: slice) -> int:
    """Return how many numbers the sensors have read in some rows."""
    variables = (log.dataset[name].values[rows] for name in readings(log.dataset) if name in log.dataset)
    return sum(int((~np.isnan(values)).sum()) for values in variables)
