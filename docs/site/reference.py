"""Reference pages in Markdown, written from the code: commands, parameters of the node, names."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import trajeval_ros
from trajeval_ros.cli.app import VERBS, verb
from trajeval_ros.online import error_topics
from trajeval_ros.ros.parameter_table import PARAMETERS, SERVICE_TYPE, SERVICES, NodeParameter

# The node's parameters are on a page of their own.
_VERBS = [name for name in VERBS if name != "evaluator"]


def command_line() -> str:
    """Return the page of all commands and their options."""
    lines = [
        "# Command line",
        "",
        "All commands and options, generated from the code. Exit status 0 means success, 1 means",
        "that a requirement does not hold, and 2 means invalid input or usage.",
        "",
        "[Settings](../settings.md#ros-2-parameters-and-services) lists the parameters of the",
        "node.",
    ]
    for name in _VERBS:
        lines += ["", *_command(name)]
    return "\n".join(lines) + "\n"


def _command(name: str) -> Iterator[str]:
    command = verb(name)
    arguments = [
        parameter for parameter in command.params if parameter.param_type_name == "argument"
    ]
    usage = " ".join(_value(item) for item in arguments)
    yield f"## trajeval {name}"
    yield ""
    yield f"    trajeval {name} [OPTIONS] {usage}".rstrip()
    yield ""
    yield _escaped_help(inspect.cleandoc(command.help or ""))
    for argument in arguments:
        yield ""
        yield f"* `{_value(argument)}`: {_plain(argument.help)}"
    panels: dict[str, list[Any]] = {}
    for parameter in command.params:
        if parameter.param_type_name == "option" and not parameter.hidden:
            panels.setdefault(getattr(parameter, "rich_help_panel", None) or "Options", []).append(
                parameter
            )
    for panel, options in panels.items():
        yield ""
        title = re.sub(r" \(docs/\w+\.md\)", "", panel)
        yield f"### {title} {{: #{_slug(name)}-{_slug(title)} }}"
        yield ""
        for option in options:
            names = ", ".join(sorted([*option.opts, *option.secondary_opts], key=len))
            yield f"* `{' '.join([names, _value(option)]).strip()}`{_default(option)}: " + _plain(
                option.help
            )


def _value(parameter: Any) -> str:
    if getattr(parameter, "is_flag", False):
        return ""
    return str(parameter.metavar or parameter.name.upper())


def _default(option: Any) -> str:
    default = option.default
    shown = option.show_default and not getattr(option, "is_flag", False)
    is_value = isinstance(default, (int, float, str)) and default != ""
    return f" (default: `{default}`)" if shown and is_value else ""


def _plain(text: str | None, pages: str = "../") -> str:
    return _escaped(" ".join((text or "").split()), pages)


def _escaped(text: str, pages: str = "../") -> str:
    """Escape Markdown, and link the pages that are named, which are in the folder `pages`."""
    escaped = re.sub(r"([<>*_\[\]])", r"\\\1", text)
    return re.sub(
        r"\bdocs/([\w\\]+)\.md", lambda page: _link(page[1].replace("\\", ""), pages), escaped
    )


def _link(page: str, pages: str) -> str:
    return f"[{page.replace('_', ' ')}]({pages}{page}.md)"


def _escaped_help(text: str) -> str:
    """Escape what is not code; paragraphs of code are indented."""
    blocks = text.split("\n\n")
    return "\n\n".join(
        block if block.startswith("    ") else _escaped(block).replace("`\\", "`")
        for block in blocks
    )


def _slug(text: str) -> str:
    return re.sub(r"\W+", "-", text.lower()).strip("-")


def parameters() -> str:
    """Return the section on the node's parameters, topics and services."""
    rows = "\n".join(map(_row, PARAMETERS))
    topics = [
        *((vector, error_topics.VECTOR_TYPE) for vector in error_topics.VECTORS),
        *((number, error_topics.NUMBER_TYPE) for number in error_topics.NUMBERS),
        *((f"{error_topics.ATE}/{part}", error_topics.VECTOR_TYPE) for part in error_topics.PARTS),
        *((nees_number, error_topics.NUMBER_TYPE) for nees_number in error_topics.NEES_NUMBERS),
        *(
            (protection_level, error_topics.NUMBER_TYPE)
            for protection_level in error_topics.PROTECTION_LEVELS.values()
        ),
        *(
            (f"{error_topics.relative_error_topic('8m')}/{part}", error_topics.VECTOR_TYPE)
            for part in error_topics.PARTS
        ),
        (error_topics.ALIGNMENT, error_topics.ALIGNMENT_TYPE),
        (error_topics.ALIGNED_PATH, "nav_msgs/msg/Path"),
        (error_topics.GROUNDTRUTH_PATH, "nav_msgs/msg/Path"),
    ]
    published = "\n".join(f"| `{name}` | `{kind}` |" for name, kind in topics)
    services = "\n".join(
        f"| `{name}` | `{SERVICE_TYPE}` | {_plain(service, '')} |"
        for name, service in SERVICES.items()
    )
    return f"""## ROS 2 parameters and services

The parameters of `ros2 run trajeval_ros evaluator`, generated from the code. Set them with
`--ros-args -p NAME:=VALUE` or in a file ([live evaluation](live.md)).

| parameter | default | description |
|---|---|---|
{rows}

### Topics

Published below `~/ESTIMATE/`. [ROS 2 topics](topics.md) describes their contents.

| topic | type |
|---|---|
{published}

The node also publishes `/diagnostics` (`{error_topics.DIAGNOSTICS_TYPE}`) and `~/event`
(`diagnostic_msgs/msg/DiagnosticStatus`).

### Services

| service | type | effect |
|---|---|---|
{services}
"""


def _row(item: NodeParameter) -> str:
    default = "" if item.default in ("", [""]) else f"`{item.default}`"
    limits = "" if item.range is None else f" Range: {item.range[0]:g} to {item.range[1]:g}."
    live = " Can be set while the node runs." if item.is_live else ""
    description = _plain(item.description, "").replace("|", "\\|")
    return f"| `{item.name}` | {default} | {description}{limits}{live} |"


def names() -> str:
    """Return the section of the public names, which mkdocstrings fills from their docstrings."""
    entries = "\n\n".join(
        f"::: trajeval_ros.{trajeval_ros._HOMES[name]}.{name}"
        for name in sorted(trajeval_ros.__all__, key=str.lower)
    )
    return f"## All names\n\nAll public names, from their docstrings.\n\n{entries}\n"
