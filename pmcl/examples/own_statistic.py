"""A statistic of your own: do two beams err together? It becomes an alarm of the critic.

The critic tests many numbers by itself, but none about this pair of beams. A statistic is a function from the residuals
of a log to numbers, whose sum is compared with that of logs which the fitted model simulates (pmcl.criticism.Residuals
says what it gets). The command line takes this file with --effects:

    pmcl criticize log.nc --effects own_statistic.py -o critic.html
"""

import numpy as np

import pmcl
from pmcl.criticism import Residuals, Statistic

PAIR = (0, 5)  # two sonars that look to opposite sides


def product(residuals: Residuals) -> np.ndarray:
    """Return the product of the two beams' residuals at each row; NaN where one of them was not read."""
    table = np.full((residuals.n_rows, 2), np.nan)
    for column, beam in enumerate(PAIR):
        of_beam = (residuals.kind == "range") & (residuals.channel == beam)
        table[residuals.row[of_beam], column] = residuals.residual[of_beam]
    return table[:, 0] * table[:, 1]


PAIRED_BEAMS = Statistic(
    name="paired-beams",
    summary="Two beams on opposite sides err together, or against each other.",
    of=product,
    per="row",  # one number for each row of the log; "reading" is for one number for each reading
)


def record(correlation: float, duration: float = 200.0, seed: int = 2) -> pmcl.RobotLog:
    """Simulate a robot of which these two beams err together, but each as much as all others."""
    noise = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
    log = pmcl.simulate_amigobot(duration, seed, noise)
    ideal = pmcl.simulate_amigobot(duration, seed, {**noise, "sigma_range": 1e-6}).ranges
    assert log.ranges is not None
    assert ideal is not None
    ranges = log.ranges.copy()
    own, other = (ranges[:, beam] - ideal[:, beam] for beam in PAIR)
    ranges[:, PAIR[1]] = ideal[:, PAIR[1]] + correlation * own + np.sqrt(1.0 - correlation**2) * other
    return pmcl.RobotLog(log.dataset.assign(range=(("time", "beam"), np.clip(ranges, 0.0, log.max_range))))


def main(draws: int = 500) -> None:
    """Ask the critic about such a robot."""
    for correlation in (0.0, 0.8):
        found = pmcl.criticize(record(correlation), statistics=[PAIRED_BEAMS], joint=False, rounds=1, draws=draws)
        (alarm,) = (alarm for alarm in found.steps[0].alarms if alarm.family == PAIRED_BEAMS.name)
        print(f"errors with a correlation of {correlation}: p = {alarm.p_value:.1e}; {found.verdict}")


if __name__ == "__main__":
    main()
