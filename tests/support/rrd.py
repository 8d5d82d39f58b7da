"""Reads Rerun's files back as numpy, with rerun-sdk alone."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from kept import shortened

TIMELINE = "ros_time"
_FEW_COLOURS = 12


class Rrd:
    """The rows of a file, by entity and component."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        with warnings.catch_warnings():  # a file that was cut off has no footer
            warnings.simplefilter("ignore")
            self._chunks = [
                (item.entity_path, item.is_static, item.to_record_batch())
                for item in RrdReader(str(path)).stream()
            ]

    @property
    def least_rows(self) -> int:
        """The number of rows of the smallest chunk; the viewer panics at a chunk without rows."""
        return min(batch.num_rows for _, _, batch in self._chunks)

    @property
    def clocks(self) -> set[str]:
        """The types of the timeline."""
        schemas = [batch.schema for _, is_static, batch in self._chunks if not is_static]
        return {str(schema.field(TIMELINE).type) for schema in schemas if TIMELINE in schema.names}

    @property
    def entities(self) -> set[str]:
        return {entity.strip("/") for entity, _, _ in self._chunks}

    def _components(self, entity: str) -> set[str]:
        own = [batch for path, _, batch in self._chunks if path.strip("/") == entity]
        return {name for batch in own for name in batch.schema.names if ":" in name}

    def described(self) -> str:
        """Return a line for every component: its numbers of rows and values, and some of them."""
        lines = []
        for entity, component in sorted(
            (e, c) for e in self.entities for c in self._components(e)
        ):
            stamps, rows = self.rows(entity, component)
            if component == "RecordingInfo:start_time":  # of the recording, not of the run
                continue
            values: Any = [item for row in rows for item in row]
            if component.endswith(":colors"):
                values = [*dict.fromkeys(f"#{value:08x}" for value in values)][:_FEW_COLOURS]
            elif not isinstance(values[0], str):
                values = np.concatenate([np.atleast_2d(value) for value in values])
            times = shortened((stamps - stamps[0]) / 1e9)
            lines.append(f"{entity} {component}: {len(rows)} at {times}: {shortened(values)}")
        return "\n".join(lines) + "\n"

    def rows(self, entity: str, component: str) -> tuple[np.ndarray, list[Any]]:
        """Return stamps (N,) in order and the values of each row; static rows have stamp 0."""
        result: list[tuple[int, Any]] = []
        for path, is_static, batch in self._chunks:
            if path.strip("/") != entity or component not in batch.schema.names:
                continue
            column = batch.column(component)
            for row in range(batch.num_rows):
                if column[row].is_valid:
                    stamp = 0 if is_static else batch.column(TIMELINE)[row].value
                    result.append((stamp, _values(column[row].values)))
        result.sort(key=lambda item: item[0])
        return np.array([item[0] for item in result], np.int64), [item[1] for item in result]

    def numbers(self, entity: str) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps and values without the NaN that end the lines of a plot."""
        stamps, rows = self.rows(entity, "Scalars:scalars")
        values = np.array([row[0] for row in rows], np.float64)
        known = np.isfinite(values)
        return stamps[known], values[known]

    def strips(self, entity: str) -> tuple[np.ndarray, list[list[np.ndarray]]]:
        return self.rows(entity, "LineStrips3D:strips")

    def path(self, entity: str, now: int) -> list[np.ndarray]:
        """Return the strips of a live path that are in sight at a time, coloured ones included."""
        result = []
        shown = f"{entity}/path/", f"{entity}/by_error"
        for part in sorted(item for item in self.entities if item.startswith(shown)):
            stamps, rows = self.strips(part)
            until = int(np.searchsorted(stamps, now, side="right"))
            result += [strip for row in rows[max(until - 1, 0) : until] for strip in row]
        return result

    def transforms(self, entity: str) -> tuple[np.ndarray, list[tuple[Any, Any, float]]]:
        """Return stamps, and rotation (3, 3), translation and scale of each."""
        stamps, rotations = self.rows(entity, "Transform3D:mat3x3")
        _, moves = self.rows(entity, "Transform3D:translation")
        _, scales = self.rows(entity, "Transform3D:scale")
        return stamps, [
            (rotation.reshape(3, 3).T, move[0], float(np.ravel(scale)[0]))
            for rotation, move, scale in zip(rotations, moves, scales, strict=True)
        ]


def described_layout(part: Any, indent: str = "") -> str:
    """Return a line for every container and view of a blueprint, and for its properties."""
    lines = [f"{indent}{type(part).__name__}: {_attributes(part, _LAYOUT)}"]
    for name, item in sorted(getattr(part, "properties", {}).items()):
        lines.append(
            f"{indent}  {name}: {_attributes(item, [own.name for own in item.__attrs_attrs__])}"
        )
    for path, item in sorted(getattr(part, "overrides", {}).items()):
        lines.append(f"{indent}  {path}: {item}")
    contents = getattr(part, "contents", [])
    inner = [content for content in contents if not isinstance(content, str)]
    return "\n".join([*lines, *(described_layout(item, f"{indent}  ") for item in inner)])


_LAYOUT = ("name", "origin", "contents", "row_shares", "column_shares", "active_tab")


def _attributes(thing: Any, names: Iterable[str]) -> str:
    result = {name: getattr(thing, name, None) for name in names}
    return ", ".join(
        f"{name} {item.as_arrow_array().to_pylist() if hasattr(item, 'as_arrow_array') else item}"
        for name, item in result.items()
        if item is not None and not (name == "contents" and not isinstance(item[0], str))
    )


def _values(values: pyarrow.Array) -> Any:
    kind = values.type
    if pyarrow.types.is_list(kind):
        width = kind.value_type.list_size
        return [np.array(value.values.flatten()).reshape(-1, width) for value in values]
    if pyarrow.types.is_fixed_size_list(kind):
        return np.array(values.flatten()).reshape(len(values), kind.list_size)
    return values.to_pylist()
