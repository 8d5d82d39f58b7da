"""The figures of a comparison as files, and which of its runs compete for the best."""

from __future__ import annotations

from pathlib import Path

import pytest
from comparison_runs import compare, write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")

from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.report.matrix import to_latex


@pytest.mark.slow
def test_figures_are_written_as_files(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = write_runs(tmp_path, algorithms=["good"], trials=1)
    assert compare(config, "-q", output=out, figures=2) == 0
    stems = {"ate_position_m", "ate_rotation_deg"}
    for sequence in ("hall", "yard"):
        stems |= {f"re_position_percent_{sequence}", f"re_rotation_deg_{sequence}"}
        stems |= {f"trajectories_{sequence}", f"errors_{sequence}"}
    figures = out / "figures"
    assert {path.name for path in figures.iterdir()} == {f"{stem}.svg" for stem in stems}
    before = {path.name: path.read_bytes() for path in figures.iterdir()}
    for path in figures.glob("*hall*"):
        path.unlink()
    # Figures of a sequence that is gone do not stay, and those of the other are drawn again.
    with config.open("a") as file:
        file.write("sequences: [hall]\n")
    assert compare(config, "-q", output=out, figures=2) == 0
    assert not list(figures.glob("*yard*"))
    again = {path.name: path.read_bytes() for path in figures.glob("*hall*")}
    assert again == {name: content for name, content in before.items() if "hall" in name}


@pytest.mark.slow
def test_the_number_of_runs_with_figures_and_their_formats_are_chosen(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = write_runs(tmp_path, sequences=("hall",))
    kinds = "--figure-format", "pdf,png"
    assert compare(config, "--quiet", *kinds, output=out, figures=2) == 0
    assert {path.suffix for path in (out / "figures").iterdir()} == {".pdf", ".png"}
    assert (out / "figures" / "ate_position_m.pdf").read_bytes().startswith(b"%PDF")
    text = (out / "report.html").read_text()
    folded = text.split("<details ")[1:]
    # The runs with the largest errors have figures, all have numbers.
    assert ["<svg" in item for item in folded] == [False, False, True, True]
    assert "Figures are drawn for 2 runs with the largest error" in text
    # Other figures are drawn without an evaluation; none leave no figure of before.
    records = (out / "runs" / "all.records").read_bytes()
    assert compare(config, "--quiet", output=out) == 0
    assert not list((out / "figures").iterdir())
    text = (out / "report.html").read_text()
    assert "<svg" not in text
    assert 'href="#figures"' not in text
    assert (out / "runs" / "all.records").read_bytes() == records
    assert compare(config, "--quiet", "--figure-format", "gif", output=out) == 2


@pytest.mark.slow
def test_who_covers_less_than_the_others_is_never_the_best(tmp_path: Path) -> None:
    config = write_runs(tmp_path, sequences=("hall",), trials=1)
    write_run(tmp_path / "good" / "hall_trial0.txt", 1.001, count=150, seconds=10.0)
    out = tmp_path / "out"
    assert compare(config, "--quiet", output=out) == 0
    absolute, *_, relative = matrices(summary_of(out))[:3]
    for table in (absolute, relative):
        cells = dict(table.rows)
        good, bad = cells["good"][0], cells["bad"][0]
        assert good.value is not None
        assert bad.value is not None
        assert good.value < bad.value
        assert (good.is_ranked, bad.is_ranked) == (False, True)
        # The larger number is not marked as the best; the other one is marked as not ranked.
        assert not any(map(any, table.ranks()))
        assert good.marks.split()[-1] == "¶"
        assert "¶" not in bad.marks
        message = "¶ not ranked: good (covers 50 %)."
        assert message in table.caption
        assert message in (out / "tables.md").read_text()
        assert r"$^\P$ not ranked: good (covers 50 \%)." in to_latex(table)
    text = (out / "report.html").read_text()
    assert "smallest position ATE" not in text
    assert message in text
    assert "Compare only runs with the same coverage: use --common-time-span." in text
    # Where all cover as little, they compare.
    write_run(tmp_path / "bad" / "hall_trial0.txt", 1.03, count=150, seconds=10.0)
    assert compare(config, "--quiet", output=out) == 0
    assert matrices(summary_of(out))[0].ranks() == [[1], [2]]
    text = (out / "report.html").read_text()
    assert "good has the smallest position ATE on 1 of 1 sequence." in text


@pytest.mark.slow
def test_a_common_time_span_decides_ranks_coverage_and_advice(tmp_path: Path) -> None:
    config = write_runs(tmp_path, sequences=("hall",), trials=1)
    write_run(tmp_path / "good" / "hall_trial0.txt", 1.001, count=150, seconds=10.0)
    out = tmp_path / "out"
    assert compare(config, "-q", "--common-time-span", output=out) == 0
    absolute = matrices(summary_of(out))[0]
    assert absolute.ranks() == [[1], [2]]
    assert absolute.coverage == pytest.approx((1.0, 1.0), abs=0.02)
    assert "†" not in absolute.caption
    assert "¶" not in absolute.caption
    text = (out / "report.html").read_text()
    assert "good has the smallest position ATE on 1 of 1 sequence." in text
    assert "use --common-time-span" not in text
