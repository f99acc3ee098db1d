"""Every command that takes a log warns of its mistakes, and a posterior keeps them."""

from __future__ import annotations

import json
import logging

import pytest
from oracles import mistakes

import pmcl.calibration.workflow
import pmcl.cli.convert
import pmcl.criticism.workflow
from pmcl.simulations.landmark_field import simulate_landmark_field


class ReachedSampling(Exception):
    """Raised in place of what would take long."""


@pytest.fixture(scope="module")
def wrong_log():
    return mistakes.turn_sign_flipped(simulate_landmark_field(60, 13, bearings=True))


def test_calibrate_warns_before_it_samples_and_keeps_what_was_found(wrong_log, monkeypatch, caplog):
    def stop(method, bound, options):
        assert "turn-sign-flipped" in caplog.text
        raise ReachedSampling(options.attributes["preflight"])

    monkeypatch.setattr(pmcl.ParticleGibbs, "run", stop)
    with caplog.at_level(logging.WARNING, "pmcl"), pytest.raises(ReachedSampling) as reached:
        pmcl.calibration.workflow.calibrate(wrong_log)
    (finding,) = json.loads(str(reached.value))
    assert (finding["name"], finding["level"], finding["mistake"]) == ("turn-sign-flipped", "implausible", True)


def test_criticize_warns_before_it_fits(wrong_log, monkeypatch, caplog):
    def stop(*given):
        raise ReachedSampling

    monkeypatch.setattr("pmcl.criticism.lost_filter.Search", stop)
    with caplog.at_level(logging.WARNING, "pmcl"), pytest.raises(ReachedSampling):
        pmcl.criticism.workflow.criticize(wrong_log)
    assert "turn-sign-flipped" in caplog.text


def test_convert_warns_and_writes_all_the_same(wrong_log, tmp_path, caplog):
    with caplog.at_level(logging.WARNING, "pmcl"):
        pmcl.cli.convert.write_log(wrong_log, tmp_path / "log.nc")
    assert f"{tmp_path / 'log.nc'}: the turns of the odometry seem to have the wrong sign" in caplog.text
    assert (tmp_path / "log.nc").exists()
