"""Starts that cannot be, densities that are no numbers, and chains that got lost."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from oracles.random_walk_model import BoundRailSensor, RailMotion, RailSensor, RailStart, rail_log, rail_model

from pmcl.calibration import ParticleGibbs
from pmcl.errors import DensityError, SamplingError
from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensor import sensor_of
from pmcl.sampling.ensemble import PseudoMarginalTarget
from pmcl.sampling.metropolis import update_theta
from pmcl.sampling.options import RunOptions
from pmcl.sampling.pseudo_marginal import BootstrapEvidence
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.state import from_blob, into_blob
from pmcl.sampling.sweep import SweepSettings, start_chain, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.tuning import lost_chains, restarted, tuned_schedule
from pmcl.simulations.landmark_field import simulate_landmark_field

T = 12
SHORT = ParticleGibbs(
    particles=10, burn_in_particles=50, data_rate=4, settling_sweeps=4, tuning_sweeps=(6,), sweeps_per_draw=1
)


class StrangeSensor(RailSensor):
    """A reading noise that is impossible, or no number, for some values of the parameter."""

    def __init__(self, impossible_below: float = 0.0, nan_above: float = np.inf) -> None:
        super().__init__()
        object.__setattr__(self, "limits", (impossible_below, nan_above))

    def bind(self, log: Any) -> Any:
        return BoundStrangeSensor(super().bind(log).reading, *self.limits)


class BoundStrangeSensor(BoundRailSensor):
    def __init__(self, reading: Any, impossible_below: float, nan_above: float) -> None:
        super().__init__(reading)
        object.__setattr__(self, "limits", (impossible_below, nan_above))

    def table(self, theta: Any) -> Any:
        low, high = self.limits
        table = super().table(theta)
        if theta[0] > high:
            return table._replace(std=float("nan"))
        # So far from every reading, and so sharp, that the density of each is exactly zero.
        return table._replace(reading=table.reading + 1e200, std=1e-3) if theta[0] < low else table


def _bound(sensor: RailSensor) -> Any:
    return RobotModel(RailMotion(), (sensor,), RailStart()).bind(rail_log(T, seed=4))


def test_an_impossible_theta_is_drawn_again_and_counted(caplog):
    """About half of the prior's draws lie below its median."""
    median = float(RailSensor().parameters[0].prior.median())
    bound = _bound(StrangeSensor(impossible_below=median))
    starts = [start_chain(bound, SweepSettings("smoothing", 30, data_rate=4), seed) for seed in range(60)]
    assert all(start.state.theta[1] > median for start in starts)
    assert all(np.isfinite(start.state.log_joint) for start in starts)
    # Redraws before a success of probability 1/2 have mean 1 and standard deviation sqrt 2.
    assert abs(np.mean([start.impossible_draws for start in starts]) - 1.0) < 5.0 * np.sqrt(2.0 / 60.0)
    with caplog.at_level(logging.WARNING, "pmcl.sampling"):
        chains = SHORT.run(bound, RunOptions(draws=5))
    assert chains.settings["impossible_starts"] > 0
    assert f"{chains.settings['impossible_starts']} draws of theta" in caplog.text


def test_a_start_that_is_impossible_everywhere_says_so_in_one_line():
    bound = _bound(StrangeSensor(impossible_below=np.inf))
    with pytest.raises(SamplingError, match="no start in 7 draws from the prior gives the first 4 rows") as caught:
        start_chain(bound, SweepSettings("smoothing", 30, data_rate=4), 1, attempts=7)
    assert "\n" not in str(caught.value)


def test_a_density_that_is_no_number_names_row_and_parameters():
    bound = _bound(StrangeSensor(nan_above=0.9))
    state = start_chain(bound, SweepSettings("smoothing", 30), 1).state
    bad = state._replace(theta=np.array([0.5, 1.25]))
    with pytest.raises(DensityError, match="at row 0 a density is not a number") as caught:
        step(bound, SweepSettings("conditional", 10), None, Unconstrained(bound.parameters), bad, 1)
    assert "process_std=0.5, reading_std=1.25" in str(caught.value)
    assert "t=0 s" in str(caught.value)
    assert "\n" not in str(caught.value)


def _starts(bound):
    start_chain(bound, SweepSettings("smoothing", 30), 1)


def _estimates_the_evidence(bound):
    PseudoMarginalTarget(BootstrapEvidence(bound), 20, 1)(np.array([0.5, 1.25]))


def _evaluates_the_linearised_evidence(bound):
    evidence = LinearisedEvidence(bound, np.array([0.5, 0.5]), [np.zeros((T, 1))])
    assert np.isfinite(evidence(np.array([0.5, 0.5])))
    evidence(np.array([0.5, 1.25]))


@pytest.mark.parametrize("fails", [_starts, _estimates_the_evidence, _evaluates_the_linearised_evidence])
def test_a_density_that_is_no_number_is_an_error_and_not_an_impossible_theta(fails):
    bound = _bound(StrangeSensor(nan_above=0.0 if fails is _starts else 0.9))
    with pytest.raises(DensityError, match=r"row 0.* a density is not a number|at row 0 a density") as caught:
        fails(bound)
    message = str(caught.value)
    assert "t=0 s" in message
    assert "reading_std=" in message
    assert "\n" not in message


def test_a_random_walk_that_meets_a_density_that_is_no_number_tells_where():
    """Such a proposal was refused like an unlikely one, so that the chain stayed below 0.9 without a word."""
    bound = _bound(StrangeSensor(nan_above=0.9))
    object.__setattr__(bound, "priors", None)
    state = start_chain(_bound(RailSensor()), SweepSettings("smoothing", 30), 1).state
    theta, path = np.array([0.5, 0.8]), [state.path]
    message = r"at t=0 s \(row 0\) a density is not a number with process_std="
    with pytest.raises(DensityError, match=message) as caught:
        update_theta(bound, theta, bound.tables(theta), path, np.log([0.1, 0.5]), 100, 0.0, make_rng(1))
    assert float(str(caught.value).partition("reading_std=")[2].partition(";")[0]) > 0.9


def test_a_random_walk_on_statistics_that_are_no_numbers_tells_where():
    bound = _bound(RailSensor())
    path = start_chain(bound, SweepSettings("smoothing", 30), 1).state.path.copy()
    path[3] = np.nan
    theta = np.array([0.5, 0.8])
    with pytest.raises(DensityError, match=r"\(row 3\) a density is not a number with process_std=0.5, reading_std="):
        update_theta(bound, theta, bound.tables(theta), [path], np.log([0.1, 0.5]), 5, 0.0, make_rng(1))


def test_a_sweep_in_which_every_particle_dies_keeps_the_path():
    """`smoothing` may lose every particle; the old trajectory stays, it is counted, and theta moves on."""
    bound = _bound(StrangeSensor(impossible_below=0.3))
    state = start_chain(bound, SweepSettings("smoothing", 30), 1).state
    doomed = state._replace(theta=np.array([0.5, 0.2]))
    settings = SweepSettings("smoothing", 10, metropolis_steps=0, transport_moves=0)
    new, _ = step(bound, settings, None, Unconstrained(bound.parameters), doomed, 1)
    assert new.failed_updates == state.failed_updates + 1
    np.testing.assert_array_equal(new.path, state.path)
    assert new.log_joint == -np.inf


def test_a_step_is_a_function_of_its_arguments():
    bound = rail_model().bind(rail_log(T, seed=4))
    state = start_chain(bound, SweepSettings("smoothing", 30), 1).state
    kept = state.path.copy()
    settings, transform = SweepSettings("conditional", 10, sweeps=3), Unconstrained(bound.parameters)
    first, second, other = (step(bound, settings, None, transform, state, seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.theta, second.theta)
    np.testing.assert_array_equal(first.path, second.path)
    assert (first.path != other.path).any()
    np.testing.assert_array_equal(state.path, kept)


class _Finished:
    """A backend with the blobs of a finished stage, and its chain where that counts."""

    def __init__(self, blobs: Any, chain: Any = None) -> None:
        self.blobs, self.chain = blobs, chain
        self.window = slice(-_tuning_stage().window, None)

    def get_blobs(self) -> Any:
        return self.blobs

    def get_chain(self) -> Any:
        return self.chain


def _stage_blobs(evidence: Any, rows: Any) -> Any:
    evidence = np.asarray(evidence, dtype=float)
    blobs = np.zeros(evidence.shape, dtype=[("log_evidence", float), ("rows", int)])
    blobs["log_evidence"] = evidence
    blobs["rows"] = rows
    return blobs


def _tuning_stage() -> Any:
    method = ParticleGibbs(tuning_sweeps=(20, 20), particles=25, transport_moves=6, data_rate=1)
    return method.stages(T, RunOptions())[1]


def test_a_lost_chain_is_found_and_restarted_from_the_best(rng, caplog):
    evidence = rng.normal([-100.0, -102.0, -900.0, -101.0], 1.0, (20, 4))
    with caplog.at_level(logging.WARNING, "pmcl.sampling"):
        lost = lost_chains(_Finished(_stage_blobs(evidence, T)), _tuning_stage(), T)
    assert list(lost) == [2]
    assert lost[2] in (0, 3)
    assert "chain 2 is lost" in caplog.text


def test_chains_that_scatter_are_not_lost(rng):
    evidence = rng.normal([-100.0, -110.0, -130.0, -95.0], 10.0, (20, 4))
    assert lost_chains(_Finished(_stage_blobs(evidence, T)), _tuning_stage(), T) == {}


def test_sweeps_without_an_estimate_say_nothing_about_lost_chains(rng, caplog):
    """Of chain 2 nothing is known; chain 1 is lost by the estimates that it has."""
    evidence = rng.normal([-100.0, -900.0, -101.0, -102.0], 1.0, (20, 4))
    evidence[rng.random((20, 4)) < 0.5] = np.nan
    evidence[:, 2] = np.nan
    assert list(lost_chains(_Finished(_stage_blobs(evidence, T)), _tuning_stage(), T)) == [1]
    assert "chain 1 is lost: its log evidence lies" in caplog.text


def test_without_any_estimate_only_a_chain_that_could_not_include_all_rows_is_lost():
    evidence = np.full((20, 3), np.nan)
    assert lost_chains(_Finished(_stage_blobs(evidence, T)), _tuning_stage(), T) == {}
    lost = lost_chains(_Finished(_stage_blobs(evidence, [T - 3, T, T])), _tuning_stage(), T)
    assert list(lost) == [0]
    assert lost[0] in (1, 2)


def _of_all_lengths(share):
    """The share of rows redrawn, half of them in blocks 2, 2, 4 and 8 times as long, if short ones have `share`."""
    return (4.0 * share + 2.0 * share**2 + share**4 + share**8) / 8.0


@pytest.mark.parametrize(
    ("jumps", "blocks", "schedule"),
    [
        (0.6, 0.9, Schedule(moves=3, walk_share=0.02, path_share=0.1, redraw_share=0.5)),
        (0.6, 0.5, Schedule(moves=3, walk_share=0.02, path_share=0.1, block=18)),
        (0.8, 0.9, Schedule(moves=2, walk_share=0.02, path_share=0.1, redraw_share=0.5)),
        (0.48, 0.75, Schedule(moves=3, walk_share=0.02, path_share=0.1, redraw_share=0.5)),
        (0.3, 0.9, Schedule(walk_share=0.02, path_share=0.1, redraw_share=0.5)),
        (0.6, 0.1, Schedule(moves=3, walk_share=0.02, block=5, stretched=False)),
        (0.3, 0.13, Schedule(walk_share=0.02, block=6, stretched=False)),
        (0.3, 1e-6, Schedule(walk_share=0.02, block=4, stretched=False)),
        (1.0, 1.0, Schedule(moves=2, walk_share=0.02, path_share=0.1, redraw_share=0.5)),
        (0.05, 0.9, Schedule()),
        (np.nan, np.nan, Schedule()),
    ],
)
def test_the_schedule_follows_how_often_moves_were_accepted(jumps, blocks, schedule):
    """Only the window counts, and sweeps that made no such move do not."""
    rates = np.zeros((20, 2), dtype=[("transport_jump_rate", float), ("path_block_redraw_rate", float)])
    rates["transport_jump_rate"][10:], rates["path_block_redraw_rate"][10:] = jumps, _of_all_lengths(blocks)
    rates["transport_jump_rate"][15] = np.nan
    assert tuned_schedule(_Finished(rates, np.zeros((20, 4, 2))), Schedule()) == schedule


def test_between_walls_particles_seldom_draw_the_path():
    """Blocks of six rows are accepted there as often as they should be."""
    rates = np.zeros((20, 2), dtype=[("transport_jump_rate", float), ("path_block_redraw_rate", float)])
    rates["transport_jump_rate"], rates["path_block_redraw_rate"] = 0.33, 0.56
    found = tuned_schedule(_Finished(rates, np.zeros((20, 4, 2))), Schedule(block=6, stretched=False))
    assert found == Schedule(moves=5, walk_share=0.02, path_share=0.1, block=5, stretched=False)


@pytest.mark.parametrize(("correlation", "sweeps"), [(0.0, 1), (0.85, 2), (0.98, 2)])
def test_a_draw_has_two_sweeps_where_the_chain_forgets_slowly(correlation, sweeps, rng):
    """Autoregressive chains have an autocorrelation time of (1 + r) / (1 - r): 1, 12 and 99."""
    noise = rng.standard_normal((120, 4, 2))
    chain = noise.copy()
    for t in range(1, 120):
        chain[t, :, 1] = correlation * chain[t - 1, :, 1] + np.sqrt(1.0 - correlation**2) * noise[t, :, 1]
    chain[:, :, 0] = 1.0  # a parameter that did not move
    rates = np.zeros((120, 4), dtype=[("transport_jump_rate", float), ("path_block_redraw_rate", float)])
    assert tuned_schedule(_Finished(rates, chain), Schedule()).sweeps == sweeps
    assert tuned_schedule(_Finished(rates, chain[:20]), Schedule()).sweeps == Schedule().sweeps
    rates["transport_jump_rate"], rates["path_block_redraw_rate"] = 0.33, 0.56
    assert tuned_schedule(_Finished(rates, chain), Schedule(block=6, stretched=False)).sweeps == sweeps


def test_blocks_stay_as_long_as_they_are_where_as_many_as_should_be_are_accepted():
    rates = np.zeros((20, 2), dtype=[("transport_jump_rate", float), ("path_block_redraw_rate", float)])
    rates["path_block_redraw_rate"] = _of_all_lengths(0.6)
    for block in (4, 9, 24):
        assert tuned_schedule(_Finished(rates, np.zeros((20, 4, 2))), Schedule(block=block)).block == block


def test_a_chain_that_could_not_include_all_rows_is_lost(rng):
    evidence = rng.normal(-100.0, 1.0, (20, 3))
    evidence[:, 1] = -np.inf
    assert list(lost_chains(_Finished(_stage_blobs(evidence, [T, T - 3, T])), _tuning_stage(), T)) == [1]


def test_if_every_chain_is_stuck_the_row_is_named(rng):
    evidence = np.full((20, 2), -np.inf)
    with pytest.raises(SamplingError, match=f"no chain got past row 9 of {T}"):
        lost_chains(_Finished(_stage_blobs(evidence, [9, 4])), _tuning_stage(), T)


def test_a_restarted_chain_is_a_copy_of_its_own():
    bound = rail_model().bind(rail_log(T, seed=4))
    from emcee.state import State

    from pmcl.sampling.move import ParticleGibbsMove

    dtype = ParticleGibbsMove(bound).dtype
    starts = [start_chain(bound, SweepSettings("smoothing", 30), seed) for seed in range(3)]
    states = [start.state for start in starts]
    blobs = np.array([into_blob(start.state, start.info, dtype) for start in starts], dtype=dtype)
    coords, log_prob = np.array([s.theta for s in states]), np.array([s.log_joint for s in states])
    new = restarted(State(coords, log_prob=log_prob, blobs=blobs, random_state=None), {0: 2})
    np.testing.assert_array_equal(new.coords, coords[[2, 1, 2]])
    np.testing.assert_array_equal(new.log_prob, log_prob[[2, 1, 2]])
    copied = from_blob(new.coords[0], new.blobs[0])
    np.testing.assert_array_equal(copied.path, states[2].path)
    new.blobs["path"][0] += 1.0
    np.testing.assert_array_equal(new.blobs["path"][2], states[2].path)


def test_linearised_readings_are_fitted_to_the_paths_of_each_window(monkeypatch):
    """Six and twenty of each of two chains; without transport moves no path of burn-in is kept."""
    log = simulate_landmark_field(30, 1)
    bound, asked = default_model(log).bind(log), []
    room = sensor_of(bound.tables(bound.prior_mean())[0].sensors[0])
    fitted = room.fitted_linearisation

    def counted(table, linearisation, reference, paths):
        asked.append(len(paths))
        assert np.abs(paths.mean(axis=0) - reference).max() < 1e-5
        return fitted(table, linearisation, reference, paths)

    monkeypatch.setattr(room, "fitted_linearisation", staticmethod(counted))
    method = ParticleGibbs(
        particles=10, burn_in_particles=50, data_rate=10, settling_sweeps=4, tuning_sweeps=(12, 24)
    )
    method.run(bound, RunOptions(draws=4, chains=2, seed=1, trajectories=1))
    assert asked == [6, 6, 20, 20]
    stages = replace(method, transport_moves=0).stages(30, RunOptions(draws=4, chains=2))
    assert [stage.keep_every for stage in stages[:-1]] == [0, 0, 0]
