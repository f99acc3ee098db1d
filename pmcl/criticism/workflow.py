"""The whole loop: criticise, name, add, refit, compare on held-out data, and again until nothing alarms or helps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.assemble import (
    candidates_of,
    drawn_estimates,
    estimates,
    found_effect,
    measured,
    unexplained_of,
)
from pmcl.criticism.fit import LONG, Fit, quick_fit
from pmcl.criticism.formulas import formulas
from pmcl.criticism.guard import particles_that_follow
from pmcl.criticism.heldout import gap_of
from pmcl.criticism.naming import (
    Trial,
    choose,
    leaders,
    of_the_whole_robot,
    scan,
    shortlist,
    spare_effects,
    thoroughly,
    trial_of_base,
    try_effect,
    untried,
    untried_twins,
    worth_it,
)
from pmcl.criticism.passes import (
    Judged,
    Settings,
    candidate_directions,
    criticised,
    judged_again,
    mapped,
    split_again,
)
from pmcl.criticism.result import Criticism, FoundEffect, Pass, Step
from pmcl.criticism.scores import Direction, directions
from pmcl.criticism.verdict import WORTH_A_FORMULA, called, sentence_of, verdict_of
from pmcl.errors import CriticismError, FilterError
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.predictive import Predictions, predict_readings
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.catalogue import candidates
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.posterior.calibrate import calibrate

__all__ = ["criticize"]

Float = NDArray[np.float64]

_LEAST_ROWS, _LEAST_READINGS = 60, 20
# Share of the rows on which models are fitted; and the share for an effect that comes too late for that.
_FIT_SHARE, _LATER = 0.6, 0.8
# A score that is remarkable comes late when this share of it is not in the fit part; evenly spread, 0.77 would be.
_ALREADY = 0.5
_FORMULAS = 4
# Parameters of effects cost a density for each proposal, and transport moves change them as well.
_ROUNDS_OF_METROPOLIS = 2
# Formulas compete with an absorber when their score is at least this share of its own.
_NEARLY = 0.5


def criticize(
    log: RobotLog,
    model: RobotModel | None = None,
    *,
    effects: Sequence[Effect] | None = None,
    particles: int = 500,
    seed: int = 0,
    level: float = 0.05,
    simulations: int = 30,
    paths: int = 15,
    rounds: int = 3,
    joint: bool = True,
    draws: int = 500,
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
    workers : int, optional
        Threads; one for each core when left out. The result does not depend on it.
    progress : bool
        Log each step as it is made.

    Returns
    -------
    Criticism

    Raises
    ------
    CriticismError
        When the log is too short to split, or nothing in it moves.
    FilterError
        When the filter loses the robot: local scores would then mean nothing.
    PmclError
        When model and log do not fit each other.

    Notes
    -----
    A name is chosen on the first 60 % of the rows and must be confirmed by the rest, which alone tells the gap; where
    what disagrees begins too late for that, these are 80 and 20 %. An alarm that is not beyond doubt is judged by three
    times as many simulated logs. Where the filter of the base model loses the robot, effects of the motion are refitted
    first: one that lets it follow is added.
    """
    settings = Settings(particles, seed, level, simulations, paths, workers or os.cpu_count() or 1, progress)
    log = log.without_truth()
    _check(log, simulations, level, rounds)
    return _Loop(log, model or default_model(log), effects, settings).run(rounds, joint, draws)


def _check(log: RobotLog, simulations: int, level: float, rounds: int) -> None:
    if log.n_steps < _LEAST_ROWS:
        raise CriticismError(
            f"{log.where}: expected at least {_LEAST_ROWS} rows, to fit on one part and judge on another, but got "
            f"{log.n_steps}; record longer"
        )
    if not np.any(log.odometry[1:] != 0.0):
        raise CriticismError(
            f"{log.where}: expected a robot that moves, but all odometry is zero; drive, and turn both ways"
        )
    if simulations < 15:
        raise CriticismError(f"expected at least 15 simulated logs, but got {simulations}; ask for more")
    if not 0.0 < level < 0.5 or rounds < 1:
        raise CriticismError(
            f"expected a level between 0 and 0.5 and at least one round, but got {level:g} and {rounds}; choose others"
        )


def _readings(log: RobotLog, rows: slice) -> int:
    names = ("range", "landmark_range", "landmark_bearing", "landmark_size")
    return sum(int((~np.isnan(log.dataset[name].values[rows])).sum()) for name in names if name in log.dataset)


class _Loop:
    """The state of one run."""

    def __init__(
        self, log: RobotLog, model: RobotModel, effects: Sequence[Effect] | None, settings: Settings
    ) -> None:
        self.log, self.base, self.settings = log, model, settings
        self.split = int(_FIT_SHARE * log.n_steps)
        parts = [_readings(log, rows) for rows in (slice(0, self.split), slice(self.split, None))]
        if min(parts) < _LEAST_READINGS:
            raise CriticismError(
                f"{log.where}: expected at least {_LEAST_READINGS} readings in the first 60 % of the log and in the "
                f"rest, but got {parts[0]} and {parts[1]}; record more"
            )
        self.offered = tuple(candidates(log) if effects is None else effects)
        self.notes: list[str] = []
        self.steps: list[Step] = []
        self.found: list[FoundEffect] = []
        self.wanted: tuple[Direction, ...] = ()
        self.judged: Judged
        # What each step's model foresees, by which gaps are told in the end.
        self.foreseen: list[tuple[Predictions, Float]] = []

    def run(self, rounds: int, joint: bool, draws: int) -> Criticism:
        """Go through the loop."""
        self.settings.tell("fitting the base model")
        fit = quick_fit(self.base.bind(self.log), self.settings.seed)
        recovered: tuple[Trial, list[Trial]] | None = None
        try:
            self._follow(fit)
        except FilterError as lost:
            recovered = self._found_again(fit)
            if recovered is None:
                raise
            at = str(lost).partition(" at ")[2].partition(";")[0]
            self.notes.append(f"without {recovered[0].model.effects[-1].name} the filter loses the robot at {at}")
        first = last = self._pass(fit)
        seen = first.evidence.predictions
        if len(set(zip(seen.kind.tolist(), seen.channel.tolist(), strict=True))) < 2:
            self.notes.append("one channel only: its own errors cannot be told from those of the path")
        current: Trial | None = None
        if recovered is not None:
            trial, trials = recovered
            self.found.append(found_effect(trial, choose(trials)[1], last.judgement, self.wanted))
            name = trial.model.effects[-1].name
            current = self._added(last, trial, trials, f"add {name}: with it the filter follows")
            last = self._refitted(last, current, rounds)
        for number in range(int(recovered is not None), rounds + 1):
            alarms = last.judgement.raised
            told = self._told(last)
            if told is not None and number < rounds:
                current = self._added(last, told, [told], f"add {told.model.effects[-1].name}: its data tell of it")
                last = self._refitted(last, current, number)
                continue
            if not alarms or number == rounds:
                decision = f"stop after {rounds} effects" if alarms else "nothing unusual"
                self._record(last, current or self._trial_of(last), [], decision)
                break
            self.settings.tell(f"alarm: {alarms[0].family} ({alarms[0].worst.kind}), p = {alarms[0].p_value:.1e}")
            current = current or self._trial_of(last)
            accepted, trials = self._named(last, current)
            if accepted is None and self._comes_late(last):
                self._split_at(last, _LATER)
                late = self._trial_of(last)
                accepted, more = self._named(last, late)
                trials, current = (more, late) if accepted is not None else (trials, current)
                if accepted is None:
                    self._split_at(last, _FIT_SHARE)
            if accepted is None and last.judgement.p_value <= WORTH_A_FORMULA:
                accepted, known, more = self._formula(last, current)
                trials += more
                if accepted is not None:
                    self.found.append(known)
            if accepted is None:
                self._record(last, current, trials, "nothing known explains it")
                break
            assert accepted.effect is not None
            current = self._added(last, accepted, trials, f"add {accepted.effect.name}", before=current)
            last = self._refitted(last, current, number)
        return self._result(first, last, joint, draws)

    def _follow(self, fit: Fit) -> None:
        """Take as many particles as follow the robot; raise FilterError where none do."""
        particles, note = particles_that_follow(fit.bound, fit.theta, self.settings.particles, self.settings.seed)
        if note:
            self.notes.append(note)
            self.settings = replace(self.settings, particles=particles)

    def _found_again(self, fit: Fit) -> tuple[Trial, list[Trial]] | None:
        """Look for an effect of the motion with which the filter follows a robot that it loses without.

        Scores of a lost filter mean nothing, but a trajectory that is updated with the parameters is not lost so
        easily: all effects of the motion are refitted. Return the best and all trials, or None.
        """
        self.settings.tell("the filter loses the robot: refitting all effects of the motion")
        self.wanted = candidate_directions(self.log, fit, self.offered)
        split, seed, particles = self.split, self.settings.seed + 100, self.settings.comparing
        try:
            current = trial_of_base(
                self.base, self.log, split, seed=seed, particles=particles, theta=fit.theta, path=fit.path
            )
            nothing = np.zeros(len(self.wanted))
            offered = of_the_whole_robot(self.wanted, nothing, carrier="motion", absorbers=True)
            trials = self._settled(current, self._tried(current, offered))
            best, _ = choose(trials)
            if best is None or not best.on_heldout.significant:
                return None
            self._follow(quick_fit(best.model.bind(self.log), seed, theta=best.fit.theta, path=fit.path))
        except FilterError:
            return None
        return best, trials

    def _comes_late(self, last: Pass) -> bool:
        """Tell whether a candidate is remarkable in the whole log, and hardly so in the part that is fitted on."""
        if self.split != int(_FIT_SHARE * self.log.n_steps):
            return False
        later = int(_LATER * self.log.n_steps)
        if _readings(self.log, slice(later, None)) < _LEAST_READINGS or last.judgement.p_value > WORTH_A_FORMULA:
            return False
        whole, early = np.abs(last.judgement.z), np.abs(self.judged.z)
        return bool(((whole > last.judgement.critical_z) & (early < _ALREADY * whole)).any())

    def _split_at(self, last: Pass, share: float) -> None:
        """Hold out other rows."""
        self.settings.tell(f"holding out the last {100 * (1 - share):.0f} % of the rows")
        self.split = int(share * self.log.n_steps)
        self.judged = split_again(self.judged, self.wanted, self.split, self.settings)

    def _added(
        self, last: Pass, accepted: Trial, trials: list[Trial], decision: str, before: Trial | None = None
    ) -> Trial:
        """Record a step that adds an effect; return the model to go on with."""
        assert accepted.effect is not None
        self._record(last, before or self._trial_of(last), trials, decision, accepted)
        gain = accepted.on_heldout.total
        self.settings.tell(f"added {called(accepted.effect)}: {gain:+.1f} nats on held-out data")
        return self._without_spare(accepted)

    def _refitted(self, last: Pass, current: Trial, number: int) -> Pass:
        """Fit the new model to the whole log, and criticise it in its turn."""
        seed = self.settings.seed + number + 1
        return self._pass(quick_fit(current.model.bind(self.log), seed, theta=current.fit.theta, path=last.fit.path))

    def _told(self, last: Pass) -> Trial | None:
        """Return the model with an effect that the data show by themselves, as rounding shows in their digits.

        How readings scatter says little about such an effect; it is added unless it makes predictions worse.
        """
        shown = [one.effect for one in self.wanted if one.effect.tells is not None and one.effect.tells(self.log)]
        for effect in shown:
            (trial,) = self._tried(self._trial_of(last), [(effect, 0.0)]) or (None,)
            if trial is not None and trial.on_all.total > -max(3.0, 2.0 * trial.on_all.se):
                self.found.append(replace(found_effect(trial, (), last.judgement, self.wanted), p_value=0.0))
                return trial
        return None

    def _pass(self, fit: Fit) -> Pass:
        self.wanted = candidate_directions(self.log, fit, self.offered)
        self.judged = criticised(self.log, fit, self.wanted, self.split, self.settings)
        return Pass(fit, self.judged.evidence, self.judged.judgement)

    def _trial_of(self, last: Pass) -> Trial:
        """Fit the model of a pass on the fit part; gaps are always those of held-out data."""
        return trial_of_base(
            last.fit.bound.model, self.log, self.split, seed=self.settings.seed + 100,
            particles=self.settings.comparing, theta=last.fit.theta, path=last.fit.path,
        )  # fmt: skip

    def _named(self, last: Pass, current: Trial) -> tuple[Trial | None, list[Trial]]:
        """Return the accepted trial or None, and all trials."""
        settings, z = self.settings, self.judged.z
        scanned = scan(current.fit.bound, current.fit.theta, self.wanted, z, settings.seed, settings.particles)
        trials = self._tried(current, shortlist(self.wanted, z, scanned))
        best, _ = choose(trials)
        if best is not None and best.effect is not None and best.effect.absorber:
            trials += self._tried(current, untried(shortlist(self.wanted, z, scanned, more=True), trials))
            best, _ = choose(trials)
        if best is not None and best.effect is not None:
            trials += self._tried(current, untried_twins(best.effect, self.wanted, z, trials))
        trials = self._settled(current, trials)
        best, twins = choose(trials)
        if (best is None or not worth_it(best, last.judgement.critical_z)) and (
            last.judgement.p_value <= WORTH_A_FORMULA
        ):
            trials += self._tried(current, untried(of_the_whole_robot(self.wanted, z), trials))
            trials = self._settled(current, trials)
            best, twins = choose(trials)
        if best is None or not worth_it(best, last.judgement.critical_z):
            return None, trials
        found = found_effect(best, twins, last.judgement, self.wanted)
        if best.effect is not None and best.effect.absorber:
            # What looks like noise with a memory may follow a rule that the catalogue does not hold.
            ruled, known, more = self._formula(last, current, of_noise=False, beyond=_NEARLY * abs(best.z))
            trials += more
            if ruled is not None and ruled.merit > best.merit:
                best, found = ruled, known
        self.found.append(found)
        return best, trials

    def _formula(
        self, last: Pass, current: Trial, of_noise: bool = True, beyond: float = 0.0
    ) -> tuple[Trial | None, FoundEffect, list[Trial]]:
        """Look outside the catalogue: return the accepted formula or None, what is known of it, and all trials.

        Only formulas whose score is remarkable, and `beyond` a value, are tried.
        """
        nothing = FoundEffect("", "", {}, {}, 1.0, 0.0, 0.0)
        offered = formulas(self.log, last.fit.tables, last.fit.path, of_noise=of_noise)
        wanted: tuple[Direction, ...] = directions(offered)
        if not wanted:
            return None, nothing, []
        _, judged, z, _ = judged_again(self.judged, wanted, self.split, self.settings)
        least = max(judged.critical_z, beyond)
        order = [int(k) for k in np.argsort(-np.abs(z)) if abs(judged.z[k]) > least]
        trials = self._tried(current, [(wanted[k].effect, float(z[k])) for k in order[:_FORMULAS]])
        trials = self._settled(current, trials)
        best, _ = choose(trials)
        if best is None or not worth_it(best, judged.critical_z):
            return None, nothing, trials
        return best, found_effect(best, (), judged, wanted), trials

    def _tried(self, current: Trial, chosen: list[tuple[Effect, float]]) -> list[Trial]:
        if chosen:
            self.settings.tell("refitting " + ", ".join(called(effect) for effect, _ in chosen))

        def one(k: int) -> Trial | None:
            effect, z = chosen[k]
            seed, particles = self.settings.seed + 100, self.settings.comparing
            return try_effect(current, effect, z, self.log, self.split, seed=seed, particles=particles)

        return [trial for trial in mapped(one, len(chosen), self.settings.workers) if trial is not None]

    def _settled(self, current: Trial, trials: list[Trial]) -> list[Trial]:
        """Return the trials, those that lead fitted thoroughly."""
        first = leaders(trials)

        def one(k: int) -> Trial:
            seed, particles = self.settings.seed + 100, self.settings.comparing
            return thoroughly(first[k], current, self.log, self.split, seed=seed, particles=particles)

        new = mapped(one, len(first), self.settings.workers)
        return [next((n for n, old in zip(new, first, strict=True) if old is trial), trial) for trial in trials]

    def _without_spare(self, accepted: Trial) -> Trial:
        """Drop effects that the newest one makes superfluous: an early alias must not stay."""
        own = len(self.base.effects)
        trial, dropped = spare_effects(
            accepted, own, self.log, self.split, seed=self.settings.seed + 100, particles=self.settings.comparing
        )
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
        self.foreseen.append((seen, pit))
        gap = gap_of(seen, pit, slice(self.split, None))
        names = tuple(effect.name for effect in bound.model.effects)
        listed = candidates_of(last.judgement, self.wanted, trials, accepted)
        self.steps.append(Step(names, gap, last.judgement.alarms, listed, decision, last.judgement.critical_z))

    def _result(self, first: Pass, last: Pass, joint: bool, draws: int) -> Criticism:
        # All of one held-out part, though it may have become a shorter one on the way.
        heldout = slice(self.split, None)
        self.steps = [
            replace(step, gap=gap_of(*seen, heldout)) for step, seen in zip(self.steps, self.foreseen, strict=True)
        ]
        before, after, posterior = estimates(first.fit), estimates(last.fit), None
        model = last.fit.bound.model
        if joint and self.found:
            self.settings.tell("calibrating the final model")
            posterior = calibrate(
                self.log, model, draws=draws, metropolis_steps=_ROUNDS_OF_METROPOLIS,
                seed=self.settings.seed, progress=self.settings.progress,
            )  # fmt: skip
            after = drawn_estimates(last.fit, posterior)
        elif self.found:
            seed = self.settings.seed + 200
            after = estimates(
                quick_fit(last.fit.bound, seed, theta=last.fit.theta, path=last.fit.path, effort=LONG)
            )
        added = model.named_effects[len(self.base.effects) :]
        found = tuple(measured(one, effect, after, model.fixed) for one, effect in zip(self.found, added, strict=True))
        unexplained = unexplained_of(last, self.wanted)
        verdict = verdict_of(found, last.judgement)
        settings: dict[str, Any] = vars(self.settings) | {"split": self.split, "log": self.log.fingerprint()}
        del settings["workers"]  # the result does not depend on it
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
            log=self.log,
            split=self.split,
            first=first,
            last=last,
            posterior=posterior,
            notes=tuple(self.notes),
            settings=settings,
        )
