"""Simulated logs in which something is hidden: what there is to find, and where it is written down."""

import json
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from outside import OUTSIDE

import pmcl
from pmcl.errors import PmclError
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.walls import WallMap
from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.simulations.landmark_field import simulate_landmark_field

__all__ = ["ALIKE", "ONLY_THERE", "PLACES", "Hidden", "make", "sealed", "simulate"]

ROWS = 600
# Middling noise, varied by a third from log to log.
SONAR = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
SIGHTS = {
    "sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.03, "sigma_landmark_range": 0.2, "sigma_bearing": 0.04,
}  # fmt: skip
PITCH = {"sigma_forward": 0.02, "sigma_left": 0.015, "sigma_turn": 0.05, "sigma_bearing": 0.04, "sigma_size": 0.1}
CAMERA = 2.0
"""Field of view [rad]."""
HALL = WallMap.from_polygon(
    [(0.0, 0.0), (4.6, 0.0), (4.6, 2.4), (3.4, 2.4), (3.4, 3.6), (1.5, 3.6), (1.5, 2.7), (0.0, 2.7)]
)
HALL_WAYPOINTS = [(3.7, 0.9), (3.2, 1.5), (2.5, 2.8), (2.0, 1.6), (0.9, 1.9), (1.6, 1.1), (0.8, 0.8)]
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
CIRCLE = np.column_stack([0.95 + 0.45 * np.cos(_ANGLES), 0.95 + 0.45 * np.sin(_ANGLES)])
"""Always to the left at one speed: turn scale, turn bias and arc are then the same."""

ALIKE = ("odometry-turn-scale", "odometry-turn-bias", "odometry-arc")
PLACES = ("room", "hall", "field", "circle", "camera", "pitch")
ONLY_THERE = {"camera": ("range-is-depth",), "pitch": ("landmark-size-scale",)}
"""Effects that no other place can show: a camera that looks ahead, and one that reads sizes instead of distances."""


@dataclass(frozen=True)
class Hidden:
    """What one log holds: written where only the scorer looks."""

    block: int
    place: str
    effects: list[str]
    seed: int
    where: list = field(default_factory=list)
    values: dict = field(default_factory=dict)

    @property
    def key(self) -> tuple:
        """What tells one log from another."""
        return self.block, self.place, tuple(self.effects), self.seed


def simulate(place: str, effects: Sequence[str], seed: int, rows: int = ROWS, hide: bool = True) -> RobotLog:
    """Simulate one log with effects: NAME=MAGNITUDE, or a name from outside the catalogue."""
    given = tuple((OUTSIDE[text], (1.0,)) if text in OUTSIDE else text for text in effects)
    rng = np.random.default_rng(seed)
    usual = {"field": SIGHTS, "camera": SIGHTS, "pitch": PITCH}.get(place, SONAR)
    theta = {name: std * float(np.exp(0.3 * rng.standard_normal())) for name, std in usual.items()}
    told = {"effects": given, "hide_effects": hide}
    if place == "field":
        return simulate_landmark_field(rows, seed, theta, bearings=True, reach=12.0, **told)
    if place == "camera":
        view = {"n_landmarks": 16, "field_of_view": CAMERA}
        return simulate_landmark_field(rows, seed, theta, bearings=True, reach=12.0, **view, **told)
    if place == "pitch":
        return pmcl.simulate_aibo(float(rows), seed, theta, **told)
    if place == "hall":
        return pmcl.simulate_amigobot(float(rows), seed, theta, room=HALL, waypoints=HALL_WAYPOINTS, **told)
    waypoints = CIRCLE if place == "circle" else None
    return pmcl.simulate_amigobot(float(rows), seed, theta, waypoints=waypoints, **told)


def wanted(place: str, names: Sequence[str], magnitudes: Sequence[str]) -> Iterator[list[str]]:
    """Yield the catalogue's effects that a place can show, at each magnitude."""
    plain = simulate(place, (), 0, 60)
    for effect in CATALOGUE:
        if effect.name in names and effect.instances(plain):
            for size in magnitudes:
                if size.replace("-", " ") in effect.typical:
                    yield [f"{effect.name}={size}"]


def make(folder: Path, block: int, lists: Sequence[tuple[str, list[str]]], done: set) -> None:
    """Simulate (place, effects) that are not `done`, in an order and under names that tell nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    made = sealed(folder)
    known = {one.key for one in made.values()} | done
    seen: dict[tuple, int] = {}
    for k in np.random.default_rng(len(made)).permutation(len(lists)):
        place, effects = lists[k]
        number = seen.get((place, *effects), 0)
        seen[(place, *effects)] = number + 1
        seed = 1_000_000 * block + 1000 * number + zlib.crc32(" ".join([place, *effects]).encode()) % 1000
        if Hidden(block, place, effects, seed).key in known:
            continue
        try:
            told = simulate(place, effects, seed, hide=False)
        except PmclError as error:
            print(f"cannot simulate {effects} in the {place}: {error}")
            continue
        name = f"{len(made):04d}"
        where = [one["where"] for one in json.loads(told.dataset.attrs.pop("effects", "[]"))]
        RobotLog(told.without_truth().dataset).write(folder / f"log-{name}.nc")
        made[name] = Hidden(block, place, effects, seed, where, dict(told.true_theta or {}))
        (folder / "sealed.json").write_text(json.dumps({key: asdict(one) for key, one in made.items()}, indent=0))


def sealed(folder: Path) -> dict[str, Hidden]:
    """Open the file that tells what the logs hold."""
    path = folder / "sealed.json"
    return {key: Hidden(**one) for key, one in json.loads(path.read_text()).items()} if path.exists() else {}
