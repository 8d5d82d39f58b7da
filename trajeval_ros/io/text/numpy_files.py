"""Arrays of numpy: .npy, .npz and arrays in Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.layouts import quaternion_in
from trajeval_ros.io.text.names import DATE, GROUPS, Layout
from trajeval_ros.io.text.table import EXACT, Rows

_MATRIX, _POSE = " ".join(GROUPS["matrix"]), "x y z qx qy qz qw"
_SHAPES = {
    (4, 4): f"{_MATRIX} _ _ _ _", (16,): f"{_MATRIX} _ _ _ _", (3, 4): _MATRIX, (12,): _MATRIX,
    (8,): f"t {_POSE}", (7,): _POSE, (4,): "t x y z", (3,): "x y z",
}  # fmt: skip
_SAID = "(N, 4, 4), (N, 3, 4), (N, 16), (N, 12), (N, 8), (N, 7), (N, 4) and (N, 3)"
_TIMES = ("tstamps", "timestamps", "times")
_EVO_RESULT = {"info.json", "stats.json"}  # files in a result of evo


def load(path: Path) -> tuple[Any, Floats | None]:
    """Return the array of poses in a file, and that of times if it has one (.npz)."""
    import zipfile  # slow, and only for arrays

    from trajeval_ros.io.npz_file import read_arrays

    content: Any
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
        if set(names) >= _EVO_RESULT:
            raise InputError(
                f"{path} has the errors of evo, and no poses; give the trajectories that evo "
                "compared, as in trajeval evaluate GROUNDTRUTH ESTIMATE --protocol evo"
            )
        arrays = [name.removesuffix(".npy") for name in names if name.endswith(".npy")]
        content = read_arrays(path, arrays[:50])
    else:
        try:
            content = np.load(path, allow_pickle=False)
        except Exception as error:  # of many types, for damaged headers
            raise InputError(f"{path} is not a readable array of numpy ({error})") from error
    array, times = content, []
    if isinstance(content, dict):
        poses = [part for part in content.values() if part.ndim > 1 and part.shape[1:] in _SHAPES]
        if len(poses) != 1:
            raise InputError(
                f"{path} has {counted(len(poses), 'array')} of poses "
                f"({', '.join(content) or 'none'}); save one of shape {_SAID} as .npy"
            )
        array = poses[0]
        times = [
            part
            for name, part in content.items()
            if part.shape == (len(array),) and "t" in name.lower()
        ]
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path} has values of type {array.dtype}; save an array of numbers")
    return array, times[0].astype(np.float64) if len(times) == 1 else None


def rows_of(path: Path, array: Any, named: Layout | None = None) -> tuple[Layout, Rows]:
    """Return the layout and the rows of an array, which messages name `path`."""
    if array.ndim < 2 or not len(array):
        raise InputError(f"{path} has shape {array.shape}; supported: {_SAID}")
    with np.errstate(invalid="ignore", over="ignore"):
        rows = array.reshape(len(array), -1).astype(np.float64)
    layout = named
    if layout is None:
        names = _SHAPES.get(array.shape[1:])
        if names is None:
            raise InputError(
                f"{path} has shape {array.shape}; supported: {_SAID}; for other columns, use "
                "{option} 't x y z qw qx qy qz'"
            )
        note = "float32: 7 digits" if array.dtype == np.float32 else ""
        shape = ", ".join(["N", *map(str, array.shape[1:])])
        layout = Layout(f"numpy ({shape})", tuple(names.split()), note)
        _check(path, layout, rows)
    if len(layout.columns) > rows.shape[1]:
        raise InputError(
            f"{path} has shape {array.shape}, and {{option}} names "
            f"{counted(len(layout.columns), 'column')}; name fewer"
        )
    if layout.time_name == DATE:
        raise InputError(f"{path} has numbers, and no dates; name the column of times t")
    texts = {name: rows[:, at] for at, name in enumerate(layout.columns) if name in EXACT}
    groups = {group: rows[:, list(places)] for group, places in layout.groups.items()}
    return layout, Rows(len(rows), texts, groups)


def _check(path: Path, layout: Layout, rows: Floats) -> None:
    """Refuse rows that are not the poses of their layout."""
    from trajeval_ros.geometry.array_input import require_poses

    if "matrix" in layout.groups:
        try:
            require_poses(rows.reshape(len(rows), -1, 4))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    if "quaternion" in layout.groups:
        finite, first = rows[np.isfinite(rows).all(axis=1)], layout.groups["position"][0]
        places = range(first, rows.shape[1])
        if tuple(quaternion_in(finite, places)) != layout.groups["quaternion"]:
            raise InputError(
                f"{path}: it is unclear which of the {rows.shape[1]} columns are the quaternion; "
                "name them, as in {option} 't x y z qw qx qy qz'"
            )


def files_of_times(path: Path) -> list[Path]:
    """Return the files next to an array or a text that may have the times of its rows."""
    names = [f"{path.stem}_times.txt", "times.txt"]
    if path.suffix == ".npy":
        stems = [path.stem.replace("poses", word) for word in _TIMES if "poses" in path.stem]
        stems += [f"{path.stem}_{word}" for word in _TIMES] + list(_TIMES)
        names = [f"{stem}{suffix}" for stem in stems for suffix in (".npy", ".txt")]
    folder = path / "x" if path.is_dir() else path
    paths = [folder.with_name(name) for name in names]
    return [file for file in paths if file.is_file() and file != path]
