"""What a run of the critic ends with: the final model's parameters, when its effects act, and the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pmcl.calibration.particle_gibbs import ParticleGibbs
from pmcl.calibration.workflow import calibrate
from pmcl.criticism.findings.assemble import (
    drawn_estimates,
    estimates,
    unexplained_of,
    with_estimates_of,
    with_window,
)
from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.findings.verdict import UNKNOWN, sentence_of, verdict_of, with_place
from pmcl.criticism.fitting.next_drive import next_drive
from pmcl.criticism.fitting.quick_fit import LONG, Fit, quick_fit
from pmcl.criticism.fitting.when import Acting, acting
from pmcl.criticism.naming.probability import unknown_without_refits
from pmcl.criticism.naming.revision import Answer
from pmcl.criticism.scoring.scores import Direction
from pmcl.criticism.state import State, Task
from pmcl.errors import FilterError, SamplingError
from pmcl.filtering.estimated_path import with_estimates
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import path_formulas, portable
from pmcl.posterior import diagnostics
from pmcl.posterior.compat import Posterior
from pmcl.streams import stream_seed

__all__ = ["concluded"]

# Parameters of effects cost a density of the whole log for each proposal, and transport moves change them as well.
_METROPOLIS_STEPS = 2


def concluded(task: Task, state: State, *, draws: int = 0) -> Criticism:
    """Return the result of a run.

    Parameters
    ----------
    task : Task
        What was criticised.
    state : State
        What the loop ended with.
    draws : int
        Draws of each full chain of the final model; 0 for one longer chain instead.
    """
    settings, fit = task.search.settings, state.judged.fit
    before, after, posterior = estimates(state.first.fit), estimates(fit), None
    added_effects = [answer.found for answer in state.answers]
    verdict = verdict_of(added_effects, state.judged.judgement, _something_missing(state, task.search.directions))
    loss_remains = task.loss is not None and (task.loss.partial or not added_effects)
    if loss_remains:
        verdict = UNKNOWN
    if draws:
        # What takes the longest comes last; it changes no name.
        names = ", ".join(with_place(found) for found in added_effects)
        settings.tell(f"verdict: {verdict}" + (f" ({names})" if names else ""))
        posterior, notes = _calibrated(task, fit, draws)
        state = state.noted(*notes)
    if posterior is not None:
        after = drawn_estimates(fit, posterior)
    elif state.answers:
        seed = stream_seed(settings.seed, "long fit")
        after = estimates(quick_fit(fit.bound, seed, theta=fit.theta, path=fit.path, draws=fit.draws, effort=LONG))
    model = fit.bound.model
    added = model.named_effects[len(task.base.effects) :]
    windows = _windows(task, fit, added)
    found = tuple(
        with_window(with_estimates_of(_with_drive(task, answer), effect, after, model.fixed), effect, window)
        for answer, effect, window in zip(state.answers, added, windows, strict=True)
    )
    unexplained = unexplained_of(state.judged, task.search.directions)
    lost = ""
    if task.loss is not None and loss_remains:
        lost, unexplained = task.loss.what, (task.loss.place, *unexplained)
    # The model that is handed over applies to other logs as well: its formulas are evaluated anew on each.
    model = replace(model, effects=tuple(portable(effect) for effect in model.effects))
    return Criticism(
        verdict=verdict,
        sentence=sentence_of(verdict, found, unexplained, state.steps, before, after, task.log, lost),
        effects=found,
        unexplained=unexplained,
        steps=state.steps,
        base=task.base,
        model=model,
        before=before,
        after=after,
        log=_with_path(task.log, fit, model.effects),
        split=task.split,
        held_out=task.other,
        first=state.first,
        last=state.judged,
        posterior=posterior,
        notes=state.notes,
        settings=settings.recorded(task.split, task.log.fingerprint(), task.other),
        nothing_probability=state.nothing_probability,
    )


def _something_missing(state: State, directions: Sequence[Direction]) -> float:
    """Return the probability that the final model lacks something; beside accepted effects it follows from alarms."""
    if state.answers:
        return unknown_without_refits(state.judged.judgement, directions)
    return 1.0 - state.nothing_probability


def _calibrated(task: Task, fit: Fit, draws: int) -> tuple[Posterior | None, tuple[str, ...]]:
    """Run full chains of the final model; return None, with a note why, if they lose the robot.

    A note also tells if they have not converged: intervals of such a posterior cannot be relied on.
    """
    settings = task.search.settings
    settings.tell("calibrating the final model by full chains")
    reporter = settings.reporter
    try:
        with reporter.paused():
            posterior = calibrate(
                task.log, fit.bound.model, draws=draws, method=ParticleGibbs(metropolis_steps=_METROPOLIS_STEPS),
                seed=settings.seed, progress=reporter.live,
            )  # fmt: skip
    except (FilterError, SamplingError) as error:
        return None, (f"there is no posterior by full chains: {error}",)
    judged = diagnostics.verdict(posterior)
    return posterior, () if judged.converged else (f"full chains of the final model: {judged.message}",)


def _windows(task: Task, fit: Fit, added: Sequence[Effect]) -> list[Acting | None]:
    """Return when each added effect acts, given a fit of the final model to the whole log."""
    settings = task.search.settings
    if added:
        settings.tell("looking for when each effect acts")
    seed = stream_seed(settings.seed, "windows of effects")

    def find(k: int) -> Acting | None:
        return acting(fit, added[k], seed=seed)

    return settings.mapped(find, "windows of effects", [effect.name for effect in added])


def _with_drive(task: Task, answer: Answer) -> FoundEffect:
    """Return a found effect with the drive that would tell it from its near twins, if it has some."""
    found, credible = answer
    if not found.not_distinguishable_from:
        return found
    settings = task.search.settings
    settings.tell(f"looking for the drive that would tell {found.name} from its near twins")
    seed = stream_seed(settings.seed, "what to record next")
    return replace(found, record_next=next_drive(credible, task.log, particles=settings.particles, seed=seed))


def _with_path(log: RobotLog, fit: Fit, effects: Sequence[Effect]) -> RobotLog:
    """Return the log, with the path of a fit where formulas of the path need it."""
    return with_estimates(log, fit.tables, fit.path) if path_formulas(effects) else log
