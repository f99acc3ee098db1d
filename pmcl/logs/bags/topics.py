"""Which topics of a bag are meant, and what to say when that is not clear."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from pmcl.logs.bags.messages import Topic, short_type
from pmcl.logs.validation import fail

__all__ = ["ODOMETRY", "POSES", "SCAN", "TF", "choose_odometry", "choose_scans", "contents", "laser_names", "require"]

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    ODOMETRY,
)
"""Types that may tell the reference trajectory."""

_USED = (SCAN, ODOMETRY, TF, *POSES)
_MOST_LISTED = 10


def contents(topics: Mapping[str, Topic]) -> str:
    """Say what a bag holds: topics that pmcl can use first, with type and number of messages."""
    if not topics:
        return "the bag holds no topics"
    order = sorted(topics.items(), key=lambda item: (item[1].type not in _USED, item[1].type, item[0]))
    listed = [f"{name} ({short_type(topic.type)}, {topic.messages})" for name, topic in order[:_MOST_LISTED]]
    more = f" and {len(order) - _MOST_LISTED} more" * (len(order) > _MOST_LISTED)
    return f"the bag holds {', '.join(listed)}{more}"


def require(topics: Mapping[str, Topic], name: str, kinds: Sequence[str], option: str, where: str) -> str:
    """Return the name of a topic that was asked for.

    Parameters
    ----------
    topics : mapping of str to Topic
        Topics of the bag by name.
    name : str
        The name as it was given, with or without its slash.
    kinds : sequence of str
        Message types that the topic may have.
    option : str
        The option that asked for it, for the message.
    where : str
        The bag, for the message.

    Returns
    -------
    str
        The name as the bag has it.

    Raises
    ------
    LogError
        When the bag has no such topic of these types.
    """
    for candidate in (name, f"/{name}"):
        if candidate in topics:
            if topics[candidate].type in kinds:
                return candidate
            listed = " or ".join(map(short_type, kinds))
            fail(
                where,
                f"expected {option} to name a topic of type {listed}, got {candidate} of type "
                f"{short_type(topics[candidate].type)}: choose another; {contents(topics)}",
            )
    fail(where, f"expected {option} to name a topic of the bag, got {name!r}: choose another; {contents(topics)}")


def choose_scans(topics: Mapping[str, Topic], asked: Sequence[str], where: str) -> tuple[str, ...]:
    """Return the topics of the lasers: those that were asked for, else the only one that there is.

    Parameters
    ----------
    topics : mapping of str to Topic
        Topics of the bag by name.
    asked : sequence of str
        What the user asked for; empty for nothing.
    where : str
        The bag, for messages.

    Returns
    -------
    tuple of str

    Raises
    ------
    LogError
        When a topic is not there, or none or several are and nothing was asked for.
    """
    if asked:
        return tuple(dict.fromkeys(require(topics, name, (SCAN,), "--scan", where) for name in asked))
    found = [name for name, topic in topics.items() if topic.type == SCAN and topic.messages]
    if len(found) == 1:
        return (found[0],)
    if not found:
        fail(where, f"expected a topic of type {short_type(SCAN)}, got none: record one; {contents(topics)}")
    fail(
        where,
        f"expected one topic of type {short_type(SCAN)}, got {len(found)}: choose one, or several, with --scan; "
        f"{contents(topics)}",
    )


def choose_odometry(topics: Mapping[str, Topic], asked: str | None, truth: str | None, where: str) -> str | None:
    """Return the topic of the odometry; None where it stands in tf.

    Parameters
    ----------
    topics : mapping of str to Topic
        Topics of the bag by name.
    asked : str, optional
        A topic or, when no topic has this name, a frame of tf.
    truth : str, optional
        The topic of the reference, which is not chosen unless it was asked for.
    where : str
        The bag, for messages.

    Returns
    -------
    str or None

    Raises
    ------
    LogError
        When there is no odometry, or several topics have it and none was asked for.
    """
    has_tf = any(topic.type == TF for topic in topics.values())
    if asked is not None:
        named = [name for name in (asked, f"/{asked}") if name in topics]
        # "odom" may be both; a topic with the slash that topics have is preferred to a frame only when it is one.
        if asked.startswith("/") or (named and topics[named[0]].type == ODOMETRY):
            return require(topics, asked, (ODOMETRY,), "--odom", where)
        if not has_tf:
            fail(where, f"expected --odom to name a topic, got {asked!r}: choose another; {contents(topics)}")
        return None
    found = [name for name, topic in topics.items() if topic.type == ODOMETRY and topic.messages and name != truth]
    if len(found) == 1:
        return found[0]
    if found:
        fail(
            where,
            f"expected one topic of type {short_type(ODOMETRY)}, got {len(found)}: choose one with --odom; "
            f"{contents(topics)}",
        )
    if not has_tf:
        fail(
            where, f"expected odometry as {short_type(ODOMETRY)} or in /tf, got neither: record it; {contents(topics)}"
        )
    return None


def laser_names(topics: Sequence[str]) -> dict[str, str]:
    """Give each laser the short name that it has in the log, from the parts in which the topics differ.

    A single laser has no name. ``/front/scan`` and ``/rear/scan`` become ``front`` and ``rear``.
    """
    if len(topics) == 1:
        return {topics[0]: ""}
    parts = [topic.strip("/").split("/") for topic in topics]
    while min(map(len, parts)) > 1 and len({each[-1] for each in parts}) == 1:
        parts = [each[:-1] for each in parts]
    while min(map(len, parts)) > 1 and len({each[0] for each in parts}) == 1:
        parts = [each[1:] for each in parts]
    names = [re.sub(r"\W+", "_", "_".join(each)).strip("_") for each in parts]
    # The variables are scan_NAME and scan_angle_NAME: a name that begins with "angle" would be mistaken.
    names = [f"laser_{name}" if name.startswith("angle") or not name else name for name in names]
    if len(set(names)) < len(names):
        names = [f"{name}_{k + 1}" for k, name in enumerate(names)]
    return dict(zip(topics, names, strict=True))
