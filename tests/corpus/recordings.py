"""Bad recordings: what the converters read."""

from __future__ import annotations

import gzip
import math
import os
import shutil

import numpy as np
from corpus.cases import EITHER, Case, cut, drawn, flipped
from corpus.sound import SECOND, Sound, made_bag
from hypothesis import strategies as st
from oracles.made_bags import KINDS, MadeBag, yaw
from scipy.io import loadmat, savemat

FAMILY = "recording"
SUFFIX = {"ros1": ".bag", "sqlite3": ".db3", "mcap": ".mcap"}


def using(folder):
    """The log that a converter made is used with nothing else: at least, the model for it can be printed."""
    return ["calibrate", folder / "out.nc", "--print-model"]


def frame(count=25, *, scan=None, odometry=None, static=True, **scan_settings):
    """A bag like the sound one, with other scans and poses by their number."""
    bag = MadeBag()
    if static:
        bag.transform("/tf_static", SECOND, "base_link", "laser", (0.2, 0.0, 0.3))
    for k in range(count):
        stamp = SECOND + k * SECOND // 10
        pose = (0.1 * k, 0.0, 0.0) if odometry is None else odometry(k)
        if pose is not None:
            bag.odometry("/odom", stamp, pose)
        ranges = np.full(10, 2.0) if scan is None else scan(k)
        if ranges is not None:
            bag.scan("/scan", stamp, ranges, **scan_settings)
    return bag


def with_transform(shift=(0, 0, 0), quaternion=(0.0, 0.0, 0.0, 1.0), parent="base_link", child="laser"):
    bag = frame(static=False)
    bag.transform("/tf_static", SECOND, parent, child, shift, quaternion)
    return bag


def moving():
    bag = frame(static=False)
    for k in range(25):
        bag.transform("/tf", SECOND + k * SECOND // 10, "base_link", "laser", (0.2, 0, 0), yaw(0.1 * k))
    return bag


def jumping(every):
    """The clock of scans jumps by a year at every so many messages."""
    bag = frame(scan=lambda k: None)
    for k in range(25):
        jump = 365 * 86400 * SECOND if k % every == every - 1 else 0
        bag.scan("/scan", SECOND + k * SECOND // 10 + jump, np.full(10, 2.0), recorded=SECOND + k * SECOND // 10)
    return bag


BAGS = {
    "nothing in it": MadeBag,
    "no scans": lambda: frame(scan=lambda k: None),
    "no odometry": lambda: frame(odometry=lambda k: None),
    "one odometry": lambda: frame(odometry=lambda k: (0, 0, 0) if k == 3 else None),
    "one scan": lambda: frame(scan=lambda k: np.ones(10) if k == 3 else None),
    "no mount": lambda: frame(static=False),
    "a mount elsewhere": lambda: with_transform(child="camera"),
    "a mount that moves": moving,
    "a mount of nan": lambda: with_transform((math.nan, 0, 0)),
    "a mount of 1e300": lambda: with_transform((1e300, 0, 0)),
    "a mount without turn": lambda: with_transform(quaternion=(0.0, 0.0, 0.0, 0.0)),
    "a mount that is tilted": lambda: with_transform(quaternion=(math.sin(0.4), 0.0, 0.0, math.cos(0.4))),
    "nothing measured": lambda: frame(scan=lambda k: np.full(10, math.nan)),
    "scans that all differ": lambda: frame(scan=lambda k: np.ones(10 + k)),
    "scans of no rays": lambda: frame(scan=lambda k: np.ones(0)),
    "scans of one ray": lambda: frame(scan=lambda k: np.ones(1)),
    "odometry of nan": lambda: frame(odometry=lambda k: (math.nan, 0, 0)),
    "odometry of 1e308": lambda: frame(odometry=lambda k: (1e308 * (-1) ** k, 0, 0)),
    "odometry at another time": lambda: _late(),
    "range_max of nan": lambda: frame(limits=(0.1, math.nan)),
    "range_max of infinity": lambda: frame(limits=(0.1, math.inf)),
    "range_max of 3e38": lambda: frame(limits=(0.1, 3e38)),
    "range_min above range_max": lambda: frame(limits=(5.0, 1.0)),
    "range_min below zero": lambda: frame(limits=(-1.0, 10.0)),
    "angles of nan": lambda: frame(first=math.nan),
    "steps of nan": lambda: frame(step=math.nan),
    "steps of zero": lambda: frame(step=0.0),
    "steps of 1e30": lambda: frame(step=1e30),
    "angles of 1e30": lambda: frame(first=1e30),
    "more than a turn": lambda: frame(step=1.0),
    "a robot that stands": lambda: frame(odometry=lambda k: (0, 0, 0)),
}


def _late():
    bag = frame(odometry=lambda k: None)
    for k in range(25):
        bag.odometry("/odom", 1000 * SECOND + k * SECOND, (0.1 * k, 0, 0))
    return bag


BAGS_EITHER = {
    "some scans of another shape": lambda: frame(scan=lambda k: np.ones(10 if k % 3 else 11)),
    "some odometry of nan": lambda: frame(odometry=lambda k: (math.nan if k % 5 == 0 else 0.1 * k, 0, 0)),
    "one wild odometry": lambda: frame(odometry=lambda k: (1e200 if k == 7 else 0.1 * k, 0, 0)),
    "odometry in UTM": lambda: frame(odometry=lambda k: (5e6 + 0.1 * k, 4e5, 0)),
    "readings below range_min": lambda: frame(scan=lambda k: np.full(10, 0.01)),
    "no echo": lambda: frame(scan=lambda k: np.full(10, math.inf)),
    "readings of minus infinity": lambda: frame(scan=lambda k: np.full(10, -math.inf)),
    "readings of 1e38": lambda: frame(scan=lambda k: np.full(10, 1e38)),
    "a clock that jumps once": lambda: jumping(13),
    "a clock that jumps often": lambda: jumping(2),
    "a quaternion of length 1.005": lambda: with_transform(quaternion=(0.0, 0.0, 0.0, 1.005)),
}

OPTIONS = {
    "scan of no topic": ["--scan", "/none"],
    "scan of an empty name": ["--scan", ""],
    "scan of odometry": ["--scan", "/odom"],
    "odometry of no topic": ["--odom", "/none"],
    "truth of no topic": ["--truth", "/none"],
    "truth as start": ["--start", "reference"],
    "start of nan": ["--start", "nan,0,0"],
    "start of 1e300": ["--start", "1e300,0,0"],
    "start of two": ["--start", "1,2"],
    "begin of nan": ["--begin", "nan"],
    "begin of 1e308": ["--begin", "1e308"],
    "duration of zero": ["--duration", "0"],
    "duration of 1e-300": ["--duration", "1e-300"],
    "distance of nan": ["--update-min-d", "nan"],
    "distance of 1e308": ["--update-min-d", "1e308", "--update-min-a", "1e308"],
    "one beam": ["--max-beams", "1"],
    "beams of 30 digits": ["--max-beams", "9" * 30],
    "shift of infinity": ["--truth-shift", "inf"],
    "last ray without duration": ["--scan-stamp", "last", "--begin", "1e9"],
    "no such map": ["--map", "gone.yaml"],
}


def zeros_in_chunk(kind, compression):
    """A chunk of 300 MB in some kB."""
    bag = made_bag()
    bag.padding("/zeros", 2 * SECOND, 300 * 2**20)
    return lambda folder: ["convert", "bag", bag.write(folder / "bad", kind, compression), "-o", folder / "out.nc"]


def metadata(change):
    def make(folder):
        path = made_bag().write(folder / "bad", "mcap")
        text = (path / "metadata.yaml").read_text()
        (path / "metadata.yaml").write_text(change(text))
        return ["convert", "bag", path, "-o", folder / "out.nc"]

    return make


METADATA = {
    "empty": lambda text: "",
    "a list": lambda text: "- a\n",
    "objects": lambda text: text + "x: !!python/object/apply:os.system ['true']\n",
    "nested without end": lambda text: "[" * 50_000,
    "files elsewhere": lambda text: text.replace("bad.mcap", "/etc/passwd"),
    "files above": lambda text: text.replace("bad.mcap", "../../etc/passwd"),
    "no files": lambda text: text.replace("bad.mcap", "gone.mcap"),
    "version 99": lambda text: text.replace("version: 9", "version: 99"),
    "another storage": lambda text: text.replace("storage_identifier: mcap", "storage_identifier: sqlite3"),
    "a storage of numbers": lambda text: text.replace("storage_identifier: mcap", "storage_identifier: [1]"),
    "counts of words": lambda text: text.replace("message_count: 25", "message_count: many"),
    "topics of numbers": lambda text: text.replace("name: /scan", "name: 7"),
    "types of lists": lambda text: text.replace("type: sensor_msgs/msg/LaserScan", "type: [a]"),
    "a compression of no name": lambda text: text.replace("compression_mode: ''", "compression_mode: none of these"),
    "compressed files that are not": lambda text: text.replace(
        "compression_mode: ''", "compression_mode: file"
    ).replace("compression_format: ''", "compression_format: zstd"),
}

TEXTS = {
    "empty": b"",
    "blanks": b"\n \n\t\n",
    "null bytes": bytes(1000),
    "binary": bytes(range(256)) * 20,
    "a line of 2 MB": b"1 " * 1_000_000,
    "a name alone": b"FLASER\n",
    "another format": b"hello, world\n" * 10,
    "gzip, cut off": gzip.compress(b"O 1 1 0 5\n" * 1000, mtime=0)[:40],
    "gzip of nothing": gzip.compress(b"", mtime=0),
    "gzip of 200 million empty lines": gzip.compress(b"\n" * 10**7, mtime=0) * 20,
    "gzip of 1.2 GB of blanks": gzip.compress((b" " * 999_990 + b"\n") * 60, mtime=0) * 20,
    "gzip of gzip": gzip.compress(gzip.compress(b"O 1 1 0 5\n" * 10, mtime=0), mtime=0),
}

CSV = {
    "no columns": b"\n\n",
    "a header alone": b"time,odom_x,odom_y,odom_heading\n",
    "columns of one name": b"time,time\n0,0\n",
    "100 000 columns": (",".join(f"scan_{k}" for k in range(100_000)) + "\n0\n").encode(),
    "30 000 unknown columns": ("time," + ",".join(f"x{k}" for k in range(30_000)) + "\n").encode() + b"0\n",
    "a quote without end": b'time,odom_x\n"0,0\n' + b"1,1\n" * 1000,
    "semicolons": b"time;odom_x;odom_y;odom_heading\n0;0;0;0\n1;1;0;0\n",
    "UTF-16": "time,odom_x\n0,0\n".encode("utf-16"),
    "Latin-1": "time,odom_x,möbel\n0,0,0\n".encode("latin-1"),
    "a byte order mark within": b"time,\xef\xbb\xbfodom_x\n0,0\n",
    "6 million empty lines": b"\n" * 6_000_000,
}

MRCLAM_OPTIONS = {
    "period of 1e-9": ["--period", "1e-9"],
    "period of 1e-300": ["--period", "1e-300"],
    "period of zero": ["--period", "0"],
    "period of nan": ["--period", "nan"],
    "period of 1e300": ["--period", "1e300"],
    "begin of 1e300": ["--begin", "1e300"],
    "begin below zero": ["--begin", "-1"],
    "offset below zero": ["--max-offset", "-1"],
    "robot 99": ["--robot", "99"],
    "robot of 30 digits": ["--robot", "9" * 30],
}

MRCLAM_TABLES = {
    "Robot1_Odometry.dat": [
        "",
        "# nothing\n",
        "0 0\n",
        "a b c\n",
        "0 nan 0\n1 0 0\n",
        "1 0 0\n0 0 0\n",
        "0 1e308 1e308\n9 1e308 0\n",
        "0 0 0\n1e300 0 0\n",
        "0 0 0\n",
        "1e18 0.1 0\n1.1e18 0.1 0\n",
    ],
    "Robot1_Measurement.dat": [
        "",
        "0 72 1\n",
        "1 1e300 1 0\n",
        "1 72 -5 0\n",
        "1 72 1 1e9\n",
        "1 72 inf 0\n",
        "1 72.5 1 0\n",
        "1e300 72 1 0\n",
        "1 9 1 0\n",
    ],
    "Robot1_Groundtruth.dat": ["", "0 0 0\n", "1000 0 0 0\n2000 0 0 0\n", "0 1e300 0 0\n5 1e300 0 0\n", "0 nan 0 0\n"],
    "Barcodes.dat": ["", "1\n", "1e300 72\n", "6 72\n6 72\n", "-1 -1\n"],
    "Landmark_Groundtruth.dat": [
        "",
        "6 0 0\n",
        "1 0 0 0 0\n",
        "6 1e300 0 0 0\n",
        "6 0 0 0 0\n6 1 1 0 0\n",
        "1e300 0 0 0 0\n",
    ],
}

BARFOOT = {
    "no times": ("t", None),
    "times of text": ("t", "soon"),
    "times of nan": ("t", math.nan),
    "times of one": ("t", 0.0),
    "speeds of 1e308": ("v", 1e308),
    "distances below zero": ("r", -1.0),
    "distances of infinity": ("r", math.inf),
    "bearings of 1e9": ("b", 1e9),
    "tubes at 1e300": ("l", 1e300),
    "tubes of objects": ("l", np.array([["a", "b"]], dtype=object)),
    "a laser at nan": ("d", math.nan),
    "a laser of two": ("d", np.ones((2, 1))),
    "a path of nan": ("x_true", math.nan),
    "a path of 1e300": ("x_true", 1e300),
    "complex speeds": ("v", 1j),
    "1 x 1 tubes": ("l", np.ones((1, 1))),
    "3e7 times": ("t", np.zeros((30_000_000, 1), dtype=np.int8)),
}

_words = st.sampled_from(["nan", "inf", "-1", "1e308", "1e-320", "0", "x", "", "9" * 400, "-0", "1_0", "0x10", "٣"])
_edit = st.tuples(st.integers(0, 10**6), _words)


def edited(text: bytes, edits, separator: str | None) -> bytes:
    """Replace some words of a text."""
    lines = text.decode().splitlines()
    for place, word in edits:
        k = place % len(lines)
        words = lines[k].split(separator)
        if words:
            words[(place // len(lines)) % len(words)] = word
        lines[k] = (separator or " ").join(words)
    return ("\n".join(lines) + "\n").encode()


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""
    return [*_bags(sound), *_texts(sound), *_tables(sound), *_mat_files(sound), *_wean_maps(sound)]


def _bags(sound):
    def of(make_bag, kind="mcap", options=()):
        def make(folder):
            return ["convert", "bag", make_bag().write(folder / "bad", kind), "-o", folder / "out.nc", *options]

        return make

    def of_file(kind, change):
        def make(folder):
            path = folder / f"bad{SUFFIX[kind]}"
            path.write_bytes(change(sound.bag(kind).read_bytes()))
            return ["convert", "bag", path, "-o", folder / "out.nc"]

        return make

    found = [Case(FAMILY, f"bag, {name}", of(bag)) for name, bag in BAGS.items()]
    found += [Case(FAMILY, f"ROS 1 bag, {name}", of(BAGS[name], "ros1"), quick=False) for name in list(BAGS)[1::4]]
    found += [
        Case(FAMILY, f"bag, {name}", of(bag), EITHER, follow=using, quick=False) for name, bag in BAGS_EITHER.items()
    ]
    found += [
        Case(FAMILY, f"bag, {name}", of(made_bag, options=options), quick=False, of_option=True)
        for name, options in OPTIONS.items()
    ]
    found += [
        Case(FAMILY, f"bag, metadata: {name}", metadata(change), EITHER if name == "objects" else "refused")
        for name, change in METADATA.items()
    ]
    found += [
        Case(FAMILY, f"bag, 300 MB of zeros, {kind} {way}", zeros_in_chunk(kind, way), quick=False)
        for kind, way in (("ros1", "lz4"), ("ros1", "bz2"), ("mcap", "chunk"))
    ]
    for kind in KINDS:
        for k in range(9):
            found.append(
                Case(
                    FAMILY,
                    f"{kind} bag, cut {k}",
                    of_file(kind, lambda content, k=k: cut(content, k)),
                    quick=k % 4 == 2,
                )
            )
        for k in range(18):
            part = ((0.0, 1.0), (0.0, 0.05), (0.8, 1.0))[k % 3]
            count = (1, 3, 30)[k // 3 % 3]
            found.append(
                Case(
                    FAMILY,
                    f"{kind} bag, {count} bits flipped, {k}",
                    of_file(kind, lambda content, k=k, c=count, p=part: flipped(content, c, k, within=p)),
                    EITHER,
                    follow=using,
                    quick=k < 2,
                )
            )
    return found


def _texts(sound):
    def of(command, content, name):
        def make(folder):
            (folder / name).write_bytes(content)
            return ["convert", command, folder / name, "-o", folder / "out.nc"]

        return make

    found = []
    for command, whole, name, separator in (
        ("carmen", sound.carmen.read_bytes(), "bad.clf", None),
        ("wean", sound.wean.read_bytes(), "bad.log", None),
        ("csv", sound.csv.read_bytes(), "bad.csv", ","),
    ):
        for title, content in TEXTS.items():
            if command != "csv" or not title.startswith("gzip"):
                found.append(
                    Case(FAMILY, f"{command}, {title}", of(command, content, name), quick=len(content) < 10**5)
                )
        for k in range(9):
            found.append(
                Case(FAMILY, f"{command}, cut {k}", of(command, cut(whole, k), name), EITHER, follow=using, quick=False)
            )
        for k in range(8):
            found.append(
                Case(
                    FAMILY,
                    f"{command}, flipped {k}",
                    of(command, flipped(whole, (1, 5, 50)[k % 3], k), name),
                    EITHER,
                    follow=using,
                    quick=k < 1,
                )
            )
        for k, edits in enumerate(drawn(st.lists(_edit, min_size=1, max_size=4), 25)):
            found.append(
                Case(
                    FAMILY,
                    f"{command}, words {edits!r:.60}, {k}",
                    of(command, edited(whole, edits, separator), name),
                    EITHER,
                    follow=using,
                    quick=k < 2,
                )
            )
    found += [Case(FAMILY, f"csv, {name}", of("csv", content, "bad.csv")) for name, content in CSV.items()]
    return found


def _tables(sound):
    def of(name, content, options=()):
        def make(folder):
            shutil.copytree(sound.mrclam, folder / "bad")
            if name is not None:
                (folder / "bad" / name).write_text(content)
            return ["convert", "mrclam", folder / "bad", "-o", folder / "out.nc", *options]

        return make

    found = [Case(FAMILY, f"mrclam, {name}", of(None, "", options)) for name, options in MRCLAM_OPTIONS.items()]
    for name, contents in MRCLAM_TABLES.items():
        for k, content in enumerate(contents):
            found.append(
                Case(FAMILY, f"mrclam, {name} of {content!r:.40}", of(name, content), EITHER, follow=using, quick=k < 4)
            )
    return found


def _mat_files(sound):
    def of(name, value):
        def make(folder):
            content = {key: each for key, each in loadmat(sound.barfoot).items() if not key.startswith("__")}
            if value is None:
                del content[name]
            elif isinstance(value, float | complex):
                content[name] = np.full(content[name].shape, value)
            else:
                content[name] = value
            savemat(folder / "bad.mat", content, do_compression=True)
            return ["convert", "barfoot", folder / "bad.mat", "-o", folder / "out.nc"]

        return make

    def damaged(change):
        def make(folder):
            (folder / "bad.mat").write_bytes(change(sound.barfoot.read_bytes()))
            return ["convert", "barfoot", folder / "bad.mat", "-o", folder / "out.nc"]

        return make

    found = [Case(FAMILY, f"barfoot, {name}", of(*change)) for name, change in BARFOOT.items()]
    for k in range(9):
        found.append(
            Case(FAMILY, f"barfoot, cut {k}", damaged(lambda content, k=k: cut(content, k)), EITHER, quick=k == 6)
        )
    for k in range(12):
        found.append(
            Case(
                FAMILY,
                f"barfoot, flipped {k}",
                damaged(lambda content, k=k: flipped(content, (1, 3, 30)[k % 3], k)),
                EITHER,
                follow=using,
                quick=k < 1,
            )
        )
    return found


def _wean_maps(sound):
    whole = gzip.decompress(sound.wean_map.read_bytes())

    def of(content):
        def make(folder):
            (folder / "bad.dat").write_bytes(content)
            return ["convert", "wean", sound.wean, "--map", folder / "bad.dat", "-o", folder / "out.nc"]

        return make

    def piped(folder):
        os.mkfifo(folder / "bad.dat")
        return ["convert", "wean", sound.wean, "--map", folder / "bad.dat", "-o", folder / "out.nc"]

    contents = {
        "empty": b"",
        "no head": whole.split(b"\n", 3)[3],
        "10^9 cells": whole.replace(b"40 20", b"40000 25000"),
        "no cells": whole.replace(b"40 20", b"0 0"),
        "cells of 0 cm": whole.replace(b"resolution   10", b"resolution   0"),
        "cells of 1e9 cm": whole.replace(b"resolution   10", b"resolution   1000000000"),
        "cells of points": whole.replace(b"resolution   10", b"resolution   1.0.0"),
        "all unknown": whole.replace(b"1.0", b"-1").replace(b"0.0", b"-1"),
        "all free": whole.replace(b"0.0", b"1.0"),
        "words": whole.replace(b"1.0", b"one"),
        "probabilities of 5": whole.replace(b"1.0", b"5.0"),
        "nan": whole.replace(b"1.0", b"nan"),
        "half of them": whole[: len(whole) // 2],
        "gzip of a head and 10^8 blanks": gzip.compress(whole[:80], mtime=0) + gzip.compress(b" " * 10**8, mtime=0),
    }
    found = [Case(FAMILY, f"wean map, {name}", of(content)) for name, content in contents.items()]
    return [*found, Case(FAMILY, "wean map, a pipe", piped)]


def warm(sound: Sound) -> list[list[object]]:
    """Commands with sound recordings."""
    out = ["-o", sound.folder / "warm.nc"]
    return [
        *(["convert", "bag", sound.bag(kind), *out] for kind in KINDS),
        ["convert", "carmen", sound.carmen, *out],
        ["convert", "wean", sound.wean, "--map", sound.wean_map, *out],
        ["convert", "csv", sound.csv, *out],
        ["convert", "barfoot", sound.barfoot, *out],
        ["convert", "mrclam", sound.mrclam, *out],
        ["calibrate", sound.folder / "warm.nc", "--print-model"],
    ]
