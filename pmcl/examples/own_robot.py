"""Calibrate your own robot from two text files: wheel speeds, and landmarks that it saw.

Run as it is, this file simulates such a recording first. Replace `record` by your own files; their columns count.
"""

import numpy as np

import pmcl
from pmcl.logs import landmark_rows, odometry_from_velocities, row_times

TRACK_WIDTH = 0.30  # distance between the wheels [m]
CAMERA = (0.10, 0.0, 0.0)  # where the camera sits on the robot: x ahead [m], y left [m], yaw [rad]
START = (1.0, 1.0, 0.0)  # where the robot was put down: x [m], y [m], heading [rad]
TAGS = pmcl.LandmarkMap(
    np.array([[0.0, 0.0], [3.0, -1.0], [6.0, 0.0], [6.0, 4.0], [3.0, 5.0], [0.0, 4.0]]),  # where each tag is: x, y [m]
    names=["1", "2", "7", "12", "40", "41"],
)


def record(duration: float = 200.0, seed: int = 1) -> None:
    """Simulate the recording: write wheels.txt (20 rows a second) and sightings.txt (some five)."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, duration, 0.05)
    forward, turn_rate = 0.25 + 0.05 * np.sin(0.3 * times), 0.25 + 0.1 * np.sin(0.11 * times)
    wheels = np.column_stack((times, forward - turn_rate * TRACK_WIDTH / 2, forward + turn_rate * TRACK_WIDTH / 2))
    np.savetxt("wheels.txt", wheels, "%.4f", header="time [s], speed of the left wheel [m/s], of the right wheel [m/s]")

    x, y, heading = START
    sightings = []
    for row, time in enumerate(times):
        if row % 4 == 0:  # the camera sees one tag at a time, if it looks that way
            tag = int(rng.integers(len(TAGS.names)))
            dx, dy = TAGS.positions[tag] - (x + CAMERA[0] * np.cos(heading), y + CAMERA[0] * np.sin(heading))
            bearing = (np.arctan2(dy, dx) - heading + np.pi) % (2 * np.pi) - np.pi
            if abs(bearing) < 1.0:
                noise = rng.normal(0.0, [0.05, 0.02])  # what calibration should find: 0.05 m and 0.02 rad
                sightings.append((time, int(TAGS.names[tag]), np.hypot(dx, dy) + noise[0], bearing + noise[1]))
        # The wheels slip a little: the robot does not drive exactly what they measure.
        step = 0.05 * forward[row] + rng.normal(0.0, 0.002)
        x, y = x + step * np.cos(heading), y + step * np.sin(heading) + rng.normal(0.0, 0.001)
        heading += 0.05 * turn_rate[row] + rng.normal(0.0, 0.003)
    np.savetxt("sightings.txt", sightings, "%.3f %d %.4f %.4f", header="time [s], tag, distance [m], bearing [rad]")


def read_log() -> pmcl.RobotLog:
    """Make a log of the two files: one row each 0.2 s, the time between two images of the camera."""
    wheel_times, left, right = np.loadtxt("wheels.txt").T
    seen_times, tags, distances, bearings = np.loadtxt("sightings.txt").T
    times = row_times(0.2, wheel_times)
    return pmcl.RobotLog.build(
        time=times,
        odometry=odometry_from_velocities(wheel_times, (left + right) / 2, (right - left) / TRACK_WIDTH, times),
        **landmark_rows(times, TAGS, seen_times, tags.astype(int), ranges=distances, bearings=bearings),
        landmarks=TAGS,
        landmark_sensor_pose=CAMERA,
        start_mean=START,
        start_std=(0.05, 0.05, 0.05),
        robot="my robot",
    )


def main(draws: int = 1000) -> None:
    """Record, calibrate, and say what was found."""
    record()
    log = read_log()
    log.write("robot.nc")
    data = pmcl.calibrate(log, draws=draws)
    pmcl.write_posterior(data, "posterior.nc")
    for name in ("sigma_forward", "sigma_turn", "sigma_landmark_range", "sigma_bearing"):
        print(f"{name} = {float(data.posterior[name].mean()):.4f} +- {float(data.posterior[name].std()):.4f}")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
