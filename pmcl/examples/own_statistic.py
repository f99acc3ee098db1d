"""A statistic of your own: are ranges off when the robot's arm leans? It becomes an alarm of the critic.

The critic tests many numbers by itself, but knows nothing of the arm. A statistic is a function from the residuals of a
log to numbers, whose sum is compared with that of logs which the fitted model simulates (pmcl.criticism.Residuals says
what it gets). The command line takes this file with --effects:

    pmcl criticize log.nc --effects own_statistic.py -o critic.html
"""

import numpy as np

import pmcl
from pmcl.criticism import Residuals, Statistic


def lean(time: np.ndarray) -> np.ndarray:
    """Return whether the arm leans back (1) or forward (-1) at times [s]; look it up where you have recorded it."""
    return np.asarray(np.sign(np.sin(time / 3.1) + np.sin(time / 2.3)))


def with_lean(residuals: Residuals) -> np.ndarray:
    """Return the residual of each range reading with the sign of the lean; NaN, which counts as nothing, for others."""
    return np.where(residuals.kind == "range", residuals.residual * lean(residuals.time), np.nan)


ARM_LEANS = Statistic(
    name="arm-leans",
    summary="Ranges are longer while the arm leans back than while it leans forward.",
    of=with_lean,
    per="reading",  # one number for each reading; "row" is for one number for each row of the log
)


def record(tilt: float, duration: float = 200.0, seed: int = 5) -> pmcl.RobotLog:
    """Simulate a robot whose ranges are longer by `tilt` [m] while the arm leans back, and as much shorter else."""
    noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
    log = pmcl.simulate_amigobot(duration, seed, noise)
    ranges = log.dataset["range"]
    shifted = ranges.values + tilt * lean(log.times)[:, None]
    return pmcl.RobotLog(log.dataset.assign(range=ranges.copy(data=np.clip(shifted, 0.0, log.max_range))))


def main(draws: int = 500) -> None:
    """Ask the critic about a robot without and with such an arm."""
    for tilt in (0.0, 0.03):
        found = pmcl.criticize(record(tilt), statistics=[ARM_LEANS], joint=False, rounds=1, draws=draws)
        (alarm,) = (alarm for alarm in found.steps[0].alarms if alarm.family == ARM_LEANS.name)
        print(f"ranges off by {tilt} m: p = {alarm.p_value:.1e}; {found.verdict}")


if __name__ == "__main__":
    main()
