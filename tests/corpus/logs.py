"""Bad robot logs: NetCDF files with wrong variables, with HDF5 that points elsewhere, and damaged ones."""

from __future__ import annotations

import os

import h5py
import numpy as np
import xarray as xr
from corpus.cases import EITHER, Case, cut, drawn, flipped
from corpus.sound import Sound
from hypothesis import strategies as st

FAMILY = "log"


def reading(folder):
    """The command that reads a log and does nothing with it."""
    return ["calibrate", folder / "bad.nc", "--print-model"]


def using(folder):
    return ["localize", folder / "bad.nc", "--method", "prior", "--particles", 20, "-o", folder / "out.nc"]


def load(path):
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        return dataset.load()


def edited(source, change, command=reading):
    """A case's files: a sound log with a changed dataset."""

    def make(folder):
        dataset = load(source())
        dataset = change(dataset)
        dataset.to_netcdf(folder / "bad.nc", engine="h5netcdf")
        return command(folder)

    return make


def rewritten(source, change):
    """A case's files: a sound log whose HDF5 is changed."""

    def make(folder):
        (folder / "bad.nc").write_bytes(source().read_bytes())
        with h5py.File(folder / "bad.nc", "r+") as file:
            change(file)
        return reading(folder)

    return make


def put(name, index, value):
    def change(dataset):
        values = np.array(dataset[name].values, dtype=float)
        values[index] = value
        return dataset.assign({name: (dataset[name].dims, values, dataset[name].attrs)})

    return change


def without(*names):
    return lambda dataset: dataset.drop_vars(names)


def attribute(name, value, of=None):
    def change(dataset):
        (dataset if of is None else dataset[of]).attrs[name] = value
        return dataset

    return change


def replaced(name, dims, values):
    return lambda dataset: dataset.drop_vars(name).assign({name: (dims, values)})


def labelled(dim, labels):
    return lambda dataset: dataset.assign_coords({dim: (dim, labels)})


OF_WALLS = {
    "format of two numbers": attribute("format", [1, 2]),
    "format of a number": attribute("format", 7.0),
    "empty format": attribute("format", ""),
    "no time": without("time"),
    "no odometry": without("odometry"),
    "no ranges": without("range", "beam_pose"),
    "no beam poses": without("beam_pose"),
    "no start": without("start_mean"),
    "no start_std": without("start_std"),
    "endless time": put("time", 3, np.inf),
    "time goes back": put("time", 3, 0.5),
    "all times equal": lambda d: d.assign_coords(time=("time", np.zeros(d.sizes["time"]))),
    "odometry of 1e308": put("odometry", (5, 0), 1e308),
    "odometry of -1e200": put("odometry", (5, 1), -1e200),
    "turn of 1e18": put("odometry", (5, 2), 1e18),
    "infinite odometry": put("odometry", (5, 2), -np.inf),
    "odometry of one row": lambda d: d.isel(time=slice(1)).drop_vars("range"),
    "ranges of minus infinity": put("range", (2, 3), -np.inf),
    "negative ranges": put("range", slice(None), -1.0),
    "max_range of text": attribute("max_range", "far", "range"),
    "max_range of nan": attribute("max_range", np.nan, "range"),
    "max_range of 1e300": attribute("max_range", 1e300, "range"),
    "max_range of two": attribute("max_range", [4.0, 5.0], "range"),
    "beam yaw in degrees": put("beam_pose", (0, 2), 90.0),
    "beam at 1e30": put("beam_pose", (0, 0), 1e30),
    "beam at nan": put("beam_pose", (1, 1), np.nan),
    "wall at nan": put("wall", (0, 0, 0), np.nan),
    "wall at 1e300": put("wall", (0, 0, 0), 1e300),
    "wall of no length": lambda d: put("wall", (0, 1), d["wall"].values[0, 0])(d),
    "one number as walls": replaced("wall", ("wall_index",), np.zeros(6)),
    "start outside": put("start_mean", 0, 500.0),
    "start at 1e100": put("start_mean", 1, 1e100),
    "start std negative": put("start_std", 1, -0.1),
    "start std nan": put("start_std", 1, np.nan),
    "start of four": replaced("start_mean", ("pose4",), np.zeros(4)),
    "labels twice": labelled("increment", ["forward", "forward", "turn"]),
    "labels of another kind": labelled("increment", ["a", "b", "c"]),
    "labels of poses twice": labelled("pose", ["x", "x", "heading"]),
    "time of text": replaced("time", ("time",), np.array([f"t{k}" for k in range(20)])),
    "odometry of text": lambda d: d.assign(odometry=(("time", "increment"), np.full((20, 3), "x"))),
    "odometry of truth values": lambda d: d.assign(odometry=(("time", "increment"), np.ones((20, 3), dtype=bool))),
    "odometry of another name": lambda d: d.rename(odometry="odom"),
    "ranges of another name": lambda d: d.rename(range="ranges"),
    "rows and beams swapped": lambda d: d.assign(range=(("beam2", "time2"), d["range"].values.T, d["range"].attrs)),
    "true_theta no JSON": attribute("true_theta", "{sigma"),
    "true_theta of words": attribute("true_theta", '{"sigma_turn": "large"}'),
    "true_theta nested without end": attribute("true_theta", "[" * 100_000),
    "map elsewhere": attribute("map", "/etc/passwd"),
    "map above": attribute("map", "../../room.yaml"),
    "map of nothing": attribute("map", "gone.yaml"),
    "map of numbers": attribute("map", [1.0, 2.0]),
    "scale of text": attribute("scale_factor", "wide", "range"),
    "no rows": lambda d: d.isel(time=slice(0)),
    "no wall": lambda d: d.isel(wall_index=slice(0)),
}

# Legal, or nearly so: the model may still refuse them.
OF_WALLS_EITHER = {
    "two rows": lambda d: d.isel(time=slice(2)),
    "one row": lambda d: d.isel(time=slice(1)),
    "robot of dollars": attribute("robot", "$\\frac{$ <b>&amp;"),
    "robot of numbers": attribute("robot", [1, 2]),
    "source of 100 kB": attribute("source", "x" * 60_000),
    "times in nanoseconds": lambda d: d.assign_coords(time=("time", 1.7e18 + 1e9 * np.arange(20.0))),
    "times a billionth apart": lambda d: d.assign_coords(time=("time", 1e-9 * np.arange(20.0))),
    "all ranges without end": put("range", slice(None), np.inf),
    "all ranges zero": put("range", slice(None), 0.0),
    "tiny max_range": attribute("max_range", 1e-300, "range"),
    "large max_range": attribute("max_range", 1e7, "range"),
    "start std of 1e-300": put("start_std", slice(None), 1e-300),
    "start std endless in x": put("start_std", 0, np.inf),
    "start heading unknown": put("start_std", 2, np.inf),
    "odometry of nothing": put("odometry", slice(None), 0.0),
    "odometry of 1e6 m": put("odometry", (5, 0), 1e6),
    "true pose of infinity": lambda d: d.assign(true_pose=(("time", "pose"), np.full((20, 3), np.inf))),
    "seed of text": attribute("seed", "seven"),
    "true_theta empty": attribute("true_theta", "{}"),
    "true_theta of nan": attribute("true_theta", '{"sigma_turn": NaN, "sigma_$": 1e400}'),
    "a foreign variable of texts": lambda d: d.assign(notes=("time", [f"row {k}" for k in range(20)])),
    "foreign dimensions": lambda d: d.assign(parameter=("parameter", [1.0, 2.0]), prior_grid=("prior_point", [0.0])),
    "whole numbers": lambda d: d.assign(
        range=(d["range"].dims, np.ones(d["range"].shape, dtype=int), d["range"].attrs)
    ),
    "single precision": lambda d: d.assign(odometry=d["odometry"].astype("f4")),
    "range of huge numbers": put("range", slice(None), 1e300),
}

OF_LANDMARKS = {
    "no map": without("landmark_position"),
    "landmark at 1e200": put("landmark_position", (0, 0), 1e200),
    "landmark at nan": put("landmark_position", (0, 0), np.nan),
    "distance of 1e30": put("landmark_range", (3, 1), 1e30),
    "distance below zero": put("landmark_range", (3, 1), -2.0),
    "endless bearing": put("landmark_bearing", (3, 1), np.inf),
    "bearing in degrees": put("landmark_bearing", (3, 1), 170.0),
    "names twice": labelled("landmark", ["a", "a", "b"]),
    "offset of infinity": lambda d: d.assign(landmark_time_offset=(("time", "landmark"), np.full((15, 3), np.inf))),
    "offset of 1e30 s": lambda d: d.assign(landmark_time_offset=(("time", "landmark"), np.full((15, 3), 1e30))),
    "sensor at nan": lambda d: d.assign(landmark_sensor_pose=("pose", [np.nan, 0.0, 0.0])),
    "sensor at 1e15": lambda d: d.assign(landmark_sensor_pose=("pose", [1e15, 0.0, 0.0])),
    "size of 1e20 pixels": lambda d: d.assign(landmark_size=(("time", "landmark"), np.full((15, 3), 1e20))),
}

OF_LANDMARKS_EITHER = {
    "names of dollars": labelled("landmark", ["$", "$x_{$", "<script>"]),
    "all landmarks in one place": put("landmark_position", slice(None), 1.0),
    "names of numbers": labelled("landmark", [3.5, 1e300, -1.0]),
    "landmarks on the path": put("landmark_position", slice(None), 0.0),
}

OF_LIDAR = {
    "no angles": without("scan_angle"),
    "angles alone": without("scan"),
    "angles in degrees": lambda d: d.assign(scan_angle=("ray", np.degrees(d["scan_angle"].values))),
    "angle of nan": put("scan_angle", 2, np.nan),
    "no reach": attribute("max_range", 0.0, "scan"),
    "endless reach": attribute("max_range", np.inf, "scan"),
    "reach of 3e38": attribute("max_range", 3.4e38, "scan"),
    "min above max": attribute("min_range", 20.0, "scan"),
    "mount of text": attribute("pose", "front", "scan"),
    "mount of 1e9 m": attribute("pose", [1e9, 0.0, 0.0], "scan"),
    "mount in degrees": attribute("pose", [0.0, 0.0, 180.0], "scan"),
    "mount of two": attribute("pose", [0.0, 0.0], "scan"),
    "scans below zero": put("scan", (3, 4), -0.5),
}

# Logs that are legal, but of no use to a model or filter.
USELESS = {
    "no walls": without("wall"),
    "all ranges missing": put("range", slice(None), np.nan),
    "no beams": lambda d: d.isel(beam=slice(0)),
}


def _nothing_seen(dataset):
    return put("landmark_bearing", slice(None), np.nan)(put("landmark_range", slice(None), np.nan)(dataset))


def links(file):
    del file["wall"]
    file["wall"] = h5py.ExternalLink("/etc/hostname", "/wall")


def nested_links(file):
    group = file.create_group("a/b/c")
    group["wall"] = h5py.ExternalLink("/etc/passwd", "/")


def virtual(file):
    shape = file["range"].shape
    del file["range"]
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "x", shape=shape)
    file.create_virtual_dataset("range", layout)


def nested_virtual(file):
    layout = h5py.VirtualLayout((5,), "f8")
    layout[:] = h5py.VirtualSource("elsewhere.nc", "x", shape=(5,))
    file.create_group("extra/more").create_virtual_dataset("values", layout)


def raw(file):
    del file["wall"]
    file.create_dataset("wall", (6, 2, 2), "f8", external=[("/etc/passwd", 0, 192)])


def nested_raw(file):
    file.create_group("extra").create_dataset("values", (4,), "u1", external=[("/etc/passwd", 0, 4)])


def many(count):
    def change(file):
        for k in range(count):
            file[f"extra_{k}"] = np.zeros(2)

    return change


def deep(file):
    group = file
    for k in range(200):
        group = group.create_group(f"g{k}")


OF_HDF5 = {
    "an external link": links,
    "an external link in a group": nested_links,
    "a virtual data set": virtual,
    "a virtual data set in a group": nested_virtual,
    "external raw storage": raw,
    "external raw storage in a group": nested_raw,
    "a soft link": lambda file: file.__setitem__("other", h5py.SoftLink("/range")),
    "a soft link to nothing": lambda file: file.__setitem__("other", h5py.SoftLink("/nothing")),
    "a group within itself": lambda file: file.create_group("g").__setitem__("again", file["/"]),
    "groups 200 deep": deep,
    "10^12 cells declared": lambda file: file.create_dataset("scan", (10**6, 10**6), "f8", chunks=(100, 100)),
    "10^12 cells of nothing known": lambda file: file.create_dataset("big", (10**6, 10**6), "f8", chunks=(100, 100)),
    "5e8 zeros, compressed": lambda file: file.create_dataset(
        "big", (5 * 10**8,), "f8", chunks=(10**6,), compression="gzip"
    ),
    "3000 variables": many(3000),
    "a type in place of odometry": lambda file: (
        file.__delitem__("odometry"),
        file.__setitem__("odometry", np.dtype("f8")),
    ),
    "a group in place of odometry": lambda file: (file.__delitem__("odometry"), file.create_group("odometry")),
    "nothing in place of odometry": lambda file: (
        file.__delitem__("odometry"),
        file.__setitem__("odometry", h5py.Empty("f8")),
    ),
    "records in place of odometry": lambda file: (
        file.__delitem__("odometry"),
        file.__setitem__("odometry", np.zeros((20, 3), dtype=[("a", "f8"), ("b", "i4")])),
    ),
}

OF_HDF5_EITHER = {
    "references": lambda file: file.create_dataset("refs", data=np.array([file.ref] * 3, dtype=h5py.ref_dtype)),
    "300 variables": many(300),
    "an array of arrays": lambda file: file.create_dataset("ragged", (3,), h5py.vlen_dtype("f8")),
    "an enumeration": lambda file: file.create_dataset("kinds", data=np.zeros(3, dtype=h5py.enum_dtype({"A": 0}))),
    "opaque bytes": lambda file: file.create_dataset("bytes", data=np.zeros(3, dtype="V5")),
    "an attribute of 60 kB": lambda file: file.attrs.__setitem__("notes", np.zeros(8000)),
}


def sparse(source):
    """4 GB of zeros that take no room on disk, as a variable that no log has."""

    def make(folder):
        (folder / "bad.nc").write_bytes(source().read_bytes())
        with h5py.File(folder / "bad.nc", "r+") as file:
            properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            space = h5py.h5s.create_simple((5 * 10**8,))
            h5py.h5d.create(file.id, b"big", h5py.h5t.NATIVE_DOUBLE, space, dcpl=properties)
        return reading(folder)

    return make


def classic(source, change):
    def make(folder):
        dataset = load(source())
        (dataset.drop_vars("time") if "time" not in dataset.dims else dataset).to_netcdf(
            folder / "bad.nc", engine="scipy", format="NETCDF3_64BIT"
        )
        (folder / "bad.nc").write_bytes(change((folder / "bad.nc").read_bytes()))
        return reading(folder)

    return make


def damaged(source, change):
    def make(folder):
        (folder / "bad.nc").write_bytes(change(source().read_bytes()))
        return reading(folder)

    return make


def special(create):
    def make(folder):
        create(folder / "bad.nc")
        return reading(folder)

    return make


SPECIAL = {
    "a folder": lambda path: path.mkdir(),
    "a pipe": os.mkfifo,
    "a link in a circle": lambda path: path.symlink_to(path),
    "a device without end": lambda path: path.symlink_to("/dev/zero"),
    "text": lambda path: path.write_text("time,odometry\n0,0\n"),
    "nothing": lambda path: None,
    "the classic magic number alone": lambda path: path.write_bytes(b"CDF\x01"),
    "the classic format of 2^31 records": lambda path: path.write_bytes(b"CDF\x01\x7f\xff\xff\xff" + bytes(64)),
    "HDF5's magic number alone": lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n"),
}

_wild = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-320, 1e-9, 1e3, 1e9, 1e19, 1e154, 1e308, -1e308])
_change = st.tuples(
    st.sampled_from(["time", "odometry", "range", "beam_pose", "wall", "start_mean", "start_std"]),
    st.integers(0, 10**6),
    st.one_of(_wild, st.floats(allow_nan=True, width=64)),
)


def _mutated(source, changes):
    def change(dataset):
        for name, place, value in changes:
            values = np.array(dataset[name].values, dtype=float)
            values.flat[place % values.size] = value
            dataset = dataset.assign({name: (dataset[name].dims, values, dataset[name].attrs)})
        return dataset

    return edited(source, change)


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""

    def walls():
        return sound.walls_log

    def landmarks():
        return sound.landmarks_log

    def lidar():
        return sound.lidar_log

    found = [Case(FAMILY, name, edited(walls, change)) for name, change in OF_WALLS.items()]
    found += [Case(FAMILY, name, edited(walls, change), EITHER, follow=using, quick=False)
              for name, change in OF_WALLS_EITHER.items()]  # fmt: skip
    found += [Case(FAMILY, f"landmarks, {name}", edited(landmarks, change)) for name, change in OF_LANDMARKS.items()]
    found += [Case(FAMILY, f"landmarks, {name}", edited(landmarks, change), EITHER, follow=using, quick=False)
              for name, change in OF_LANDMARKS_EITHER.items()]  # fmt: skip
    found += [Case(FAMILY, f"lidar, {name}", edited(lidar, change)) for name, change in OF_LIDAR.items()]
    found += [Case(FAMILY, name, edited(walls, change, using)) for name, change in USELESS.items()]
    found += [Case(FAMILY, "landmarks, nothing seen", edited(landmarks, _nothing_seen, using))]
    found += [Case(FAMILY, "lidar, nothing measured", edited(lidar, put("scan", slice(None), np.nan), using))]
    found += [Case(FAMILY, f"HDF5, {name}", rewritten(walls, change)) for name, change in OF_HDF5.items()]
    found += [Case(FAMILY, f"HDF5, {name}", rewritten(walls, change), EITHER, follow=using, quick=False)
              for name, change in OF_HDF5_EITHER.items()]  # fmt: skip
    found += [
        Case(
            FAMILY,
            "a foreign variable of 5e8 cells",
            sparse(walls),
            says="at most 20000000 numbers in a log, got '/big'",
        )
    ]
    found += [Case(FAMILY, name, special(create)) for name, create in SPECIAL.items()]
    for k in range(9):
        found.append(Case(FAMILY, f"cut {k}", damaged(walls, lambda content, k=k: cut(content, k)), quick=k % 4 == 0))
        found.append(Case(FAMILY, f"classic, cut {k}", classic(walls, lambda content, k=k: cut(content, k)), EITHER,
                          follow=using, quick=False))  # fmt: skip
    for k in range(40):
        count = (1, 3, 30, 300)[k % 4]
        part = ((0.0, 1.0), (0.0, 0.1), (0.5, 1.0))[k % 3]
        found.append(Case(FAMILY, f"{count} bits flipped, {k}", damaged(
            walls, lambda content, c=count, k=k, p=part: flipped(content, c, k, within=p)), EITHER, follow=using,
            quick=k < 4))  # fmt: skip
        if k % 3 == 0:
            found.append(Case(FAMILY, f"classic, {count} bits flipped, {k}", classic(
                walls, lambda content, c=count, k=k, p=part: flipped(content, c, k, within=p)), EITHER, follow=using,
                quick=k == 0))  # fmt: skip
    for k, changes in enumerate(drawn(st.lists(_change, min_size=1, max_size=4), 40)):
        found.append(Case(FAMILY, f"changed numbers {k}: {changes}", _mutated(walls, changes), EITHER, follow=using,
                          quick=k < 3))  # fmt: skip
    return found


def warm(sound: Sound) -> list[list[object]]:
    """Commands with sound logs, which make everything ready that cases need."""
    out = sound.folder / "warm.nc"
    use = ["--method", "prior", "--particles", 20, "-o", out]
    return [
        ["calibrate", sound.walls_log, "--print-model"],
        ["localize", sound.walls_log, *use],
        ["localize", sound.landmarks_log, *use],
        ["localize", sound.walls_log, *use, "--start", "anywhere"],
    ]
