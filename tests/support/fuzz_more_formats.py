"""Changed inputs of recordings with tracks, GNSS fixes, comparisons and settings."""

from __future__ import annotations

import atexit
import functools
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from comparison_runs import write_run
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
from nmea import PLACES, gga, sentence
from ruamel.yaml import YAML
from tracks_folders import PIXEL_NOISE, write_tracks_folder

from trajeval_ros.batch.compare_runs import write_tables
from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.finished_results import FinishedResults
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise
from trajeval_ros.io.hand_eye_file import read_similarity
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.papers.keyframe_selection import select
from trajeval_ros.papers.tracks_folder import read_camera, read_tracks_folder


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


def make_settings(random: Random, folder: Path) -> Changed:
    """Change values of a file of a camera or of a transformation."""
    trees: dict[str, Any] = {
        "camera": YAML(typ="safe").load(intact() / "flight" / "camera.yaml"),
        "transform": {
            "transform": {
                "translation": {"x": 0.1, "y": 0.2, "z": 0.3},
                "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
            "scale": 1.0,
        },
    }  # fmt: skip
    readers: dict[str, Any] = {
        "camera": read_camera,
        "transform": read_similarity,
    }
    name = pick(random, list(trees))
    tree = with_other_values(random, trees[name])
    path = folder / "x.yaml"
    path.write_bytes(yaml_of(tree))
    return Changed(repr(tree), lambda strict: readers[name](path) and None)


def make_results(random: Random, folder: Path) -> Changed:
    """Change values of result.json, or arrays or bytes of errors.npz."""
    results = folder / "results"
    shutil.copytree(intact() / "results", results)
    path, archive = results / "result.json", results / "errors.npz"
    kind, what = random.random(), "bytes"
    if kind < 0.6:
        tree = json.loads(path.read_text())
        key = pick(random, [*["runs"] * 4, *(key for key in tree if key != "schema")])
        tree[key] = with_other_values(random, tree[key])
        path.write_text(json.dumps(tree))
        what = "result.json"
    elif kind < 0.8:
        arrays = dict(np.load(archive))
        name = pick(random, list(arrays))
        others = [np.zeros(0), np.zeros((3, 3)), np.array("x"), np.full(300, np.nan), np.array(5)]
        arrays[name] = pick(random, [*others, arrays[name].astype(str), np.zeros(7)])
        np.savez(archive, **arrays)
        what = name
    else:
        changed = pick(random, [path, archive])
        changed.write_bytes(with_other_bytes(random, changed.read_bytes())[0])

    def read(strict: bool) -> None:
        output = folder / f"comparison_{strict}"
        (output / "runs").mkdir(parents=True)
        finished = FinishedResults([str(intact() / "results"), f"B={results}"])
        finished.write_tables(output)
        write_tables(output, summary_of(output), transpose=False)

    return Changed(what, read)


@functools.cache
def intact() -> Path:
    """Return a folder with an intact input of each kind that takes long to write."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    atexit.register(shutil.rmtree, folder)
    write_tracks_folder(folder / "flight")
    runs = [str(write_run(folder / f"{name}.txt", 1.0 + 0.01 * name)) for name in range(2)]
    main(["evaluate", *runs, "--lengths", "4,8", "--quiet", "--output", str(folder / "results")])
    return folder


MORE_FORMATS: dict[str, Make] = {
    "tracks": make_tracks,
    "fixes": make_fixes,
    "manifest": make_manifest,
    "settings": make_settings,
    "results": make_results,
}
