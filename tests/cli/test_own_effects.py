"""Effects of one's own on the command line: --effects makes their names known to every command."""

from __future__ import annotations

import pytest

from pmcl.examples import example_text
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects import CATALOGUE, known_effects


@pytest.fixture
def effects_file(tmp_path):
    path = tmp_path / "own_effect.py"
    path.write_text(example_text("own_effect"), encoding="utf-8")
    return path


def test_own_effects_are_listed_and_described(run, effects_file):
    listed = run("effects", "--effects", effects_file)
    assert "  torque-steer: The robot pulls" in listed.stdout
    described = run("effects", "torque-steer", "--effects", effects_file)
    assert "torque_steer [rad/m]: turn per change of the forward step (0.1, 0.5, 1)" in described.stdout
    assert known_effects() == CATALOGUE, "after a command nothing is left behind"


def test_own_effects_can_be_simulated_and_stand_in_model_files(run, effects_file, tmp_path):
    log_file, model_file = tmp_path / "steered.nc", tmp_path / "model.toml"
    done = run(
        "simulate", "amigobot", "--duration", 30, "--effects", effects_file, "--effect", "torque-steer=0.6",
        "-o", log_file,
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert RobotLog.read(log_file).true_theta["torque_steer"] == 0.6
    model_file.write_text("[[effects]]\nname = 'torque-steer'\n")
    printed = run("calibrate", log_file, "--model", model_file, "--effects", effects_file, "--print-model")
    assert 'name = "torque-steer" # The robot pulls' in printed.stdout
    assert "[priors.torque_steer]" in printed.stdout


def test_without_the_file_the_name_is_unknown(refused, log_file, effects_file, tmp_path):
    output = tmp_path / "log.nc"
    message = refused("simulate", "amigobot", "--effect", "torque-steer=0.6", "-o", output)
    assert "--effects FILE.py adds your own" in message
    effects_file.write_text("import nothing_of_that_name\n")
    message = refused("criticize", log_file, "--effects", effects_file, "-o", tmp_path / "page.html")
    assert "own_effect.py, line 1: expected Python code that runs, but got ModuleNotFoundError" in message


@pytest.mark.long
def test_the_critic_finds_an_effect_of_ones_own(run, effects_file, tmp_path):
    log_file, page = tmp_path / "steered.nc", tmp_path / "page.html"
    run(
        "simulate", "amigobot", "--seed", 2, "--effects", effects_file, "--effect", "torque-steer=1.0",
        "--hide-effects", "-o", log_file,
    )  # fmt: skip
    done = run("criticize", log_file, "--effects", effects_file, "--no-joint", "-o", page)
    assert done.exit_code == 0, done.stderr
    assert "ccelerating turns the robot to the left" in done.stdout
