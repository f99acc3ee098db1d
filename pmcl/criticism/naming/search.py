"""The search for the effect that explains an alarm, in the catalogue and among formulas.

One quantity decides: the posterior probability of each explanation, see :mod:`pmcl.criticism.naming.probability`.

1. The candidates that promise most (:mod:`pmcl.criticism.naming.promises`) are fitted at a glance, and so is what the
   catalogue says looks like one of those that may be right.
2. Whatever may be right after a glance is fitted longer, and what may be the answer after that is fitted thoroughly;
   where only one effect may be right, at once.
3. Formulas compete with the effects of the catalogue, unless an alarm is in doubt that none of these explains.
4. The search goes on with further candidates until the effects that were tried have nearly all probability, or until
   all candidates were tried.
5. The most probable effect is the answer, with those that may be meant instead. If the log raises alarms under the
   model with it, too, something may have more evidence that was not tried: scores tell what a small effect is worth,
   and a fit without a large one bends them. All others that promise something are then fitted at a glance, also at
   other places, until one of them is more probable; it is the answer then, and is asked the same.
6. Where something unknown is more probable than any effect alone, the most probable effect is the answer if it is more
   probable that it is there, with something unknown beside it, than that it is not.

Where no alarm is raised, the effects that may be right by their scores as they are go the same way, and count only if
they have nearly all probability.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from pmcl.criticism.findings.assemble import found_effect
from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.findings.verdict import with_place
from pmcl.criticism.fitting.quick_fit import BRIEF, THOROUGH, Fit
from pmcl.criticism.fitting.trials import Trial, effect_of
from pmcl.criticism.judging.judged_log import in_doubt
from pmcl.criticism.naming.candidates import (
    RankedEffect,
    in_order,
    other_places,
    twins_of,
    untried,
)
from pmcl.criticism.naming.formula_trials import FormulaCandidates, remarkable_formulas
from pmcl.criticism.naming.judged_models import JudgedModels
from pmcl.criticism.naming.lost_robot import Recovery, recover
from pmcl.criticism.naming.probability import (
    CREDIBLE,
    Explanations,
    explanations,
    suspects,
    with_probabilities,
)
from pmcl.criticism.naming.promises import Promises, bounds_of, promises
from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.scoring.lower_bounds import LowerBound
from pmcl.criticism.scoring.scored_log import ScoredLog
from pmcl.criticism.scoring.scores import Direction, instance_key
from pmcl.criticism.settings import Settings
from pmcl.errors import FilterError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.streams import stream_seed

__all__ = ["Outcome", "Search"]

# So many candidates are fitted at a glance at a time, the likeliest first. It decides how long a search takes, hardly
# what it finds: the search goes on where these do not explain the log.
_BATCH = 5


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
    probable : Explanations
        How probable each explanation is.
    credible : tuple of Trial
        The effects that may be meant, the accepted one first; empty where none was accepted.
    formulas : FormulaCandidates or None
        Formulas that competed.
    exhausted : bool
        Whether nothing is left that was not tried.
    """

    accepted: Trial | None
    found: FoundEffect | None
    trials: list[Trial]
    probable: Explanations
    credible: tuple[Trial, ...] = ()
    formulas: FormulaCandidates | None = None
    exhausted: bool = False

    @property
    def certain(self) -> bool:
        """Whether an effect explains the log so clearly that an alarm in doubt need not be judged again."""
        return self.accepted is not None and self.probable.explained


class Search:
    """Searches through the candidates for one log.

    Attributes
    ----------
    log : RobotLog
        The log.
    models : JudgedModels
        Judges the log under one model after another.
    refits : Refits
        Refits candidates.
    """

    def __init__(self, log: RobotLog, offered: Sequence[Effect], settings: Settings) -> None:
        self.log, self.models, self.refits = log, JudgedModels(log, offered), Refits(log, settings)
        self._bounded: tuple[ScoredLog, tuple[Direction, ...], list[LowerBound]] | None = None
        self._same = {
            effect.name: other for effect in offered for other, holds in effect.same_as.items() if holds(log)
        }

    @property
    def settings(self) -> Settings:
        """Settings of the run; the numbers of particles may have grown."""
        return self.refits.settings

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Directions of the candidates that the current model lacks."""
        return self.models.directions

    def use_particles(self, particles: int) -> None:
        """Use another number of particles for scored passes from now on."""
        self.refits.settings = self.settings.with_particles(particles)

    def judge(self, fit: Fit) -> JudgedFit:
        """Judge the log under a fit; candidates are refitted beside its model from now on."""
        self.refits.forget()
        return self.models.judge(fit, self.settings)

    def judge_again(self, last: JudgedFit) -> JudgedFit:
        """Judge a model with more simulated logs; refitted candidates are kept."""
        return self.models.judge_again(last, self.settings)

    def refuted(self, outcome: Outcome) -> bool:
        """Return whether the log raises an alarm, beyond doubt, also under the model that a search has accepted.

        It is not asked where nothing is left to be tried.

        Parameters
        ----------
        outcome : Outcome
            Result of the search.
        """
        if outcome.accepted is None or outcome.exhausted:
            return False
        judgement = self.models.judge_ahead(outcome.accepted.fit, self.settings)
        return bool(judgement.raised) and not in_doubt(judgement)

    def recover(self, fit: Fit, follow: Callable[[Fit], None]) -> Recovery | None:
        """Look for an effect with which the filter follows, see :func:`pmcl.criticism.naming.lost_robot.recover`.

        Parameters
        ----------
        fit : Fit
            A fit of the base model, whose filter loses the robot.
        follow : callable
            ``follow(fit)`` raises FilterError when the filter of a fitted model does not follow the robot.
        """
        self.models.look_for_what_lacks(fit)
        return recover(fit, self.directions, self.refits, follow)

    def effect_shown_by_data(self, last: JudgedFit, current: Trial) -> Outcome | None:
        """Return an effect that the data show without a fit, as rounding shows in the digits of readings.

        The spread of readings says little about such an effect. It is accepted unless the log speaks against it.

        Parameters
        ----------
        last : JudgedFit
            The current model, fitted and judged.
        current : Trial
            The same model, scored.
        """
        shown = [
            direction.effect
            for direction in self.directions
            if direction.effect.tells is not None and direction.effect.tells(self.log)
        ]
        for effect in shown:
            for trial in self._longer(current, self.refits.glances(current, [RankedEffect(effect, 0.0)])):
                if trial.gain.total > -2.0 * trial.gain.se:
                    found = found_effect(trial, (), last.judgement, self.directions)
                    probable = self._explanations(last, current, [trial])
                    return Outcome(trial, replace(found, p_value=0.0, probability=1.0), [trial], probable)
        return None

    def explain_suspicion(self, last: JudgedFit, current: Trial) -> Outcome | None:
        """Return the effect for which the log speaks clearly, although it raised no alarm; None where there is none.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted and judged.
        current : Trial
            The same model, scored.
        """
        suspected = {instance_key(effect) for effect in suspects(last.judgement, self.directions)}
        ranked = in_order(self.directions, self._promises(last))
        chosen = [one for one in ranked if instance_key(one.effect) in suspected]
        if not chosen:
            return None
        self.settings.tell("no alarm, but a suspicion: " + ", ".join(with_place(one.effect) for one in chosen))
        outcome = self.explain(last, current, further=False, first=chosen)
        return outcome if outcome.certain else None

    def explain(
        self,
        last: JudgedFit,
        current: Trial,
        further: bool = True,
        first: Sequence[RankedEffect] | None = None,
        refuted: Outcome | None = None,
    ) -> Outcome:
        """Look for the effect that explains the alarms of a model.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted and judged.
        current : Trial
            The same model, scored.
        further : bool
            Whether to go on if the likeliest candidates do not explain the alarms.
        first : sequence of RankedEffect, optional
            Candidates that are fitted first, instead of those that promise most.
        refuted : Outcome, optional
            An answer that cannot be all: the other candidates compete with it, until another one is more probable.
        """
        promised = self._promises(last)
        candidates = in_order(self.directions, promised)
        formulas = refuted.formulas if refuted is not None else None
        trials = list(refuted.trials) if refuted is not None else []
        tried = {instance_key(effect_of(trial)) for trial in trials}
        probable = self._explanations(last, current, trials, formulas)

        worth_a_fit = [one for one in candidates if one.worth_a_fit]

        def others() -> list[RankedEffect]:
            """Return what is worth a fit and was not tried, also at other places of what has evidence at one."""
            elsewhere = other_places(trials, self.directions, promised)
            return untried(worth_a_fit, tried) or untried(elsewhere, tried)

        def rest() -> list[RankedEffect]:
            """Return what was not tried; it may explain a log that nothing else explains."""
            return others() or untried(candidates, tried)

        usual = worth_a_fit[:_BATCH] if first is None else list(first)
        chosen = usual if refuted is None else others()[:_BATCH]
        while chosen:
            tried |= {instance_key(one.effect) for one in chosen}
            trials = self._refined(last, current, [*trials, *self.refits.glances(current, chosen)], formulas)
            probable = self._explanations(last, current, trials, formulas)
            chosen = twins_of(probable.may_be_right, untried(candidates, tried))
            if chosen or not (further or probable.explained):
                continue
            # Formulas compete whatever the alarm is worth: an effect outside the catalogue looks like one that is in
            # it, and would be told by that name.
            if formulas is None:
                leading = _leading(trials, probable)
                formulas = remarkable_formulas(last, self.models.current, self.log, self.settings, leading)
                chosen = formulas.chosen
            if not chosen and refuted is not None and _is_still_the_answer(refuted, probable):
                chosen = others()[:_BATCH]
            elif not chosen and refuted is None and not probable.explained:
                chosen = rest()[:_BATCH]
        return self._answer(last, trials, probable, formulas)._replace(exhausted=not others())

    def named_again(self, last: JudgedFit, without: Trial, ranked: RankedEffect) -> Outcome | None:
        """Choose again among an effect of a model and what looks like it; None where nothing does.

        Parameters
        ----------
        last : JudgedFit
            The model before its newest effect was added, judged.
        without : Trial
            The model with the newest effect and without the one in question, scored.
        ranked : RankedEffect
            The effect in question.
        """
        present = {instance_key(other) for other in without.model.effects}
        twins = twins_of([ranked.effect], untried(in_order(self.directions, self._promises(last)), present))
        if not twins:
            return None
        self.settings.tell(f"is it still {ranked.effect.name}?")
        self.refits.forget()
        trials = self.refits.glances(without, [ranked, *twins])
        trials = self._refined(last, without, trials, None)
        self.refits.forget()
        return self._answer(last, trials, self._explanations(last, without, trials), None)

    def beside_something_unknown(self, last: JudgedFit, current: Trial, outcome: Outcome) -> Outcome:
        """Return the effect for which the log speaks, although it speaks louder for something that has no name.

        An effect alone competes with something unknown alone. Both may be there: that is seen from the alarms that the
        log still raises under the model with the effect.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted and judged.
        current : Trial
            The same model, scored.
        outcome : Outcome
            A search that accepted nothing.
        """
        probable, formulas = outcome.probable, outcome.formulas
        clear = probable.named > 0.0 and probable.named >= CREDIBLE * (probable.named + probable.nothing)
        if outcome.accepted is not None or not clear:
            return outcome
        trials = self._longer(current, outcome.trials, probable.credible)
        of = self._explanations(last, current, trials, formulas).of
        best = max(trials, key=lambda trial: of(effect_of(trial)))
        try:
            p_value = self.models.judge_ahead(best.fit, self.settings).p_value
        except FilterError:  # with the effect the filter loses the robot: there are no alarms to go by
            return outcome
        probable = self._explanations(last, current, trials, formulas, p_value)
        return self._answer(last, trials, probable, formulas)._replace(exhausted=outcome.exhausted)

    def _promises(self, last: JudgedFit) -> Promises:
        """Return what the candidates promise; bounds are computed once for each model that is judged."""
        known = self._bounded
        if known is None or known[0] is not last.scored or known[1] is not self.directions:
            bounds = bounds_of(self.directions, last.fit, last.scored.source.columns)
            known = self._bounded = (last.scored, self.directions, bounds)
        return promises(self.directions, last.judgement, known[2])

    def _explanations(
        self,
        last: JudgedFit,
        current: Trial,
        trials: Sequence[Trial],
        formulas: FormulaCandidates | None = None,
        p_value_with: float | None = None,
    ) -> Explanations:
        seed = stream_seed(self.settings.seed, "noise of evidences")
        count = len(formulas.directions) if formulas is not None else 0
        return explanations(
            current, trials, self.directions, count, last.judgement.p_value, seed, p_value_with, self._same
        )

    def _refined(
        self, last: JudgedFit, current: Trial, trials: list[Trial], formulas: FormulaCandidates | None
    ) -> list[Trial]:
        """Return the trials, after those that may be right were fitted longer."""
        probable = self._explanations(last, current, trials, formulas)
        # One that is the answer already is fitted thoroughly below.
        brief = probable.may_be_right if len(probable.may_be_right) > 1 or not probable.likely else ()
        keys = {instance_key(effect) for effect in brief}
        glanced = [trial for trial in trials if trial.glanced and instance_key(effect_of(trial)) in keys]
        trials = _replaced(trials, glanced, self.refits.longer(current, glanced, BRIEF))
        while True:
            probable = self._explanations(last, current, trials, formulas)
            longer = self._longer(current, trials, probable.credible if probable.likely else ())
            if all(after is before for after, before in zip(longer, trials, strict=True)):
                return trials
            trials = longer  # others may be the answer now

    def _longer(self, current: Trial, trials: list[Trial], effects: Sequence[Effect] | None = None) -> list[Trial]:
        """Return the trials, after those of some effects, or all, were fitted thoroughly."""
        keys = None if effects is None else {instance_key(effect) for effect in effects}
        some = [
            trial
            for trial in trials
            if not trial.thorough and (keys is None or instance_key(effect_of(trial)) in keys)
        ]
        return _replaced(trials, some, self.refits.longer(current, some, THOROUGH))

    def _answer(
        self, last: JudgedFit, trials: list[Trial], probable: Explanations, formulas: FormulaCandidates | None
    ) -> Outcome:
        """Return the most probable effect, if some effect is more probable than that none of them is right."""
        by_key = {instance_key(effect_of(trial)): trial for trial in trials}
        credible = [by_key[instance_key(effect)] for effect in probable.credible]
        if not probable.likely:
            return Outcome(None, None, trials, probable, formulas=formulas)
        best, *twins = credible
        judgement, directions = last.judgement, self.directions
        if formulas is not None and any(direction.effect is best.effect for direction in formulas.directions):
            judgement, directions = formulas.judgement, formulas.directions
        found = with_probabilities(found_effect(best, twins, judgement, directions), best, probable)
        return Outcome(best, found, trials, probable, tuple(credible), formulas)


def _is_still_the_answer(outcome: Outcome, probable: Explanations) -> bool:
    """Return whether the effect that a search accepted is still the most probable one."""
    assert outcome.accepted is not None
    return instance_key(probable.effects[0]) == instance_key(effect_of(outcome.accepted))


def _leading(trials: Sequence[Trial], probable: Explanations) -> Effect | None:
    """Return the effect with the greatest evidence, if the effects that were tried explain the log."""
    return effect_of(max(trials, key=lambda trial: trial.evidence)) if probable.explained else None


def _replaced(trials: list[Trial], old: Sequence[Trial], new: Sequence[Trial]) -> list[Trial]:
    """Return the trials with each of `old` replaced by the one of `new` at the same position."""
    return [
        next((after for after, before in zip(new, old, strict=True) if before is trial), trial) for trial in trials
    ]
