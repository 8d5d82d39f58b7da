"""Searches for sources, their names, and what a SOURCE may be."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest
from refusals import is_refused

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.find_sources import find_sources
from trajeval_ros.io.source_names import names_of, names_with, split_name
from trajeval_ros.io.sources import parse_source, require_no_password


def folders(base: Path, depth: int) -> Path:
    path = base.joinpath(*(f"d{level}" for level in range(depth)))
    path.mkdir(parents=True, exist_ok=True)
    return path


TUM = "".join(f"{row}.0 {row} 0 0 0 0 0 1\n" for row in range(3))


def test_a_search_goes_four_levels_deep(tmp_path: Path) -> None:
    for depth in range(6):
        (folders(tmp_path, depth) / "run.txt").write_text(TUM)
    result = find_sources(tmp_path)
    levels = [len(source.path.relative_to(tmp_path).parts) - 1 for source in result.sources]
    assert sorted(levels) == [0, 1, 2, 3, 4]
    assert result.left_out == ("1 folder more than 4 levels deep",)
    (folders(tmp_path, 4) / "other").mkdir()
    assert find_sources(tmp_path).left_out == ("2 folders more than 4 levels deep",)


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("a.txt", TUM, "TUM"),
        ("a.TXT", TUM, "TUM"),
        ("a", TUM, "TUM"),
        ("a.md", TUM, None),
        ("a.txt", "words", None),
        ("a.mcap", "no bag", "MCAP"),
        ("a.mcap.zstd", "no bag", "MCAP"),
        ("a.db3", "no bag", "rosbag2 sqlite3"),
        ("a.bag", "no bag", "ROS 1 bag"),
        ("a.ulg", "no log", "PX4 log"),
    ],
)
def test_kinds_of_files(tmp_path: Path, name: str, content: str, kind: str | None) -> None:
    path = tmp_path / name
    path.write_text(content)
    result = find_sources(tmp_path)
    assert [source.kind for source in result.sources] == ([] if kind is None else [kind])
    assert result.others == (kind is None)
    if kind not in (None, "TUM"):
        assert result.sources[0].problem


@pytest.mark.parametrize(
    ("sources", "names"),
    [
        (["a/run.txt"], ["run"]),
        (["a/run.txt", "b/run.txt"], ["a/run", "b/run"]),
        (["x/a/run.txt", "y/a/run.txt"], ["x/a/run", "y/a/run"]),
        (["run.txt", "run.csv"], ["run#1", "run#2"]),
        (["run.txt", "run.txt", "b.txt"], ["run#1", "run#2", "b"]),
        (["b/x.mcap:/vio/odom", "b/x.mcap:/slam/odom"], ["vio_odom", "slam_odom"]),
        (["a.mcap:/vio", "b.mcap:/vio"], ["a.mcap/vio", "b.mcap/vio"]),
        (["a/run.v2.txt"], ["run.v2"]),
        (["a/run.a-b"], ["run.a-b"]),
        (["a/.txt"], [".txt"]),
        (["-"], ["stdin"]),
        (["s3://bucket/a/run.txt", "s3://bucket/b/run.txt"], ["a/run", "b/run"]),
        (["/"], ["/"]),
    ],
)
def test_short_names_of_sources(sources: list[str], names: list[str]) -> None:
    assert names_of(sources) == names
    assert names_with([""] * len(sources), sources) == names


def test_given_names_are_kept(tmp_path: Path) -> None:
    assert names_with(["x", "", "y"], ["a/1.txt", "b/2.txt", "c/3.txt"]) == ["x", "2", "y"]
    with pytest.raises(SettingsError, match="two sources have the name '2'"):
        names_with(["2", ""], ["a/1.txt", "b/2.txt"])
    path = tmp_path / "a=b"
    for text, parts in (
        ("vio=run.txt", ("vio", "run.txt")),
        (" vio =run.txt", ("vio", "run.txt")),
        ("=run.txt", ("", "=run.txt")),
        (" =run.txt", ("", " =run.txt")),
        ("a/b=run.txt", ("", "a/b=run.txt")),
        ("run.txt", ("", "run.txt")),
        ("vio=a=b", ("vio", "a=b")),
    ):
        assert split_name(text) == parts
    path.write_text("")
    with mock.patch("trajeval_ros.io.source_names.parse_source", return_value=None):
        assert split_name("a=b") == ("", "a=b")


@pytest.mark.parametrize(
    ("url", "refused"),
    [
        ("https://example.org/run.txt", False),
        ("https://user@example.org/run.txt", True),
        ("https://user:word@example.org/run.txt", True),
        ("s3://key@bucket/run.mcap", True),
        ("abfs://container@account/run.mcap", False),
        ("abfs://user:word@account/run.mcap", True),
        ("github://owner:name@branch/run.txt", False),
        ("https://example.org/a@b.txt", False),
        ("https://example.org/run.txt?x=a@b", False),
        ("filecache::https://user@example.org/run.txt", True),
        ("HTTPS://user@example.org/run.txt", True),
    ],
)
def test_urls_with_passwords_are_refused(url: str, *, refused: bool) -> None:
    assert is_refused(require_no_password, url) == refused


def test_the_longest_path_that_exists_is_the_file(tmp_path: Path) -> None:
    for name in ("a", "a:b"):
        (tmp_path / name).write_text(TUM)
    assert parse_source(f"{tmp_path}/a:b").path.name == "a:b"
    assert parse_source(f"{tmp_path}/a").path.name == "a"
    with pytest.raises(InputError, match="a is not a bag and has no topic c"):
        parse_source(f"{tmp_path}/a:c")
    with pytest.raises(InputError, match=r"run\.tx does not exist; check the path"):
        parse_source(f"{tmp_path}/run.tx")
    (tmp_path / "run.txt").write_text(TUM)
    with pytest.raises(InputError, match=r"did you mean .*run\.txt\?"):
        parse_source(f"{tmp_path}/run.tx:/topic")
    with pytest.raises(InputError, match="nor does the folder"):
        parse_source(f"{tmp_path}/none/run.txt")
    assert is_refused(parse_source, "")
    assert is_refused(parse_source, "/dev/null")
