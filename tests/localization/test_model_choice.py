"""Which model a posterior belongs to that does not hold its model: the one that has its parameters."""

from __future__ import annotations

import numpy as np
import pytest
from localization.posteriors import made_posterior

from pmcl.localization.model_choice import model_for
from pmcl.models.motions.increments.motion import GrowingIncrementNoise, IncrementNoise
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensors.range_beams.sensor import RangeNoise


@pytest.mark.parametrize("motion", [IncrementNoise(), GrowingIncrementNoise()], ids=["constant", "growing"])
@pytest.mark.parametrize("outliers", [False, True])
def test_the_parameters_tell_motion_and_outliers(room_log, motion, outliers):
    model = RobotModel(motion, (RangeNoise(outliers),))
    names = [parameter.name for parameter in model.parameters]
    chosen = model_for(room_log, made_posterior(names[::-1], np.full((1, 2, len(names)), 0.1)))
    assert type(chosen.motion) is type(motion)
    assert chosen.sensors == model.sensors


def test_unknown_parameters_leave_the_default_model(room_log):
    assert model_for(room_log, made_posterior(("sigma_x",), np.full((1, 2, 1), 0.1))).sensors == (RangeNoise(),)
