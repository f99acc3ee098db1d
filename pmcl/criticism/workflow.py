"""The whole loop: criticise, name, add, refit, compare on held-out data, and again until nothing alarms or helps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.criticism.arguments import check_arguments
from pmcl.criticism.assemble import (
    candidates_of,
    drawn_estimates,
    estimates,
    found_effect,
    measured,
    unexplained_of,
)
from pmcl.criticism.fit import LONG, Fit, quick_fit
from pmcl.criticism.guard import particles_that_follow
from pmcl.criticism.heldout import gap_of
from pmcl.criticism.naming import twins_of
from pmcl.criticism.passes import FINER, Settings, in_doubt
from pmcl.criticism.progress import Progress
from pmcl.criticism.result import Criticism, FoundEffect, Pass, Step
from pmcl.criticism.search import FIT_SHARE, LATER, Outcome, Search
from pmcl.criticism.trials import Trial, spare_effects
from pmcl.criticism.verdict import called, sentence_of, verdict_of
from pmcl.errors import CriticismError, FilterError
from pmcl.filtering.ahead import compile_for_criticism
from pmcl.filtering.estimated_path import with_estimated_path, with_estimates
from pmcl.filtering.one_step_ahead import Predictions, predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import path_formulas, portable
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.posterior.calibrate import calibrate
from pmcl.posterior.compat import Posterior
from pmcl.preflight.check import checked_logs

__all__ = ["criticize"]

Float = NDArray[np.float64]

_LEAST_ROWS = 60
# Parameters of effects cost a density for each proposal, and transport moves change them as well.
_ROUNDS_OF_METROPOLIS = 2


@stopping_on_interrupt()
def criticize(
    log: RobotLog,
    model: RobotModel | None = None,
    *,
    effects: Sequence[Effect] | None = None,
    particles: int = defaults.CRITICISM_PARTICLES,
    seed: int = 0,
    level: float = defaults.FALSE_ALARM_LEVEL,
    simulations: int = 30,
    paths: int = 15,
    rounds: int = 3,
    joint: bool = True,
    draws: int = 500,
    posterior: bool = False,
    workers: int | None = None,
    progress: bool = False,
) -> Criticism:
    """Find where a model and a log disagree, name the missing effect, add it, and show the gap shrink.

    Parameters
    ----------
    log : RobotLog
        The log; its reference trajectory and true parameters are never read.
    model : RobotModel, optional
        The base model; the default model of the log when left out.
    effects : sequence of Effect, optional
        Candidates; every instance of the catalogue that the log can show when left out.
    particles : int
        Particles of scored passes; comparisons of log scores use four times as many.
    seed : int
        All randomness follows from it.
    level : float
        Rate of false alarms.
    simulations : int
        Logs that the fitted model simulates to learn what is usual.
    paths : int
        Trajectories over which scores are averaged.
    rounds : int
        How many effects may be added.
    joint : bool
        Whether the final model is calibrated by full chains; otherwise one longer chain tells its parameters.
    draws : int
        Draws of each of the four final chains.
    posterior : bool
        Whether full chains are run even where nothing is added to the model, so that the result always has a
        posterior.
    workers : int, optional
        Threads; one for each core when left out. The result does not depend on it.
    progress : bool
        Tell what is being tried, how many candidates are left, and the time so far: in one line that is kept up to
        date on a terminal, elsewhere in messages of the logger ``pmcl.criticism``.

    Returns
    -------
    Criticism

    Raises
    ------
    CriticismError
        When the log is too short to split, nothing in it moves, or a posterior is asked for without full chains.
    FilterError
        When the filter loses the robot: local scores would then mean nothing.
    PmclError
        When model and log do not fit each other.

    Notes
    -----
    A name is chosen on the first 60 % of the rows and must be confirmed by the rest, which alone tells the gap;
    where what disagrees begins too late for that, these are 80 and 20 %. An alarm that is not beyond doubt is
    judged by three times as many simulated logs, unless a name gains more than two standard errors on the held-out
    part, or one there and two, more than chance can, on the whole log. A name that gains less than its alarm of z
    standard errors is worth, z^2 / 2 nats, must be the best of a search among all effects of the whole robot and
    formulas as well. Where the filter of the base model loses the robot, effects of the motion are refitted first,
    then of the sensors: one that lets it follow is added.
    """
    check_arguments(
        log, model, effects, {"particles": particles, "simulations": simulations, "paths": paths, "rounds": rounds,
                              "draws": draws, "workers": workers},
        {"joint": joint, "progress": progress, "posterior": posterior}, seed, level,
    )  # fmt: skip
    if posterior and not joint:
        raise CriticismError(
            "expected full chains for a posterior, but joint calibration is switched off; switch it on, or ask for none"
        )
    log = log.without_truth()
    _check(log)
    checked_logs((log,), model)
    base = model or default_model(log)
    with Progress(progress) as reporter:
        threads = workers or os.cpu_count() or 1
        settings = Settings(particles, seed, level, simulations, paths, threads, progress, reporter=reporter)
        log = with_estimated_path(log, base, seed=seed)
        offered = candidates(log) if effects is None else effects
        return _Loop(base, Search(log, offered, settings)).run(rounds, joint, draws, always=posterior)


def _check(log: RobotLog) -> None:
    if log.n_steps < _LEAST_ROWS:
        raise CriticismError(
            f"{log.where}: expected at least {_LEAST_ROWS} rows, to fit on one part and judge on another, but got "
            f"{log.n_steps}; record longer"
        )
    if not np.any(log.odometry[1:] != 0.0):
        raise CriticismError(
            f"{log.where}: expected a robot that moves, but all odometry is zero; drive, and turn both ways"
        )


class _Loop:
    """The state of one run."""

    def __init__(self, model: RobotModel, search: Search) -> None:
        self.base, self.search, self.log = model, search, search.log
        self.notes: list[str] = []
        self.steps: list[Step] = []
        self.found: list[FoundEffect] = []
        # What each step's model foresees, by which gaps are told in the end.
        self.foreseen: list[tuple[Predictions, Float]] = []

    @property
    def settings(self) -> Settings:
        """Of the run; the number of particles may have grown."""
        return self.search.settings

    def run(self, rounds: int, joint: bool, draws: int, always: bool) -> Criticism:
        """Go through the loop; `always` calibrates by full chains also what nothing was added to."""
        self.settings.tell("fitting the base model")
        bound = self.base.bind(self.log)
        compile_for_criticism(bound.tables(bound.prior_mean())[0])
        fit = quick_fit(bound, self.settings.seed)
        recovered: tuple[Trial, list[Trial]] | None = None
        try:
            self._follow(fit)
        except FilterError as lost:
            recovered = self.search.found_again(fit, partial(self._follow, patient=True))
            if recovered is None:
                raise
            at, name = str(lost).partition(" at ")[2].partition(";")[0], recovered[0].model.effects[-1].name
            self.notes.append(f"without {name} the filter loses the robot at {at}")
            self.settings.tell(f"named {name}: with it the filter follows", "fitting the model with it")
        first = last = self.search.criticised(fit)
        seen = first.evidence.predictions
        if len(set(zip(seen.kind.tolist(), seen.channel.tolist(), strict=True))) < 2:
            self.notes.append("one channel only: its own errors cannot be told from those of the path")
        current: Trial | None = None
        if recovered is not None:
            trial, trials = recovered
            self.found.append(found_effect(trial, twins_of(trial, trials), last.judgement, self.search.wanted))
            name = trial.model.effects[-1].name
            current = self._added(last, trial, trials, f"add {name}: with it the filter follows")
            last = self._refitted(last, current, rounds)
        for number in range(int(recovered is not None), rounds + 1):
            if in_doubt(last.judgement) and (self.found or number == rounds):
                last = self.search.looked_again(last)
                first = first if self.found else last
            alarms = last.judgement.raised
            told = self.search.told(last) if number < rounds else None
            if told is not None:
                self.found.append(told[1])
                name = told[0].model.effects[-1].name
                current = self._added(last, told[0], [told[0]], f"add {name}: its data tell of it")
                last = self._refitted(last, current, number)
                continue
            if not alarms or number == rounds:
                decision = f"stop after {rounds} effects" if alarms else "nothing unusual"
                self._record(last, current or self.search.trial_of(last), [], decision)
                break
            worst = f"{alarms[0].family} ({alarms[0].worst.kind}), p = {alarms[0].p_value:.1e}"
            self.settings.tell(f"alarm: {worst}", "looking for what explains the alarm")
            current = current or self.search.trial_of(last)
            # Of later passes a doubtful alarm was looked at again before.
            doubted = not self.found and in_doubt(last.judgement)
            outcome, compared = self._named(last, current, everywhere=not doubted)
            if doubted and not outcome.certain:
                first = last = self.search.looked_again(last)
                if not last.judgement.raised:
                    self._record(last, current, outcome.trials, "nothing unusual")
                    break
                outcome, compared = self._named(last, current)
            current, trials = compared, outcome.trials
            accepted, found = outcome.accepted, outcome.found
            if accepted is None or found is None:
                self._record(last, current, trials, "nothing known explains it")
                break
            self.found.append(found)
            assert accepted.effect is not None
            current = self._added(last, accepted, trials, f"add {accepted.effect.name}", before=current)
            last = self._refitted(last, current, number)
        return self._result(first, last, draws, chains=joint and (bool(self.found) or always))

    def _named(self, last: Pass, current: Trial, everywhere: bool = True) -> tuple[Outcome, Trial]:
        """Look for what explains a pass, in the catalogue and outside; return also what it is compared with.

        `everywhere` tells whether to go on where what the scores point to does not.
        """
        outcome = self.search.named(last, current, everywhere)
        if everywhere and outcome.accepted is None and self.search.comes_late(last):
            self.search.split_at(LATER)
            late = self.search.trial_of(last)
            again = self.search.named(last, late)
            if again.accepted is not None:
                return again, late
            self.search.split_at(FIT_SHARE)
            rule = self.search.formula(last, current)
            outcome = rule._replace(trials=outcome.trials + rule.trials)
        return outcome, current

    def _follow(self, fit: Fit, patient: bool = False) -> None:
        """Take as many particles as follow the robot; raise FilterError where none do."""
        particles, note = particles_that_follow(
            fit.bound, fit.theta, self.settings.particles, self.settings.seed, patient=patient
        )
        if note:
            self.notes.append(note)
            # Comparisons cost most of the time then, and are less noisy than those by fewer particles.
            finer = FINER if particles < 4 * self.settings.particles else FINER // 2
            self.search.settings = replace(self.settings, particles=particles, finer=finer)

    def _added(
        self, last: Pass, accepted: Trial, trials: list[Trial], decision: str, before: Trial | None = None
    ) -> Trial:
        """Record a step that adds an effect; return the model to go on with."""
        assert accepted.effect is not None
        self._record(last, before or self.search.trial_of(last), trials, decision, accepted)
        gain = accepted.on_heldout.total
        self.settings.tell(
            f"added {called(accepted.effect)}: {gain:+.1f} nats on held-out data", "fitting the model with it"
        )
        return self._without_spare(accepted)

    def _refitted(self, last: Pass, current: Trial, number: int) -> Pass:
        """Fit the new model to the whole log, and criticise it in its turn."""
        seed = self.settings.seed + number + 1
        bound = current.model.bind(self.log)
        made = current.fit
        return self.search.criticised(quick_fit(bound, seed, theta=made.theta, path=last.fit.path, draws=made.draws))

    def _without_spare(self, accepted: Trial) -> Trial:
        """Drop effects that the newest one makes superfluous: an early alias must not stay."""
        own = len(self.base.effects)
        trial, dropped = spare_effects(
            self.search.fair(accepted), own, self.log, self.search.split, seed=self.settings.seed + 100,
            particles=self.settings.comparing,
        )  # fmt: skip
        for position in dropped:
            gone = self.found.pop(position - own)
            self.notes.append(f"{gone.name} was added first and dropped when a later effect explained it")
        return trial

    def _record(
        self, last: Pass, current: Trial, trials: list[Trial], decision: str, accepted: Trial | None = None
    ) -> None:
        bound = current.model.bind(self.log)
        rng = make_rng(np.random.SeedSequence((self.settings.seed, 4)))
        seen = predict_readings(bound.tables(current.fit.theta)[0], self.log.n_steps, self.settings.comparing, rng)
        pit = seen.pit(rng)
        self.foreseen.append((seen.without_particles(), pit))
        gap = gap_of(seen, pit, slice(self.search.split, None))
        names = tuple(effect.name for effect in bound.model.effects)
        listed = candidates_of(last.judgement, self.search.wanted, trials, accepted)
        self.steps.append(Step(names, gap, last.judgement.alarms, listed, decision, last.judgement.critical_z))

    def _calibrated(self, model: RobotModel, draws: int) -> Posterior:
        """Run full chains of the final model."""
        self.settings.tell("calibrating the final model by full chains")
        reporter = self.settings.reporter
        with reporter.paused():
            return calibrate(
                self.log, model, draws=draws, metropolis_steps=_ROUNDS_OF_METROPOLIS,
                seed=self.settings.seed, progress=reporter.live,
            )  # fmt: skip

    def _result(self, first: Pass, last: Pass, draws: int, chains: bool) -> Criticism:
        # All of one held-out part, though it may have become a shorter one on the way.
        heldout = slice(self.search.split, None)
        self.steps = [
            replace(step, gap=gap_of(*seen, heldout)) for step, seen in zip(self.steps, self.foreseen, strict=True)
        ]
        before, after, posterior = estimates(first.fit), estimates(last.fit), None
        model = last.fit.bound.model
        if chains:
            posterior = self._calibrated(model, draws)
            after = drawn_estimates(last.fit, posterior)
        elif self.found:
            seed = self.settings.seed + 200
            after = estimates(
                quick_fit(
                    last.fit.bound, seed, theta=last.fit.theta, path=last.fit.path, draws=last.fit.draws, effort=LONG
                )
            )
        added = model.named_effects[len(self.base.effects) :]
        found = tuple(measured(one, effect, after, model.fixed) for one, effect in zip(self.found, added, strict=True))
        unexplained = unexplained_of(last, self.search.wanted)
        verdict = verdict_of(found, last.judgement)
        settings: dict[str, Any] = vars(self.settings) | {"split": self.search.split, "log": self.log.fingerprint()}
        del settings["workers"], settings["reporter"]  # the result does not depend on them
        # What is handed over holds on other logs as well: formulas are evaluated anew on each.
        model = replace(model, effects=tuple(portable(effect) for effect in model.effects))
        log = with_estimates(self.log, last.fit.tables, last.fit.path) if path_formulas(model.effects) else self.log
        return Criticism(
            verdict=verdict,
            sentence=sentence_of(verdict, found, unexplained, self.steps, before, after, self.log),
            effects=found,
            unexplained=unexplained,
            steps=tuple(self.steps),
            base=self.base,
            model=model,
            before=before,
            after=after,
            log=log,
            split=self.search.split,
            first=first,
            last=last,
            posterior=posterior,
            notes=tuple(self.notes),
            settings=settings,
        )
