"""What the critic says of recorded robots, and whether their filters localize better for it.

    PMCL_DATA=/folder/with/recordings python run.py

Two Creates of one fleet (UTIAS MRCLAM, data set 6), a third one of another recording (data set 7), a robot with a laser
(Lost in the Woods), and Jarvis, a tricycle with a lidar in a laboratory of which there is a grid map: as recorded, and
with a mount of the lidar that is stated wrongly. The critic never reads the reference trajectory; errors.csv and
true_path.csv do. A robot whose JSON file is there is not criticised again.
"""

import csv
import json
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pmcl.criticism.findings.parts import Estimate
from pmcl.criticism.fitting.quick_fit import LONG, quick_fit
from pmcl.criticism.fitting.starting_point import starting_point
from pmcl.criticism.workflow import criticize
from pmcl.localization.many import localize_many
from pmcl.logs.bags.read import read_bag
from pmcl.logs.barfoot import read_barfoot
from pmcl.logs.mrclam import read_mrclam
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import RobotModel, default_model

HERE = Path(__file__).parent
DATA = Path(os.environ.get("PMCL_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
REPETITIONS, PARTICLES = 20, 1000
# Scans and reference fit each other when the stamps of the reference system are moved by so much [s]. Errors are also
# computed with the stamps as recorded.
REFERENCE_EARLY = 0.09
# What is added to the recorded mount of Jarvis' lidar (x, y, yaw) [m, m, rad].
WRONG_MOUNT = (0.0, 0.1, 0.05)
# Jarvis' scans become rows after 0.1 m or 0.1 rad, so that a drive of 70 s has 154 of them.
STEP = 0.1
# The map lacks furniture, so that the critic may add more effects than usual; one chain gives their parameters.
SETTINGS = {name: {"rounds": 6, "joint": False} for name in ("Jarvis", "Jarvis, wrong mount")}


def read_jarvis(shift: float) -> RobotLog:
    """Return the log of Jarvis, with the reference system's stamps moved by so many seconds."""
    return read_bag(
        DATA / "jarvis" / "jarvis_complex_path_fast.bag", scans=("/driver_laser_navigation/laser_scan",),
        truth="/pose_ground_truth", truth_to_map=(14.617, 3.361, -0.033), truth_shift=shift, update_min_d=STEP,
        update_min_a=STEP, grid_map=OccupancyGrid.read(DATA / "jarvis" / "i-108_10mm.yaml"),
    )  # fmt: skip


def with_recorded_stamps(log: RobotLog) -> RobotLog:
    """Return a log of Jarvis with a reference trajectory by the stamps as recorded; nothing else changes."""
    other, poses = read_jarvis(0.0).dataset, log.dataset["true_pose"].copy()
    later = float(other.attrs["time_origin"] - log.dataset.attrs["time_origin"])
    recorded = other["true_pose"].assign_coords(time=other["time"].values + later)
    poses[:] = recorded.reindex(time=log.dataset["time"].values, method="nearest").values
    return RobotLog.from_dataset(log.dataset.assign(true_pose=poses), log.where, log.grid_map)


def recordings() -> dict[str, RobotLog]:
    """Return the logs."""
    jarvis = read_jarvis(REFERENCE_EARLY)
    wrong = jarvis.dataset.copy()
    wrong["scan"] = wrong["scan"].assign_attrs(pose=np.add(wrong["scan"].attrs["pose"], WRONG_MOUNT))
    return {
        "Jarvis": RobotLog.from_dataset(jarvis.dataset, "Jarvis", jarvis.grid_map),
        "Jarvis, wrong mount": RobotLog.from_dataset(wrong, "Jarvis, wrong mount", jarvis.grid_map),
        "Create 1": read_mrclam(DATA / "mrclam6", 1, 0.5),
        "Create 2": read_mrclam(DATA / "mrclam6", 2, 0.5),
        "Create 3": read_mrclam(DATA / "mrclam7", 3, 0.5),
        "laser robot": read_barfoot(DATA / "lost_in_the_woods" / "dataset2.mat", 1.0),
    }


def along_the_true_path(log: RobotLog) -> tuple[float, float]:
    """Return how far the robot slides to its left for each metre ahead, and the median error of bearings [rad].

    Both with motion capture's heading, whose zero is where its markers were said to point.
    """
    pose, mount = log.dataset["true_pose"].values, log.dataset["landmark_sensor_pose"].values
    turn = np.mod(np.diff(pose[:, 2]) + np.pi, 2 * np.pi) - np.pi
    middle = pose[:-1, 2] + 0.5 * turn
    step = np.diff(pose[:, :2], axis=0)
    ahead = np.cos(middle) * step[:, 0] + np.sin(middle) * step[:, 1]
    left = np.cos(middle) * step[:, 1] - np.sin(middle) * step[:, 0]
    # Steps that are nearly straight; a turning robot slides by the mount of its markers, too.
    used = np.isfinite(left) & (log.odometry[1:, 0] > 0.02) & (np.abs(log.odometry[1:, 2]) < 0.02)
    heading = pose[:, 2][:, None]
    x = pose[:, 0][:, None] + mount[0] * np.cos(heading) - mount[1] * np.sin(heading)
    y = pose[:, 1][:, None] + mount[0] * np.sin(heading) + mount[1] * np.cos(heading)
    at = log.landmarks.positions
    error = log.dataset["landmark_bearing"].values - np.arctan2(at[:, 1] - y, at[:, 0] - x) + heading - mount[2]
    return left[used].sum() / ahead[used].sum(), float(np.nanmedian(np.mod(error + np.pi, 2 * np.pi) - np.pi))


def errors_of(log: RobotLog, model: RobotModel, estimates: Mapping[str, Estimate]) -> list[str]:
    """Localize with the means of the parameters; return errors of position and heading, and the score of a reading."""
    theta = {key: estimates[key].mean for key in model.bind(log).names}
    runs = localize_many(log, model, theta=theta, repetitions=REPETITIONS, particles=PARTICLES)
    values = runs.position_rmse, runs.heading_rmse, runs.log_evidence / log.n_readings
    return [f"{np.nanmean(value):.4f}" for value in values]


def mount_of(log: RobotLog) -> list[str]:
    """Return mean and standard deviation of angle and shift of the mount, fitted together with a latency."""
    model = default_model(log)
    fit = quick_fit(model.bind(log.without_truth()), seed=1)
    for name in ("sensor-latency", "sensor-yaw", "sensor-offset"):
        (effect,) = effect_named(name).instances(log)
        model = replace(model, effects=(*model.effects, effect))
        bound = model.bind(log.without_truth())
        values, path = starting_point(bound, fit, effect, 0.0, np.full(len(effect.null), True))
        fit = quick_fit(bound, seed=1, theta=np.concatenate([fit.theta, values]), path=path, effort=LONG)
    mean, sd = (dict(zip(fit.bound.names, values, strict=True)) for values in (fit.theta, fit.std))
    names = ("sensor_yaw", "sensor_offset_x", "sensor_offset_y")
    return [f"{values[name]:.4f}" for name in names for values in (mean, sd)]


def main() -> None:
    """Criticise what has no result yet."""
    logs = recordings()
    with (HERE / "true_path.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["robot", "left_per_metre_ahead", "median_bearing_error"])
        writer.writerows(
            [name, *(f"{value:.4f}" for value in along_the_true_path(log))]
            for name, log in logs.items() if log.landmarks is not None
        )  # fmt: skip
    with (HERE / "mount.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["robot", *(f"{name}{end}" for name in ("yaw", "x", "y") for end in ("", "_sd"))])
        writer.writerows([name, *mount_of(log)] for name, log in logs.items() if log.lidars)
    for name, log in logs.items():
        path = HERE / f"{name.replace(',', '').replace(' ', '_').lower()}.json"
        if path.exists():
            continue
        begin = time.perf_counter()
        found = criticize(log, draws=250, **SETTINGS.get(name, {}))
        seconds = time.perf_counter() - begin
        judged = {name: log}
        if log.lidars:
            judged[f"{name}, stamps as recorded"] = with_recorded_stamps(log)
        rows = []
        for robot, reference in judged.items():
            for title, model, estimates in (("base", found.base, found.before), ("final", found.model, found.after)):
                if not estimates:  # nothing could be judged, because the filter loses the robot
                    continue
                rows.append([robot, title, f"{seconds:.0f}", *errors_of(reference, model, estimates)])
        with (HERE / "errors.csv").open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if file.tell() == 0:
                writer.writerow(["robot", "model", "seconds", "position_rmse", "heading_rmse", "log_score_per_reading"])
            writer.writerows(rows)
        path.write_text(json.dumps(json.loads(found.to_json()), separators=(",", ":")) + "\n")
        print(f"{name}, {seconds:.0f} s: {found.sentence}", flush=True)


if __name__ == "__main__":
    main()
