"""Changed inputs of recordings with tracks, GNSS fixes, comparisons, clips and settings."""

from __future__ import annotations

import atexit
import functools
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from comparison_runs import here, write_runs
from fuzz_changes import (
    Changed,
    Make,
    Random,
    pick,
    with_other_bytes,
    with_other_cells,
    with_other_values,
    yaml_of,
)
from ruamel.yaml import YAML
from test_io_geographic import PLACES, gga, sentence
from test_watched_clip import LIMITS, description, said_of
from tracks_folders import PIXEL_NOISE, write_tracks_folder

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.shards import SHARD, Shard, merged
from trajeval_ros.io.bags.write_clip import ABOUT
from trajeval_ros.io.ground_image import read_ground_image
from trajeval_ros.io.live.watched_clip import read_watched_clip
from trajeval_ros.io.requests.hand_eye_file import read_similarity
from trajeval_ros.io.requests.limits_file import limits_mapping, read_limits
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.tracks.camera_file import read_camera
from trajeval_ros.io.tracks.tracks_folder import read_tracks_folder
from trajeval_ros.visual_inertial.keyframe_selection import select
from trajeval_ros.visual_inertial.preintegration import GRAVITY, ImuNoise


def make_tracks(random: Random, folder: Path) -> Changed:
    """Change a table, the camera's calibration, or bytes."""
    flight = folder / "flight"
    shutil.copytree(intact() / "flight", flight)
    name = pick(random, ["imu.csv", "tracks.csv", "groundtruth.csv", "camera.yaml"])
    path = flight / name
    if random.random() < 0.2:
        content, what = with_other_bytes(random, path.read_bytes())
        path.write_bytes(content)
    elif name == "camera.yaml":
        tree = with_other_values(random, YAML(typ="safe").load(path))
        what = repr(tree)
        path.write_bytes(yaml_of(tree))
    else:
        lines, what = with_other_cells(random, path.read_text().splitlines(), ",")
        path.write_text("\n".join(lines), encoding="utf-8")

    def read(strict: bool) -> None:  # noqa: ARG001
        recording = read_tracks_folder(flight)
        select(recording, 3, 30, PIXEL_NOISE, ImuNoise(1.7e-4, 2e-3), GRAVITY)

    return Changed(f"{name}: {what}", read)


def make_fixes(random: Random, folder: Path) -> Changed:
    """Change cells of GNSS fixes, in NMEA under valid checksums or not, or in named columns."""
    is_nmea = random.random() < 0.7
    path = folder / "x.txt"
    if not is_nmea:
        rows = [",".join(map(repr, (row, *place))) for row, place in enumerate(PLACES.tolist())]
        lines, what = with_other_cells(random, ["time,lat,lon,alt", *rows], ",")
    else:
        lines = [gga(row, place) for row, place in enumerate(PLACES)]
        lines.insert(4, sentence("GNRMC,000003.25,A,4724.0,N,00830.0,E,0.1,77.0,310324,,,R"))
        lines.insert(9, sentence("GNZDA,000007,31,03,2024,00,00"))
        bodies = [line[1:].partition("*")[0] for line in lines]
        bodies, what = with_other_cells(random, bodies, ",")
        lines = [sentence(body) for body in bodies]
    end = pick(random, ["\n", "\r\n", "\r"])
    content = end.join(lines).encode()
    if random.random() < 0.2:
        content, more = with_other_bytes(random, content)
        what = f"{what}, {more}"
    path.write_bytes(content)
    return Changed(what, lambda strict: read_trajectory(path, strict=strict))


def make_manifest(random: Random, folder: Path) -> Changed:
    """Change cells of a manifest, or its bytes."""
    lines = ["algorithm,sequence,trial,groundtruth,estimate"]
    lines += [f"{name},hall,{trial},t.txt,{name}{trial}.txt" for name in "ab" for trial in "01"]
    lines, what = with_other_cells(random, lines, ",")
    content = "\n".join(lines).encode()
    if random.random() < 0.3:
        content, what = with_other_bytes(random, content)
    path = folder / "runs.csv"
    path.write_bytes(content)
    return Changed(what, lambda strict: plan_of(path, {}) and None)


def make_shards(random: Random, folder: Path) -> Changed:
    """Change the head or a column of a shard, or its bytes."""
    import pyarrow
    from pyarrow import parquet

    path = folder / SHARD
    shutil.copy(intact() / "shard" / SHARD, path)
    if random.random() < 0.4:
        content, what = with_other_bytes(random, path.read_bytes())
        path.write_bytes(content)
    else:
        table = parquet.read_table(path)
        head = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
        tree = {**head, "trajeval.settings": json.loads(head["trajeval.settings"])}
        tree = with_other_values(random, tree) if random.random() < 0.7 else tree
        tree = tree if isinstance(tree, dict) else {}
        texts = {
            key: json.dumps(value) if key == "trajeval.settings" else str(value)
            for key, value in tree.items()
        }
        name = pick(random, table.column_names)
        place = table.column_names.index(name)
        values = pick(random, [[None], [-1], [3], [2**40], ["x"], [0.5], [[1]], [True]])
        if random.random() < 0.5:
            table = table.set_column(place, name, pyarrow.array(values * table.num_rows))
        what = f"{name} is {values}, {texts}"
        parquet.write_table(table.replace_schema_metadata(texts), path)
    return Changed(what, lambda strict: merged([folder]) and None)


def make_clip(random: Random, folder: Path) -> Changed:
    """Change values of the description of a clip."""
    about = with_other_values(random, description())
    (folder / ABOUT).write_text(json.dumps(about))

    def read(strict: bool) -> None:  # noqa: ARG001
        said_of(read_watched_clip(folder))

    return Changed(repr(about), read)


def make_settings(random: Random, folder: Path) -> Changed:
    """Change values of a file of limits, of a camera, of a map or of a transformation."""
    trees: dict[str, Any] = {
        "limits": limits_mapping(LIMITS),
        "camera": YAML(typ="safe").load(intact() / "flight" / "camera.yaml"),
        "map": {
            "image": "map.pgm", "resolution": 0.05, "origin": [0.0, 0.0, 0.0], "negate": 0,
            "occupied_thresh": 0.65, "free_thresh": 0.25, "mode": "trinary",
        },
        "transform": {
            "transform": {
                "translation": {"x": 0.1, "y": 0.2, "z": 0.3},
                "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
            "scale": 1.0,
        },
    }  # fmt: skip
    readers: dict[str, Any] = {
        "limits": read_limits,
        "camera": read_camera,
        "map": read_ground_image,
        "transform": read_similarity,
    }
    name = pick(random, list(trees))
    tree = with_other_values(random, trees[name])
    (folder / "map.pgm").write_bytes(b"P5 2 2 255\n" + bytes([0, 100, 205, 254]))
    path = folder / "x.yaml"
    path.write_bytes(yaml_of(tree))
    return Changed(repr(tree), lambda strict: readers[name](path) and None)


@functools.cache
def intact() -> Path:
    """Return a folder with an intact input of each kind that takes long to write."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    atexit.register(shutil.rmtree, folder)
    write_tracks_folder(folder / "flight")
    plan = plan_of(write_runs(folder / "runs", ["hall"], trials=1), {})
    run_plan(plan, folder / "shard", here, shard=Shard(1, 1))
    return folder


MORE_FORMATS: dict[str, Make] = {
    "tracks": make_tracks,
    "fixes": make_fixes,
    "manifest": make_manifest,
    "shards": make_shards,
    "clip": make_clip,
    "settings": make_settings,
}
