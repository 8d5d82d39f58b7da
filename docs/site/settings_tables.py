"""Writes what tables of the program state: settings, parameters and layouts of text files.

Run it after a change of one of them: make settings. A test compares the files.
"""

from __future__ import annotations

import json
import re
import textwrap
from pathlib import Path
from typing import Any

from trajeval_ros.io.requests.setting import NODE, Setting, as_text
from trajeval_ros.io.requests.settings_table import SETTINGS
from trajeval_ros.io.text.layouts import KNOWN, Layout
from trajeval_ros.ros.parameter_table import PARAMETERS, NodeParameter

ROOT = Path(__file__).resolve().parents[2]
PAGE, PARAMETER_FILE = ROOT / "docs/settings.md", ROOT / "config/evaluator.yaml"
BEGIN, END = "<!-- settings: written by make settings -->", "<!-- end of settings -->"
FORMATS = ROOT / "docs/trajectory.md"
# A default in the help of an option, which the page has in a column.
_STATED_DEFAULT = re.compile(r" Default: \S+\.(?= |$)| \(default(: [^ )]+)?\)(?!:)")
_EXAMPLES: dict[str, Any] = {
    "groundtruth_topic": "/groundtruth/pose",
    "estimate_topics": ["/vio/odometry"],
    "modality": "stereo-inertial",
}
# Headings of the parameter file, by the first parameter below them.
_GROUPS = {
    "groundtruth_topic": "Topics",
    "modality": "Alignment, association, relative errors and bodies",
    "datum": "GNSS fixes as groundtruth",
    "covariance": "Covariances and protection levels",
    "up": "Axes of the frames",
    "window": "The live run",
    "output": "Results, pictures and transforms",
    "watch": "Watching without groundtruth",
    "limits_position_error_m": "Alarms",
}
_HEAD = """\
# Parameters of `ros2 run trajeval_ros evaluator --ros-args --params-file evaluator.yaml`, with
# their defaults, but for examples of topics and modality. `ros2 param describe /evaluator NAME`
# describes one. Written by make settings.
/**:
  ros__parameters:
"""


def settings_table() -> str:
    """Return the table of all settings in Markdown."""
    rows = [
        _row(setting)
        for setting in SETTINGS.values()
        if setting.verbs or not setting.is_of_one_run
    ]
    return "\n".join(["| setting | default | where | meaning |", "|---|---|---|---|", *rows])


def _row(setting: Setting) -> str:
    where = [f"`{verb}`" for verb in setting.verbs if verb != NODE]
    where += ["node"] if NODE in setting.verbs else []
    if setting.targets[0].startswith("protocol.") and setting.name != "protocol":
        where.append("protocol")
    elif not setting.verbs:
        where.append("file of a comparison")
    default = setting.default
    shown = "" if default in (None, "") else f"`{json_text(default)}`"
    text = _STATED_DEFAULT.sub("", setting.text) if shown else setting.text
    meaning = re.sub(r"docs/(\w+)\.md", r"[\1](\1.md)", text).replace("|", "\\|")
    return f"| `{setting.name}` | {shown} | {', '.join(where)} | {meaning} |"


def layouts_table() -> str:
    """Return the table of all layouts of text files without a header in Markdown."""
    rows = [f"| {layout.name} | {_columns(layout)} | {_written_by(layout)} |" for layout in KNOWN]
    return "\n".join(["| layout | columns | written by |", "|---|---|---|", *rows])


def _written_by(layout: Layout) -> str:
    return layout.source if layout.up.name == "z" else f"{layout.source}; up is {layout.up.name}"


def _columns(layout: Layout) -> str:
    text = " ".join(layout.columns)
    text = re.sub(r"m11 .*m34", "m11 ... m34", text)
    text = re.sub(r"c11 .*c66", "c11 ... c66", text)
    text = re.sub(r"pr11 .*pt33", "pr11 ... pt33", text)
    text = re.sub(r"_( _){3,}", lambda ignored: f"_ ({len(ignored[0].split())} times)", text)
    return f"`{text}`"


def json_text(value: Any) -> str:
    """Return a default as it is written in YAML."""
    return str(value).lower() if isinstance(value, bool) else as_text(value)


def page_with(table: str, page: str) -> str:
    """Return a page with a table between the marks.

    Raises:
        ValueError: The page lacks the marks.
    """
    before, mark, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        raise ValueError("the page lacks the marks of the settings")
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


def parameter_file() -> str:
    """Return a file with all parameters of the node, their defaults and meanings."""
    return _HEAD + "".join(map(_parameter, PARAMETERS))


def _parameter(parameter: NodeParameter) -> str:
    first = re.split(r"(?<=[.])\s(?=[A-Z0-9])", parameter.description)[0]
    comment = textwrap.fill(first, 96, initial_indent="    # ", subsequent_indent="    # ")
    value = _EXAMPLES.get(parameter.name, parameter.default)
    group = _GROUPS.get(parameter.name, "")
    heading = f"\n    # --- {group} ---\n" if group else ""
    return f"{heading}{comment}\n    {parameter.name}: {_yaml(value)}\n"


def _yaml(value: Any) -> str:
    if isinstance(value, str):
        return value if re.fullmatch(r"[\w/][\w/,.-]*", value) else json.dumps(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    return json_text(value) if isinstance(value, bool) else repr(value)


def main() -> None:
    """Write the files."""
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(page_with(settings_table(), page), encoding="utf-8")
    formats = FORMATS.read_text(encoding="utf-8")
    FORMATS.write_text(page_with(layouts_table(), formats), encoding="utf-8")
    PARAMETER_FILE.write_text(parameter_file(), encoding="utf-8")


if __name__ == "__main__":
    main()
