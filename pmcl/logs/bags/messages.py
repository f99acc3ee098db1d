"""Messages of a ROS 1 bag, a ROS 2 folder (sqlite3 or MCAP) or an MCAP file, one after the other.

Of all readers only this module imports rosbags, an optional dependency (``pip install 'pmcl[ros]'``). Messages are
decoded with the standard definitions of their types, not with those in the bag: bags of ROS 2 Humble and before hold
none, and the types that are needed here have not changed since. Custom types of other topics are never looked at.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from pmcl.logs.bags.unpacking import (
    Chunk,
    check_index,
    check_packed_file,
    checked_chunks,
    limit_chunks_of_ros1,
    unpacked,
)
from pmcl.logs.validation import fail

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

__all__ = ["Bag", "Topic", "short_type"]

_ROS1_MAGIC = b"#ROSBAG V"
# What files of ROS 2 begin with, and the suffix by which rosbags knows their kind.
_ROS2_KINDS = {b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\x00": ".db3"}
_LONGEST_MAGIC = 16
# What repairs a file, by its suffix.
_REPAIRS = {".bag": "'rosbag reindex'", ".mcap": "'mcap recover'", ".db3": "'sqlite3 FILE .recover'"}
_TF = "tf2_msgs/msg/TFMessage"
# ROS 1 had this type twice, with the same fields.
_SAME_TYPE = {"tf/msg/tfMessage": _TF}


class Topic(NamedTuple):
    """One topic of a bag.

    Attributes
    ----------
    type : str
        Type of its messages, as ROS 2 writes it: ``"sensor_msgs/msg/LaserScan"``.
    messages : int
        Number of messages.
    """

    type: str
    messages: int


class Bag:
    """An open bag; a context manager.

    Parameters
    ----------
    path : path
        A ROS 1 bag, an MCAP or sqlite3 file, or a folder of ROS 2 with ``metadata.yaml`` or with one such file.

    Attributes
    ----------
    where : str
        The path, for messages.
    topics : dict of str to Topic
        What the bag holds.
    n_missing : int
        Messages that the bag's index or its ``metadata.yaml`` counts, but that :meth:`messages` did not find.

    Raises
    ------
    LogError
        When there is no such bag, it is damaged, or rosbags is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.where = os.fspath(path)
        self.topics: dict[str, Topic] = {}
        self.n_missing = 0
        self._connections: dict[str, list[Connection]] = {}
        storage = _storage_of(Path(path), self.where)
        for file in sorted(storage.glob("*.db3")) if storage.is_dir() else [storage]:
            # SQLite itself reads zeros where a part of the last page is missing.
            if file.suffix == ".db3" and _is_cut_off(file):
                fail(os.fspath(file), "expected a whole sqlite3 file, got one that is cut off: copy it again")
        try:
            from rosbags import rosbag1, rosbag2
        except ImportError:
            fail(self.where, "expected the package rosbags, which reads bags, got none: pip install 'pmcl[ros]'")
        self._is_ros1 = storage.is_file() and _begins_with(storage, _ROS1_MAGIC)
        self._types = _typestore(self._is_ros1)
        files = sorted(storage.iterdir()) if storage.is_dir() else [storage]
        self._kind = ".bag" if self._is_ros1 else next((f.suffix for f in files if f.suffix in _REPAIRS), "")
        try:
            chunks = {file: checked_chunks(file) for file in files if file.suffix == ".mcap"}
            for file in files:
                if file.suffix in (".zstd", ".zst"):
                    check_packed_file(file)
            self._reader: Any = rosbag1.Reader(storage) if self._is_ros1 else rosbag2.Reader(storage)
            self._reader.open()
            self._unpack = _limited(self._reader, self._is_ros1, chunks)
            for connection in self._reader.connections:
                self._add(connection)
        # A damaged file fails in the reader, its decompressors and its database with errors of every kind.
        except Exception as problem:
            self._damaged(problem)

    def _add(self, connection: Connection) -> None:
        # Those of a folder come from its metadata.yaml, in which anything may stand.
        if not isinstance(connection.topic, str) or not isinstance(connection.msgtype, str):
            raise ValueError(f"a topic {connection.topic!r} of type {connection.msgtype!r}")
        kind = _SAME_TYPE.get(connection.msgtype, connection.msgtype)
        known = self.topics.get(connection.topic, Topic(kind, 0))
        self.topics[connection.topic] = Topic(known.type, known.messages + int(connection.msgcount))
        self._connections.setdefault(connection.topic, []).append(connection)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Read the messages of some topics in the order in which they were recorded, one at a time.

        Parameters
        ----------
        topics : collection of str
            Names of topics of the bag.

        Yields
        ------
        topic : str
        time : int
            When the message was recorded [ns].
        message : object
            With the fields of its type.

        Raises
        ------
        LogError
            When the bag is damaged.
        """
        wanted = [connection for topic in topics for connection in self._connections.get(topic, ())]
        if not wanted:
            return
        stream = self._reader.messages(wanted)
        n_missing = sum(int(connection.msgcount) for connection in wanted)
        decode = self._types.deserialize_ros1 if self._is_ros1 else self._types.deserialize_cdr
        while True:
            try:
                found = next(stream, None)
                if found is None:
                    self.n_missing += max(n_missing, 0)
                    return
                n_missing -= 1
                connection, time, raw = found
                message = decode(self._unpack(raw), self.topics[connection.topic].type)
            except Exception as problem:
                self._damaged(problem)
            yield connection.topic, time, message

    def _damaged(self, problem: Exception) -> NoReturn:
        said = str(problem) or type(problem).__name__
        repair = _REPAIRS.get(self._kind, "'ros2 bag reindex'")
        fail(self.where, f"expected an undamaged bag, got '{said:.160}': copy it again, or repair it with {repair}")

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Closing a damaged file may fail once more; what is wrong has been said.
        with suppress(Exception):
            self._reader.close()


def short_type(name: str) -> str:
    """Return a type as people write it: ``"sensor_msgs/LaserScan"``."""
    return name.replace("/msg/", "/")


def _typestore(is_ros1: bool) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not is_ros1:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    # tf2_msgs is not in that store.
    types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
    return types


def _limited(reader: Any, is_ros1: bool, chunks: Mapping[Path, Mapping[int, Chunk]]) -> Callable[[bytes], bytes]:
    """Let an open reader unpack nothing that is too large; return what unpacks each of its messages."""
    if is_ros1:
        from rosbags.rosbag1.reader import decompressors

        limit_chunks_of_ros1(reader, decompressors)
        return bytes
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        if storage.path.suffix == ".mcap":
            # A file that was compressed as a whole lies in a temporary folder by now.
            found = chunks[storage.path] if storage.path in chunks else checked_chunks(storage.path)
            check_index(storage, found)
    if reader.storage.metadata.compression_mode == "message":
        # The reader would unpack them without a limit.
        reader.storage.metadata = reader.storage.metadata._replace(compression_mode=None)
        return lambda raw: unpacked("zstd", raw)
    return bytes


def _storage_of(path: Path, where: str) -> Path:
    """Find the file or folder that the reader opens."""
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return path
        files = sorted(each for each in path.iterdir() if each.suffix in _ROS2_KINDS.values())
        if len(files) != 1:
            fail(
                where,
                f"expected a folder with metadata.yaml or with one .mcap or .db3 file, got {len(files)} such files: "
                "make metadata.yaml with 'ros2 bag reindex', or give one file",
            )
        path = files[0]
    if not path.is_file():
        fail(where, "expected a bag, got no such file: check the path")
    try:
        if path.stat().st_size == 0:
            fail(where, "expected a bag, got an empty file: record or copy it again")
        kinds = [suffix for magic, suffix in _ROS2_KINDS.items() if _begins_with(path, magic)]
    except OSError as problem:
        fail(where, f"expected a readable bag, got '{problem.strerror}': check its permissions")
    if kinds and path.suffix != kinds[0]:
        fail(where, f"expected the suffix {kinds[0]} for a file of this kind, got '{path.suffix}': rename it")
    if not kinds and not _begins_with(path, _ROS1_MAGIC):
        fail(where, "expected a ROS 1 bag, an MCAP file or a sqlite3 file, got something else: check the file")
    return path


def _is_cut_off(path: Path) -> bool:
    """Tell whether a file of SQLite does not end with a whole page (sqlite.org/fileformat.html, section 1.3)."""
    with path.open("rb") as stream:
        header = stream.read(100)
    if len(header) < 100:
        return True
    page = int.from_bytes(header[16:18], "big")
    return path.stat().st_size % (65536 if page == 1 else max(page, 1)) != 0


def _begins_with(path: Path, magic: bytes) -> bool:
    with path.open("rb") as stream:
        return stream.read(_LONGEST_MAGIC).startswith(magic)
