"""Errors of the map: landmarks, walls or obstacles that are not where it shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.editing import edit_beams, edit_landmarks, edit_ranges
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.landmarks import reads_landmarks
from pmcl.models.effects.places import at_place, floor_places, has_floor
from pmcl.models.effects.ranges import reads_ranges, reads_scans
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float
from pmcl.models.tables import Tables

__all__ = ["MAP_EFFECTS"]

_THRUN = "Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 8.5"


def _sees_walls(log: RobotLog) -> bool:
    return reads_ranges(log) and log.walls is not None


def _sees_floor(log: RobotLog) -> bool:
    """Return whether beams or lidars would see what stands on a floor of known extent."""
    return _sees_walls(log) or (log.grid_map is not None and reads_scans(log) and has_floor(log))


def _each_wall(log: RobotLog) -> list[Where]:
    assert log.walls is not None
    return [{"walls": (wall,)} for wall in range(log.walls.segments.shape[0])]


def _each_landmark(log: RobotLog) -> list[Where]:
    held = (log.landmark_range, log.landmark_bearing, log.landmark_size)
    seen = np.any([~np.isnan(values).all(axis=0) for values in held if values is not None], axis=0)
    return [{"landmarks": (int(landmark),)} for landmark in np.flatnonzero(seen)]


def _wall_moved(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(beams: Any) -> Any:
        vertices = beams.vertices.copy()
        for wall in where.get("walls", (0,)):
            a, b = beams.wall_start[int(wall)], beams.wall_stop[int(wall)]
            along = beams.vertices[b] - beams.vertices[a]
            # The wall moves to the left, seen from its first end to its second. Vertices are shared with the walls that
            # meet it, so that a closed room stays closed.
            vertices[[a, b]] += values[0] * np.array([-along[1], along[0]]) / np.hypot(*along)
        return {"vertices": vertices}

    return edit_beams(tables, edit, "wall-moved")


def _landmark_moved(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    def edit(seen: Any) -> Any:
        position = seen.position.copy()
        position[[int(landmark) for landmark in where.get("landmarks", (0,))]] += values
        return {"position": position}

    return edit_landmarks(tables, edit, "landmark-moved")


def _obstacle(tables: Tables, values: Float, log: RobotLog, where: Where) -> Tables:
    weight, x, y, radius = values
    row = np.array([[x, y, radius, weight]])
    return edit_ranges(
        tables, lambda beams: {"obstacles": np.concatenate([beams.obstacles, row])}, "unmapped-obstacle"
    )


MAP_EFFECTS = (
    Effect(
        name="landmark-moved",
        summary="One landmark stands elsewhere than the map says.",
        finding="landmark {landmarks} stands {0:+} along x and {1:+} along y from its place on the map",
        parameters=(
            Parameter("landmark_moved_x", "m", stats.norm(scale=0.5), "how far along x from its place on the map"),
            Parameter("landmark_moved_y", "m", stats.norm(scale=0.5), "how far along y from its place on the map"),
        ),
        null=(0.0, 0.0),
        change=_landmark_moved,
        carrier="map",
        symptom="Residuals of one landmark depend on where it is seen from; those of the others are fine.",
        typical={"just visible": (0.1, 0.0), "clear": (0.3, 0.2), "large": (0.8, 0.6)},
        means_only=True,
        may_begin=False,
        near_twins={
            "landmark-misread": "look again later: a misread landmark is right the next time",
            "landmark-noise-correlated": "come back later: an error that lasts a while is another one then",
        },
        references=(_THRUN,),
        needs=reads_landmarks,
        places=_each_landmark,
    ),
    Effect(
        name="wall-moved",
        summary="One wall stands farther in or out than the map says.",
        finding="wall {walls} stands {0} to the {0:left|right} of its place, seen from its first end to its second",
        parameters=(Parameter("wall_moved", "m", stats.norm(scale=0.2), "how far left of its place, seen from its "
                              "first end to its second"),),
        null=(0.0,),
        change=_wall_moved,
        carrier="map",
        symptom="All beams that hit one wall read too long (or too short) by the same length.",
        typical={"just visible": (0.03,), "clear": (0.1,), "large": (0.25,)},
        means_only=True,
        may_begin=False,
        near_twins={"range-bias": "look at every wall from several sides"},
        references=(_THRUN,),
        needs=_sees_walls,
        places=_each_wall,
    ),
    Effect(
        name="unmapped-obstacle",
        summary="Something stands on the floor, always or at times, that the map does not know.",
        finding="something of radius {3} stands at ({1:+}, {2:+}), in the way of {0:%} of the readings towards it",
        parameters=(
            Parameter("unmapped_obstacle_weight", "1", stats.beta(1.0, 1.0), "share of the readings towards it that it "
                      "answers", role="weight"),
            Parameter("unmapped_obstacle_x", "m", stats.norm(scale=5.0), "where it stands"),
            Parameter("unmapped_obstacle_y", "m", stats.norm(scale=5.0), "where it stands"),
            Parameter("unmapped_obstacle_radius", "m", gamma_prior(0.3, 8.0), "its radius"),
        ),
        # Until the effect has a place, the radius is a share of a cell of the grid.
        null=(0.0, 0.0, 0.0, 0.3),
        change=_obstacle,
        carrier="map",
        symptom="Readings towards one place on the map are too short, from wherever they come.",
        typical={
            "just visible": (0.1, 0.0, 0.0, 0.3),
            "clear": (0.5, 0.0, 0.0, 0.3),
            "large": (0.95, 0.0, 0.0, 0.3),
        },
        shape=("unmapped_obstacle_x", "unmapped_obstacle_y", "unmapped_obstacle_radius"),
        may_begin=False,
        near_twins={"short-readings": "come back: an obstacle is still there"},
        references=(_THRUN,),
        needs=_sees_floor,
        places=floor_places,
        fitted=at_place,
    ),
)  # fmt: skip
