"""Results of version 0.2 have the same settings and numbers as evaluations of this version."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from paths import TESTS

from trajeval_ros.batch.earlier_results import of_version_0_2
from trajeval_ros.batch.finished_results import FinishedResults
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError

EARLIER = TESTS / "data" / "version_0_2"
PAIR = TESTS / "data" / "parity" / "pairs" / "few_digits"
OPTIONS = {
    "plain": "--modality stereo-inertial",
    "options": "--gauge sim3 --time-offset auto --correct suggested --lengths 2s,5 "
    "--align-states 50 --start 2 --protocol rpg",
}


def evaluated(name: str, folder: Path) -> Any:
    sources = [str(PAIR / "gt.txt"), str(PAIR / "est.txt")]
    assert main(["evaluate", *sources, *OPTIONS[name].split(), "--output", str(folder)]) == 0
    return json.loads((folder / "result.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIONS)
def test_settings_and_numbers_are_those_of_this_version(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    now = evaluated(name, tmp_path / "now")
    earlier = of_version_0_2(json.loads((EARLIER / f"{name}.json").read_text()))
    assert earlier["provenance"]["settings"] == now["provenance"]["settings"]
    [before], [after] = earlier["runs"], now["runs"]
    assert before.keys() >= after.keys()
    for error in ("position_m", "rotation_deg"):
        assert before["ate"][error] == pytest.approx(after["ate"][error], rel=1e-9)


@pytest.mark.slow
def test_a_result_of_version_0_2_stands_beside_one_of_this_version(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
    folders = [tmp_path / name for name in ("now", "then")]
    for folder in folders:
        evaluated("plain", folder)
    earlier = json.loads((EARLIER / "plain.json").read_text())
    # The errors are named by the estimate, as in the folder that version 0.2 wrote.
    (folders[1] / "result.json").write_text(json.dumps(earlier))
    before = of_version_0_2(earlier)["provenance"]["settings"]
    assert FinishedResults([*map(str, folders)]).settings == {**before, "common_time_span": False}
    out = tmp_path / "out"
    assert (
        main(["compare", "--figures", "0", *map(str, folders), "--output", str(out), "--quiet"])
        == 0
    )
    heading, *rows = (out / "ate_position_m.csv").read_text().splitlines()
    one, other = ([float(each) for each in row.split(",")[1:2]] for row in rows)
    assert heading.startswith("algorithm,")
    assert one == pytest.approx(other, rel=1e-9)


def test_a_damaged_result_of_version_0_2_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"schema": "trajeval/1", "runs": []}')
    (tmp_path / "errors.npz").touch()
    with pytest.raises(InputError, match=r"result\.json is damaged; evaluate the run again"):
        FinishedResults([str(tmp_path)])
