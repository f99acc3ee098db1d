"""The help of every command: whole sentences that are not cut, and the defaults that the code has."""

from __future__ import annotations

import inspect

import click
import pytest
from click.testing import CliRunner

import pmcl
from pmcl import defaults
from pmcl.calibration import ExpectationMaximisation, ParticleGibbs
from pmcl.cli.commands import pmcl as application
from pmcl.fleet import calibrate_fleet
from pmcl.logs import read_bag, read_barfoot, read_carmen, read_mrclam, read_wean


def _commands(group, path=()):
    for name, command in group.commands.items():
        yield (*path, name), command
        if isinstance(command, click.Group):
            yield from _commands(command, (*path, name))


COMMANDS = dict(_commands(application))
# What each command's options are passed to, by name.
FUNCTIONS = {
    ("calibrate",): pmcl.calibrate,
    ("fleet",): calibrate_fleet,
    ("localize",): pmcl.localize,
    ("criticize",): pmcl.criticize,
    ("simulate", "amigobot"): pmcl.simulate_amigobot,
    ("simulate", "aibo"): pmcl.simulate_aibo,
    ("convert", "mrclam"): read_mrclam,
    ("convert", "barfoot"): read_barfoot,
    ("convert", "bag"): read_bag,
    ("convert", "carmen"): read_carmen,
    ("convert", "wean"): read_wean,
}


def _options(path):
    """The options of a command, with those that it has of calibration methods."""
    command = COMMANDS[path]
    return command.get_params(click.Context(command))


def _help(*path):
    return CliRunner().invoke(application, [*path, "--help"], terminal_width=80).stdout


def test_the_lists_of_commands_are_not_cut():
    for path in ((), ("convert",), ("simulate",)):
        listed = _help(*path).partition("Commands:\n")[2]
        assert "..." not in listed
        assert listed.count(".\n") == len([p for p in COMMANDS if p[:-1] == path])


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_option_is_described(path):
    for option in _options(path):
        if isinstance(option, click.Option):
            assert option.help, option.name
            assert option.help.rstrip().endswith((".", "]")), option.help
    assert (COMMANDS[path].help or "").rstrip().endswith(".")


@pytest.mark.parametrize("path", FUNCTIONS, ids=" ".join)
def test_options_have_the_defaults_of_the_functions_they_set(path):
    signature = inspect.signature(FUNCTIONS[path]).parameters
    compared = 0
    for option in _options(path):
        if option.name in signature and isinstance(option, click.Option):
            default = signature[option.name].default
            stated = option.to_info_dict()["default"]
            if isinstance(default, int | float | str) and not isinstance(default, bool):
                told = (option.help or "").partition("[default: ")[2]
                in_text = told.startswith(str(default))
                assert stated == default or in_text, option.name
                compared += 1
    assert compared >= 2


def test_settings_without_a_default_of_their_own_say_what_they_become():
    shown = " ".join(_help("calibrate").split())
    methods = {kernel: ParticleGibbs(kernel=kernel) for kernel in ("conditional", "smoothing")}
    for name, method in {**methods, "em": ExpectationMaximisation()}.items():
        assert f"{method.usual_particles} for {name}" in shown
    assert "by the measured scatter of the evidence for ensemble" in shown
    assert "Sweeps from one stored draw to the next. [default: one or two, by the autocorrelation" in shown
    localized = " ".join(_help("localize").split())
    assert f"[default: {defaults.LOCALIZATION_DRAWS}]" in localized
    assert f"[default: {defaults.LOCALIZATION_DRAWS_PER_READING}]" in localized
