"""What the critic says of three recorded robots, and whether their filters localize better for it.

    PMCL_DATA=/folder/with/recordings python run.py

Two Creates of one fleet (UTIAS MRCLAM, data set 6) and a robot with a laser (Lost in the Woods). The critic never reads
motion capture; the last column of results.csv does. A robot whose JSON file is there is not criticised again.
"""

import csv
import json
import os
import time
from pathlib import Path

import numpy as np

from pmcl.criticism.workflow import criticize
from pmcl.errors import FilterError
from pmcl.localization.many import localize_many
from pmcl.logs.barfoot import read_barfoot
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog

HERE = Path(__file__).parent
DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
REPETITIONS, PARTICLES = 20, 1000


def recordings() -> dict[str, RobotLog]:
    """Return the three logs."""
    return {
        "Create 1": read_mrclam(DATA / "mrclam6", 1, 0.5),
        "Create 2": read_mrclam(DATA / "mrclam6", 2, 0.5),
        "laser robot": read_barfoot(DATA / "lost_in_the_woods" / "dataset2.mat", 1.0),
    }


def main() -> None:
    """Criticise what has no result yet."""
    for name, log in recordings().items():
        path = HERE / f"{name.replace(' ', '_').lower()}.json"
        if path.exists():
            continue
        begin = time.perf_counter()
        try:
            found = criticize(log, draws=250)
        except FilterError as error:
            # No made-up name where the base model cannot follow the robot.
            sentence = str(error).removeprefix(f"{log.where}: ")
            path.write_text(json.dumps({"verdict": "refused", "sentence": sentence, "effects": [], "steps": []}) + "\n")
            print(f"{name}: {sentence}", flush=True)
            continue
        seconds = time.perf_counter() - begin
        rows = []
        for title, model, estimates in (("base", found.base, found.before), ("final", found.model, found.after)):
            theta = {key: estimates[key].mean for key in model.bind(log).names}
            runs = localize_many(log, model, theta=theta, repetitions=REPETITIONS, particles=PARTICLES)
            rows.append([name, title, f"{seconds:.0f}", *(f"{np.nanmean(v):.4f}" for v in (
                runs.position_rmse, runs.heading_rmse, runs.log_evidence / log.n_readings))])  # fmt: skip
        with (HERE / "errors.csv").open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if file.tell() == 0:
                writer.writerow(["robot", "model", "seconds", "position_rmse", "heading_rmse", "log_score_per_reading"])
            writer.writerows(rows)
        path.write_text(json.dumps(json.loads(found.to_json()), separators=(",", ":")) + "\n")
        print(f"{name}, {seconds:.0f} s: {found.sentence}", flush=True)


if __name__ == "__main__":
    main()
