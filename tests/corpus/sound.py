"""Sound inputs of every kind, from which bad ones are made; each is accepted by the commands that read it."""

from __future__ import annotations

import gzip
from functools import cached_property
from pathlib import Path

import numpy as np
from oracles.made_bags import MadeBag
from scipy.io import savemat

from pmcl.logs import LidarScans, RobotLog
from pmcl.maps import OccupancyGrid

__all__ = ["Sound"]

SECOND = 10**9
SIDE, CELL = 6.0, 0.1
N_RAYS = 12
ANGLES = np.linspace(-np.pi, np.pi, N_RAYS, endpoint=False) + 0.05  # none along a wall


def in_square(poses):
    """Ranges from poses inside a square room to its walls, exact."""
    direction = poses[:, 2:] + ANGLES
    dx, dy = np.cos(direction), np.sin(direction)
    across = np.where(dx > 0.0, SIDE - CELL - poses[:, :1], CELL - poses[:, :1]) / dx
    along = np.where(dy > 0.0, SIDE - CELL - poses[:, 1:2], CELL - poses[:, 1:2]) / dy
    return np.minimum(across, along)


def made_bag(n=25):
    """A robot that drives straight on at 1 m/s, with a laser."""
    bag = MadeBag()
    bag.transform("/tf_static", SECOND, "base_link", "laser", (0.2, 0.0, 0.3))
    for k in range(n):
        stamp = SECOND + k * SECOND // 10
        bag.odometry("/odom", stamp, (0.1 * k, 0.0, 0.0))
        bag.scan("/scan", stamp, np.full(10, 2.0) + 0.01 * k)
    return bag


class Sound:
    """Sound files in a folder, made when they are first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _written(self, name, content) -> Path:
        path = self.folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    @cached_property
    def walls_log(self) -> Path:
        """Eight beams among walls, 20 rows."""
        from pmcl.simulations.amigobot import simulate_amigobot

        simulate_amigobot(20.0).write(self.folder / "walls.nc")
        return self.folder / "walls.nc"

    @cached_property
    def landmarks_log(self) -> Path:
        """Sightings of landmarks, 15 rows."""
        rng = np.random.default_rng(1)
        times, marks = np.arange(15.0), np.array([[0.0, 3.0], [4.0, 3.0], [4.0, -2.0]])
        poses = np.column_stack([0.2 * times, 0.0 * times, 0.0 * times])
        away = marks - poses[:, None, :2]
        odometry = np.zeros((15, 3))
        odometry[1:, 0] = 0.2
        RobotLog.build(
            time=times, odometry=odometry + 0.01 * rng.normal(size=(15, 3)),
            landmark_range=np.hypot(*np.moveaxis(away, -1, 0)) + 0.02 * rng.normal(size=(15, 3)),
            landmark_bearing=np.arctan2(away[..., 1], away[..., 0]) + 0.02 * rng.normal(size=(15, 3)),
            landmarks=marks, start_mean=[0.0, 0.0, 0.0], start_std=[0.1, 0.1, 0.1], robot="made", warn=False,
        ).write(self.folder / "landmarks.nc")  # fmt: skip
        return self.folder / "landmarks.nc"

    @cached_property
    def grid(self) -> Path:
        """A square room, as a map_server pair."""
        n = round(SIDE / CELL)
        cells = np.zeros((n, n), dtype=np.uint8)
        cells[[0, -1]] = 1
        cells[:, [0, -1]] = 1
        OccupancyGrid(cells, CELL).write(self.folder / "room.yaml")
        return self.folder / "room.yaml"

    @cached_property
    def lidar_log(self) -> Path:
        """A laser of twelve rays in the square room, 12 rows."""
        poses = np.column_stack([np.linspace(2.0, 4.0, 12), np.full(12, 2.5), np.zeros(12)])
        ranges = in_square(poses) + 0.02 * np.random.default_rng(2).normal(size=(12, N_RAYS))
        odometry = np.zeros((12, 3))
        odometry[1:, 0] = 2.0 / 11.0
        RobotLog.build(
            time=np.arange(12.0), odometry=odometry + 0.005 * np.random.default_rng(3).normal(size=(12, 3)),
            lidars={"": LidarScans(ranges, ANGLES, 0.05, 10.0, np.zeros(3))}, start_mean=poses[0],
            start_std=[0.1, 0.1, 0.1], warn=False,
        ).write(self.folder / "lidar.nc")  # fmt: skip
        return self.folder / "lidar.nc"

    @cached_property
    def model_text(self) -> str:
        """The usual model of the log among walls."""
        import pmcl
        from pmcl.models.model_file import model_text
        from pmcl.models.robot_model import default_model

        log = pmcl.read_log(self.walls_log)
        return model_text(default_model(log), log)

    @cached_property
    def posterior(self) -> Path:
        """A short calibration of the log among walls."""
        import pmcl
        from pmcl.posterior.files import write_posterior

        method = pmcl.ParticleGibbs(particles=10, burn_in_particles=50)
        data = pmcl.calibrate(pmcl.read_log(self.walls_log), draws=20, chains=2, method=method)
        write_posterior(data, self.folder / "posterior.nc")
        return self.folder / "posterior.nc"

    @cached_property
    def checkpoint(self) -> Path:
        """The checkpoint of a short run that is complete."""
        import pmcl

        path = self.folder / "run.h5"
        method = pmcl.ParticleGibbs(particles=5, burn_in_particles=5)
        pmcl.calibrate(pmcl.read_log(self.walls_log), draws=4, chains=2, method=method, checkpoint=path)
        return path

    def bag(self, kind: str) -> Path:
        """A bag: ``ros1``, ``sqlite3`` or ``mcap``."""
        path = self.folder / {"ros1": "drive.bag", "sqlite3": "drive.db3", "mcap": "drive.mcap"}[kind]
        if not path.exists():
            written = made_bag().write(self.folder / f"drive_{kind}", kind, {"ros1": "lz4", "mcap": "chunk"}.get(kind))
            file = written if written.is_file() else next(written.glob(f"*{path.suffix}"))
            path.write_bytes(file.read_bytes())
        return path

    @cached_property
    def carmen(self) -> Path:
        """A CARMEN text."""
        lines = ["PARAM robot_length 0.5 0 host 0"]
        for k in range(8):
            x = 0.4 * k
            lines.append(f"ODOM {x} 0 0 0.1 0 0 {k}.0 host {k}.0")
            lines.append(f"FLASER 10 {' '.join(['2.5'] * 10)} {x + 0.2} 0 0 {x} 0 0 {k}.5 host {k}.5")
        return self._written("drive.clf", "\n".join(lines) + "\n")

    @cached_property
    def wean(self) -> Path:
        """A Wean Hall text."""
        lines = [f"L {40 * k} 0 0 {40 * k + 25} 0 0 {' '.join(['300'] * 20)} {k}.5" for k in range(8)]
        return self._written("robotdata1.log", "\n".join(lines) + "\n")

    @cached_property
    def wean_map(self) -> Path:
        """A map of the Wean Hall recordings, compressed."""
        cells = "\n".join(
            " ".join("0.0" if x in (0, 39) or y in (0, 19) else "1.0" for y in range(20)) for x in range(40)
        )
        head = "robot_specifications->resolution   10\n\nglobal_map[0]: 40 20\n"
        return self._written("wean.dat.gz", gzip.compress((head + cells + "\n").encode(), mtime=0))

    @cached_property
    def csv(self) -> Path:
        """A table with beams, a laser, landmarks and a reference."""
        head = (
            "# robot: shoebox\n# beam_0: 0.1 0 0\n# max_range: 4\n# wall: 0 0 5 0\n# wall: 5 0 5 4\n# wall: 5 4 0 4\n"
            "# wall: 0 4 0 0\n# landmark a: 2 1\n# scan_angles: -0.5 0.5\n# scan_limits: 0.1 9\n"
            "# start: 1 2 0 0.1 0.1 0.1\n"
            "time,odom_x,odom_y,odom_heading,range_0,scan_0,scan_1,range_to_a,bearing_to_a\n"
        )
        rows = [f"{k},{0.2 * k},0,0,{3.8 - 0.2 * k},2,2.1,{'' if k == 3 else 1.5},0.2" for k in range(8)]
        return self._written("table.csv", head + "\n".join(rows) + "\n")

    @cached_property
    def mrclam(self) -> Path:
        """A folder of UTIAS tables."""
        folder = self.folder / "mrclam"
        folder.mkdir()
        times = np.arange(0.0, 6.0, 0.1)
        tables = {
            "Robot1_Odometry.dat": [f"{t:.3f} 0.2 0.01" for t in times],
            "Robot1_Measurement.dat": [f"{t:.3f} {72 if k % 2 else 27} 2.5 0.3" for k, t in enumerate(times[5::7])],
            "Robot1_Groundtruth.dat": [f"{t:.3f} {0.2 * t:.4f} 0.0 0.0" for t in times],
            "Barcodes.dat": ["1 5", "6 72", "7 27"],
            "Landmark_Groundtruth.dat": ["6 2.0 1.0 0.001 0.001", "7 3.0 -1.0 0.001 0.001"],
        }
        for name, lines in tables.items():
            (folder / name).write_text("# a comment\n" + "\n".join(lines) + "\n")
        return folder

    @cached_property
    def barfoot(self) -> Path:
        """A MAT-file, compressed."""
        n = 31
        t = 0.1 * np.arange(n)[:, None]
        r, b = np.zeros((n, 2)), np.zeros((n, 2))
        r[10], b[10], r[20], b[20] = 2.0, 0.5, 1.5, 0.6
        content = {
            "t": t, "v": np.ones((n, 1)), "om": np.zeros((n, 1)), "r": r, "b": b,
            "l": np.array([[3.0, 1.0], [0.0, 5.0]]),
            "x_true": t, "y_true": 0.0 * t, "th_true": 0.0 * t, "true_valid": np.ones((n, 1)), "d": np.array([[0.25]]),
        }  # fmt: skip
        savemat(self.folder / "dataset2.mat", content, do_compression=True)
        return self.folder / "dataset2.mat"
