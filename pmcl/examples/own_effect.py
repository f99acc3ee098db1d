"""An effect of your own: a robot that pulls to one side whenever it accelerates.

An effect edits the coefficient tables of a model, which are plain numpy arrays (pmcl.models.tables describes them). The
command line takes this file with --effects:

    pmcl simulate amigobot --effects own_effect.py --effect torque-steer=0.6 -o log.nc
    pmcl criticize log.nc --effects own_effect.py -o critic.html

An installed package offers its effects to everyone by an entry point of the group "pmcl.effects".
"""

from typing import Any

import numpy as np
from scipy import stats

import pmcl
from pmcl.models.effects import Effect


def pulled(tables: Any, values: Any, log: pmcl.RobotLog, where: Any) -> Any:
    """Return the tables with the effect in them; those given stay as they are."""
    (pull,) = values  # in the order of `parameters` below
    mean = tables.motion.mean.copy()  # (T, 3): the increments that are expected, forward, left, turn [m, m, rad]
    mean[1:, 2] += pull * np.diff(mean[:, 0])
    return tables._replace(motion=tables.motion._replace(mean=mean))


TORQUE_STEER = Effect(
    name="torque-steer",
    summary="The robot pulls to one side whenever it accelerates.",
    symptom="After each change of speed the heading is off, in proportion to the change.",
    finding="accelerating turns the robot to the {0:left|right} by {0}",
    parameters=(pmcl.Parameter("torque_steer", "rad/m", stats.norm(scale=0.5), "turn per change of the forward step"),),
    null=(0.0,),  # the value at which there is no effect
    change=pulled,
    carrier="motion",  # what the effect is about: motion, range, landmark, sensor or map
    typical={"just visible": (0.1,), "clear": (0.5,), "large": (1.0,)},
    means_only=True,  # it moves what is expected, not how it scatters
)


def main(draws: int = 1000) -> None:
    """Simulate a robot with the effect, and calibrate a model that knows it."""
    log = pmcl.simulate_amigobot(300.0, seed=2, effects=[(TORQUE_STEER, [0.6])])
    model = pmcl.RobotModel(sensors=pmcl.default_model(log).sensors, effects=(TORQUE_STEER,))
    data = pmcl.calibrate(log, model, draws=draws)
    pull = data.posterior["torque_steer"]
    print(f"torque_steer = {float(pull.mean()):.2f} +- {float(pull.std()):.2f} rad/m; simulated with 0.6")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
