"""The file of metrics, read by the grammar of OpenMetrics."""

from __future__ import annotations

import math
import re
from pathlib import Path

from trajeval_ros.io.live.metrics_file import NAME, open_metrics, write_metrics

# ABNF of the OpenMetrics specification, of what a gauge needs.
TYPE = re.compile(r"# TYPE ([a-zA-Z_:][a-zA-Z0-9_:]*) gauge")
SAMPLE = re.compile(
    r'([a-zA-Z_:][a-zA-Z0-9_:]*)\{estimate="((?:[^"\\\n]|\\["\\n])*)"\} '
    r"(-?[0-9.]+(?:e[+-]?[0-9]+)?)"
)


def test_every_number_is_a_gauge_of_its_estimate() -> None:
    values = {
        "ATE position, window [m]": 0.125,
        "RE 2.5s, mean [m]": 1e-7,
        "pairs": 12,
        "nothing": None,
        "latency p95 [s]": math.nan,
        "estimate": "/vio",
    }
    text = open_metrics({"vio": values, 'a"b\\c': {"pairs": 3}})
    lines = text.split("\n")
    assert lines[-2:] == ["# EOF", ""]
    samples, name = {}, ""
    for line in lines[:-2]:
        if match := TYPE.fullmatch(line):
            name = match[1]  # the samples of a gauge follow its type
            continue
        match = SAMPLE.fullmatch(line)
        assert match is not None, line
        assert match[1] == name
        samples[name, match[2]] = float(match[3])
    assert samples == {
        ("trajeval_ate_position_window_m", "vio"): 0.125,
        ("trajeval_re_2_5s_mean_m", "vio"): 1e-7,
        ("trajeval_pairs", "vio"): 12.0,
        ("trajeval_pairs", r"a\"b\\c"): 3.0,
    }


def test_the_file_is_replaced(tmp_path: Path) -> None:
    write_metrics(tmp_path, {"vio": {"pairs": 1}})
    before = (tmp_path / NAME).stat().st_ino
    write_metrics(tmp_path, {"vio": {"pairs": 2}})
    assert (tmp_path / NAME).stat().st_ino != before
    assert 'trajeval_pairs{estimate="vio"} 2.0\n' in (tmp_path / NAME).read_text()
    assert [path.name for path in tmp_path.iterdir()] == [NAME]
