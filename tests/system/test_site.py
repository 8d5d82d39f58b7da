"""What the documentation site has beside the pages in docs, and that it needs no network."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT

import trajeval_ros
from trajeval_ros.cli.app import VERBS, verb
from trajeval_ros.online import error_topics
from trajeval_ros.ros.parameter_table import PARAMETERS, SERVICES


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of docs/site."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    yield importlib.import_module
    for name in ("gallery", "offline", "reference"):
        sys.modules.pop(name, None)


def test_the_reference_has_every_command_and_option(site: Any) -> None:
    page = site("reference").command_line()
    assert re.findall(r"^## trajeval (.*)$", page, re.MULTILINE) == [
        name for name in VERBS if name != "evaluator"
    ]
    shown = {
        option
        for name in VERBS
        for parameter in verb(name).params
        if parameter.param_type_name == "option" and not parameter.hidden
        for option in parameter.opts
    }
    assert not [option for option in shown if f"{option}" not in page]
    assert "docs/" not in page


def test_the_reference_has_every_parameter_topic_and_service(site: Any) -> None:
    page = site("reference").parameters()
    table = page.partition("### Topics")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == [
        parameter.name for parameter in PARAMETERS
    ]
    assert table.count("Can be set while the node runs.") == sum(
        parameter.is_live for parameter in PARAMETERS
    )
    services = page.partition("### Services")[2]
    assert re.findall(r"^\| `(~/\w+)` \|", services, re.MULTILINE) == list(SERVICES)
    described = (ROOT / "docs/topics.md").read_text(encoding="utf-8")
    topics = [*error_topics.VECTORS, *error_topics.NUMBERS]
    topics += [f"{error_topics.ATE}/{part}" for part in error_topics.PARTS]
    topics += [*error_topics.NEES_NUMBERS, *error_topics.PROTECTION_LEVELS.values()]
    for topic in [*topics, error_topics.ALIGNMENT]:
        assert f"| `{topic}` |" in page
        assert f"`{topic}`" in described


def test_the_reference_names_the_public_names_at_their_homes(site: Any) -> None:
    result = re.findall(r"^::: trajeval_ros\.([\w.]+)\.(\w+)$", site("reference").names(), re.M)
    assert {name: home for home, name in result} == trajeval_ros._HOMES


def test_commands_of_the_gallery_exist(site: Any) -> None:
    gallery = site("gallery")
    for command in (*gallery.PREPARE, *(picture.command for picture in gallery.PICTURES)):
        program, name, *arguments = shlex.split(command)
        assert program == "trajeval"
        assert verb(name).make_context(name, arguments).params
    assert all(picture.file in gallery.section() for picture in gallery.PICTURES)


def test_dark_pages_invert_all_pictures_but_those_that_are_dark() -> None:
    reading = pytest.importorskip("matplotlib.image", reason="needs the extra `plot`")
    style = (ROOT / "docs/site/pages.css").read_text(encoding="utf-8")
    corners = {
        path.name: float(reading.imread(path)[0, 0, :3].mean())
        for path in (ROOT / "docs/images").glob("*.png")
    }
    assert set(corners.values()) <= {1.0} | {item for item in corners.values() if item < 0.2}
    dark = [name for name, lightness in corners.items() if lightness < 0.2]
    assert re.findall(r':not\(\[src\$="(.*)"\]\)', style) == dark


@pytest.mark.parametrize(
    ("name", "text", "outcome"),
    [
        ("a.html", '<a href="https://x.org">x</a><img src="a.png">', 0),
        ("a.html", '<link rel="canonical" href="https://x.org/a.html">', 0),
        ("a.html", '<script src="https://unpkg.com/a.js"></script>', 1),
        ("a.html", '<link rel="stylesheet" href="//fonts.example/a.css">', 1),
        ("a.html", '<img src="http://x.org/a.png"><iframe src="https://y.org"></iframe>', 2),
        ("a.html", "<p style=\"background: url('https://x.org/a.png')\"></p>", 1),
        ("a.html", '<a data-md-component="source" href="https://github.com/a/b">b</a>', 1),
        ("a.css", "@font-face { src: url(https://fonts.example/a.woff2) }", 1),
        ("a.css", "body { background: url(data:image/png;base64,AAAA), url(../a.png) }", 0),
        ("a.css", '@import "https://x.org/b.css";', 1),
    ],
)
def test_what_is_fetched_from_elsewhere_is_found(
    name: str, text: str, outcome: int, site: Any
) -> None:
    assert len(site("offline").fetched_from_elsewhere(name, text)) == outcome


def test_a_site_is_searched_for_it(tmp_path: Path, site: Any) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep/a.html").write_text('<script src="https://x.org/a.js"></script>')
    (tmp_path / "b.css").write_text("p { color: red }")
    assert site("offline").foreign_references(tmp_path) == ["deep/a.html: https://x.org/a.js"]
