"""The loop of the critic: fit, judge, name, add and refit, until no alarm is left or none can be explained.

Each step takes the state of the run and returns a new one (:class:`~pmcl.criticism.state.State`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pmcl.criticism.findings.assemble import candidates_of, found_effect
from pmcl.criticism.findings.parts import FoundEffect, Step
from pmcl.criticism.findings.result import JudgedFit
from pmcl.criticism.findings.verdict import with_place
from pmcl.criticism.fitting.following import particles_that_follow
from pmcl.criticism.fitting.held_out import Gap, HeldOut, held_out, predicted_log
from pmcl.criticism.fitting.quick_fit import Fit, quick_fit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.judging.judged_log import in_doubt
from pmcl.criticism.naming.gross_errors import without_gross_errors
from pmcl.criticism.naming.lost_robot import Recovery
from pmcl.criticism.naming.probability import log_prior_odds, nothing_without_refits, with_probabilities
from pmcl.criticism.naming.revision import Answer, revised
from pmcl.criticism.naming.search import Outcome, Search
from pmcl.criticism.settings import Settings
from pmcl.criticism.state import Loss, State, Task
from pmcl.errors import FilterError
from pmcl.filtering.ahead import compile_for_criticism
from pmcl.filtering.paired_scores import Gain, paired_gain
from pmcl.logs.robot_log import RobotLog
from pmcl.streams import stream_seed

__all__ = ["Loop"]


@dataclass(frozen=True)
class Loop:
    """Adds effects to a model, one in each round.

    Attributes
    ----------
    task : Task
        The base model, its log, and the search through the candidates.
    rounds : int
        Greatest number of effects that are added.
    """

    task: Task
    rounds: int

    @property
    def search(self) -> Search:
        """The search through the candidates."""
        return self.task.search

    @property
    def settings(self) -> Settings:
        """Settings of the run; the number of particles may have grown."""
        return self.search.settings

    @property
    def log(self) -> RobotLog:
        """The log."""
        return self.task.log

    def run(self) -> State:
        """Run the loop.

        Returns
        -------
        State
            With the final model.

        Raises
        ------
        FilterError
            When the filter loses the robot and no single effect lets it follow; it tells the row where that is known.
        """
        state = self.begun()
        while not state.finished:
            state = self.after_a_round(state)
        loss = self.task.loss
        if loss is not None and loss.model.sensors != self.task.base.sensors:
            state = self._without_gross_errors(state, loss)
        return state

    def begun(self) -> State:
        """Return the state with the base model fitted and judged, and with what it needs for the filter to follow."""
        self.settings.tell("fitting the base model")
        bound = self.task.base.bind(self.log)
        compile_for_criticism(bound.tables(bound.prior_mean())[0])
        fit = quick_fit(bound, stream_seed(self.settings.seed, "fit of the whole log", 0))
        notes = self.task.notes
        if self.task.other is not None:
            notes += (
                f"models are fitted to {self.log.where}; gains and gaps are shown on {self.task.other.where}, which "
                "neither a fit nor the choice of a name has used",
            )
        try:
            notes += self._follow(fit)
        except FilterError as lost:
            recovery, more = self._recovery(fit, lost)
            judged = self.search.judge(fit)
            return self._with_recovery(State(judged, judged, notes=notes + more + _on_channels(judged)), recovery)
        judged = self.search.judge(fit)
        nothing = nothing_without_refits(judged.judgement, self.search.directions)
        return self._nothing_is(State(judged, judged, notes=notes + _on_channels(judged)), nothing)

    def after_a_round(self, state: State) -> State:
        """Return the state after a round: with one more effect, or finished because nothing is to be added.

        What the data show without a fit comes first, then what raised an alarm; where nothing did, an effect for which
        the evidence is clear all the same.
        """
        last_round = len(state.steps) == self.rounds
        if in_doubt(state.judged.judgement) and (state.answers or last_round):
            state = self._judged_again(state)
        alarms = state.judged.judgement.raised
        if last_round:
            return self._finished(state, [], f"stop after {self.rounds} effects" if alarms else "nothing unusual")
        current = self.search.refits.base_trial(state.judged.fit)
        shown = self.search.effect_shown_by_data(state.judged, current)
        if shown is not None:
            return self._accepted(self._nothing_is(state, 0.0), shown, "add {}: the data show it")
        if alarms:
            return self._explained(state, current)
        suspicion = self.search.explain_suspicion(state.judged, current)
        if suspicion is None:
            return self._finished(state, [], "nothing unusual")
        state = self._nothing_is(state, suspicion.probable.nothing)
        return self._accepted(state, suspicion, "add {}: its evidence is clear, though it raised no alarm")

    def _explained(self, state: State, current: Trial) -> State:
        """Return the state with the effect that explains the alarms; finished where nothing does, or no alarm is left.

        Parameters
        ----------
        state : State
            Its model raises alarms.
        current : Trial
            That model, scored.
        """
        worst = state.judged.judgement.raised[0]
        what = f"{worst.family} ({worst.worst.kind}), p = {worst.p_value:.1e}"
        self.settings.tell(f"alarm: {what}", "looking for what explains the alarm")
        # Beside an accepted effect an alarm in doubt has been judged again already.
        doubted = not state.answers and in_doubt(state.judged.judgement)
        outcome = self.search.explain(state.judged, current, further=not doubted)
        if doubted and not outcome.certain:
            state = self._judged_again(state)
            if not state.judged.judgement.raised:
                state = self._nothing_is(state, outcome.probable.nothing)
                return self._finished(state, outcome.trials, "nothing unusual")
            outcome = self.search.explain(state.judged, current)
        self._tell_name(outcome)
        while self.search.refuted(outcome):
            self.settings.tell("that does not explain all of it: trying what else may be meant")
            before, outcome = outcome.accepted, self.search.explain(state.judged, current, refuted=outcome)
            if outcome.accepted is not before:
                self._tell_name(outcome)
        if outcome.accepted is None:
            outcome = self.search.beside_something_unknown(state.judged, current, outcome)
            self._tell_name(outcome)
        state = self._nothing_is(state, outcome.probable.nothing)
        if outcome.accepted is None:
            return self._finished(state, outcome.trials, "nothing known explains it")
        return self._accepted(state, outcome, "add {}", told=True)

    def _judged_again(self, state: State) -> State:
        """Return the state with its model judged by more simulated logs."""
        judged = self.search.judge_again(state.judged)
        return replace(state, judged=judged, first=state.first if state.answers else judged)

    def _recovery(self, fit: Fit, lost: FilterError) -> tuple[Recovery, tuple[str, ...]]:
        """Return an effect with which the filter follows, and notes; raise the error where there is none."""
        if self.task.loss is not None:
            raise lost
        notes: list[str] = []
        recovery = self.search.recover(fit, lambda other: notes.extend(self._follow(other, patient=True)))
        if recovery is None:
            raise lost
        name = recovery.accepted.model.effects[-1].name
        self.settings.tell(f"named {name}: with it the filter follows", "fitting the model with it")
        return recovery, (*notes, f"without {name} the filter loses the robot at t={self.log.times[lost.row or 0]:g} s")

    def _with_recovery(self, state: State, recovery: Recovery) -> State:
        trial, trials, probable, twins = recovery
        found = found_effect(trial, twins, state.judged.judgement, self.search.directions)
        found = with_probabilities(found, trial, probable)
        answer = Answer(found, (trial, *twins))
        return self._added(state, trial, trials, answer, f"add {found.name}: with it the filter follows")

    def _nothing_is(self, state: State, probability: float) -> State:
        """Set the probability that the base model lacks nothing, as long as it is the base model that is judged."""
        if state.answers or self.task.loss is not None:
            return state
        return replace(state, nothing_probability=probability)

    def _follow(self, fit: Fit, patient: bool = False) -> tuple[str, ...]:
        """Use as many particles as follow the robot from now on, and return notes; raise FilterError if none do."""
        particles, note = particles_that_follow(
            fit.bound, fit.theta, self.settings.particles, stream_seed(self.settings.seed, "guard"), patient=patient
        )
        if not note:
            return ()
        self.search.use_particles(particles)
        return (note,)

    def _tell_name(self, outcome: Outcome) -> None:
        """Tell the user what a search has found, before it takes its time to judge the model with it."""
        if outcome.accepted is not None and outcome.found is not None:
            self.settings.tell(
                f"named {with_place(outcome.found)}: {outcome.accepted.evidence:+.1f} nats of evidence",
                "judging the model with it",
            )

    def _accepted(self, state: State, outcome: Outcome, decision: str, told: bool = False) -> State:
        """Return the state with the effect that a search accepted; `told` if the user knows it already."""
        assert outcome.accepted is not None
        assert outcome.found is not None
        if not told:
            self._tell_name(outcome)
        answer = Answer(outcome.found, outcome.credible)
        return self._added(state, outcome.accepted, outcome.trials, answer, decision.format(outcome.found.name))

    def _added(self, state: State, accepted: Trial, trials: Sequence[Trial], answer: Answer, decision: str) -> State:
        """Return the state with an effect added, and the model with it judged."""
        before = self._recorded(state, trials, decision, accepted)
        state, accepted = self._revised(before, accepted)
        found, other = answer.found, self.task.other
        state = replace(state, held_out=self._predicted(accepted.fit))
        gain = _gain(state.held_out, before.held_out)
        if other is not None and not gain.total > 0.0:
            state = state.noted(
                f"{found.name} gains nothing on {other.where} ({gain.total:.1f} ± {gain.se:.1f} nats): it belongs "
                f"to {self.log.where} alone, or something else is meant"
            )
        answer = answer._replace(found=self._with_gain(found, gain))
        self.settings.tell(
            f"added {with_place(found)}: {gain.total:+.1f} nats on held-out data", "judging the model with it"
        )
        return replace(state, answers=(*state.answers, answer), judged=self.search.judge(accepted.fit))

    def _with_gain(self, found: FoundEffect, gain: Gain) -> FoundEffect:
        return replace(
            found, log_score_gain=gain.total, log_score_gain_se=gain.se, chosen_on_all_rows=self.task.other is None
        )

    def _predicted(self, fit: Fit) -> HeldOut | None:
        """Return how a model predicts the held-out part; None where its filter loses the robot."""
        seed = stream_seed(self.settings.seed, "predictions of a step")
        try:
            if self.task.other is not None:
                return predicted_log(fit, self.task.other, particles=self.settings.comparing, seed=seed)
            return held_out(fit, self.task.split, particles=self.settings.comparing, seed=seed)
        except FilterError:
            return None

    def _revised(self, state: State, accepted: Trial) -> tuple[State, Trial]:
        """Look at earlier effects again, now that the newest one is in the model; return the model as well."""
        after = revised(
            accepted, state.answers, len(self.task.base.effects),
            partial(log_prior_odds, directions=self.search.directions),
            partial(self.search.named_again, state.judged), seed=self.search.refits.seed,
        )  # fmt: skip
        answers = list(after.answers)
        notes = [f"{name} was added first and dropped when a later effect explained it" for name in after.dropped]
        for position, name, without in after.exchanged:
            answer = answers[position]
            notes.append(
                f"{name} was added first, and {answer.found.name} took its place, which is more probable in a model "
                "with a later effect"
            )
            self.settings.tell(f"renamed {name}: {with_place(answer.found)}")
            gain = _gain(self._predicted(after.trial.fit), self._predicted(without.fit))
            answers[position] = answer._replace(found=self._with_gain(answer.found, gain))
        return replace(state, answers=tuple(answers)).noted(*notes), after.trial

    def _without_gross_errors(self, state: State, loss: Loss) -> State:
        """Return the state with the final model without gross errors, if it needs none; else as it is, with a note.

        With what was found in it, the filter of the model that was asked for may follow the robot. It then stays if the
        log speaks no more for gross errors than against them.
        """
        if not state.answers:
            return state
        notes: list[str] = []
        without = without_gross_errors(
            state.judged.fit, loss.model.sensors, self.search.refits, lambda fit: notes.extend(self._follow(fit))
        )
        state = state.noted(*notes)
        if without.fit is None:
            return state.noted(f"gross errors are still needed: {without.reason}")
        try:
            judged = self.search.judge(without.fit)
        except FilterError as error:
            return state.noted(f"gross errors are kept: {error}")
        state = state.noted("gross errors were allowed for at first, and dropped when what was found explained them")
        state = replace(state, judged=judged, held_out=None)
        return self._recorded(state, [], "allow for no gross errors: with what was found the filter follows")

    def _finished(self, state: State, trials: Sequence[Trial], decision: str) -> State:
        return replace(self._recorded(state, trials, decision), finished=True)

    def _recorded(
        self, state: State, trials: Sequence[Trial], decision: str, accepted: Trial | None = None
    ) -> State:
        """Return the state with its model among the steps.

        Parameters
        ----------
        state : State
            With the current model.
        trials : sequence of Trial
            Refitted candidates.
        decision : str
            The decision about the model.
        accepted : Trial, optional
            The trial that is added to the model.
        """
        judgement, predicted = state.judged.judgement, state.held_out or self._predicted(state.judged.fit)
        gap = predicted.gap if predicted is not None else Gap(np.nan, np.nan, np.nan)
        names = tuple(effect.name for effect in state.judged.fit.bound.model.effects)
        listed = candidates_of(judgement, self.search.directions, trials, accepted)
        step = Step(names, gap, judgement.alarms, listed, decision, judgement.critical_z)
        return replace(state, steps=(*state.steps, step), held_out=predicted)


def _on_channels(judged: JudgedFit) -> tuple[str, ...]:
    """Return a note where the log has one channel only."""
    predictions = judged.scored.predictions
    channels = set(zip(predictions.kind.tolist(), predictions.channel.tolist(), strict=True))
    return () if len(channels) > 1 else ("one channel only: its own errors cannot be told from those of the path",)


def _gain(after: HeldOut | None, before: HeldOut | None) -> Gain:
    """Return the gain on held-out rows of one model over another; NaN where a filter loses the robot."""
    if after is None or before is None:
        return Gain(np.nan, np.nan)
    return paired_gain(after.rows, before.rows, slice(None))
