"""Whether robots localize better on a half of their drive that neither the critic nor a fit has seen.

    PMCL_DATA=/folder/with/recordings python other_half.py

The critic gets the first half of each drive and never reads motion capture. Filters with the base model and with the
final model then localize the robot on the second half, where their errors are measured. A robot that is in
other_half.csv is not criticised again.
"""

import csv
import os
import time

# Times are those of one core: threads of the linear algebra library would wait on a second one, and count as well.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from run import DATA, HERE, errors_of

from pmcl.criticism.workflow import criticize
from pmcl.logs.barfoot import read_barfoot
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog

RESULTS = HERE / "other_half.csv"
COLUMNS = (
    "robot", "model", "effects", "verdict", "cpu_seconds", "position_rmse", "heading_rmse", "log_score_per_reading",
)  # fmt: skip
# The folder of each Create's recording and its number there.
CREATES = {"Create 1": ("mrclam6", 1), "Create 2": ("mrclam6", 2), "Create 3": ("mrclam7", 3)}
# How long the first half of a drive is [s].
CREATE_HALF, LASER_HALF = 440.0, 630.0


def halves() -> dict[str, tuple[RobotLog, RobotLog]]:
    """Return the first and the second half of each drive."""
    both = {
        name: (
            read_mrclam(DATA / folder, robot, 0.5, duration=CREATE_HALF),
            read_mrclam(DATA / folder, robot, 0.5, begin=CREATE_HALF),
        )
        for name, (folder, robot) in CREATES.items()
    }
    recording = DATA / "lost_in_the_woods" / "dataset2.mat"
    both["laser robot"] = (
        read_barfoot(recording, 1.0, duration=LASER_HALF), read_barfoot(recording, 1.0, begin=LASER_HALF),
    )  # fmt: skip
    return both


def main() -> None:
    """Criticise the first halves that have no result yet, and localize on the second ones."""
    known: set[str] = set()
    if RESULTS.exists():
        with RESULTS.open(newline="") as file:
            known = {row["robot"] for row in csv.DictReader(file)}
    for name, (first, second) in halves().items():
        if name in known:
            continue
        begin = time.process_time()
        found = criticize(first, joint=False, workers=1)
        seconds = time.process_time() - begin
        effects = "; ".join(f"{one.name} ({one.probability:.2f})" for one in found.effects)
        rows = [
            [name, title, told, found.verdict, f"{seconds:.0f}", *errors_of(second, model, estimates)]
            for title, told, model, estimates in (
                ("base", "", found.base, found.before), ("final", effects, found.model, found.after),
            )
            if estimates  # none where nothing could be judged, because the filter loses the robot
        ]  # fmt: skip
        with RESULTS.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if file.tell() == 0:
                writer.writerow(COLUMNS)
            writer.writerows(rows)
        print(f"{name}, {seconds:.0f} s: {found.sentence}", flush=True)


if __name__ == "__main__":
    main()
