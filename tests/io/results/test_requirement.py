"""Requirements on results: bounds are exact, and what is no number is refused."""

from __future__ import annotations

import pytest
from refusals import is_refused

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.results.requirement import Requirement

RUN = {
    "ate": {"position_m": {"rmse": 0.25, "count": 7}, "form": "aligned"},
    "re": {"segments": [{"position_percent": {"mean": 1.5}}, None], "pooled": {"mean": 3.0}},
    "none": None,
    "flag": True,
}


@pytest.mark.parametrize(
    ("text", "unmet"),
    [
        ("ate.position_m.rmse < 0.25", "0.25"),
        ("ate.position_m.rmse <= 0.25", ""),
        ("ate.position_m.rmse<0.2501", ""),
        ("ate.position_m.rmse > 0.25", "0.25"),
        ("ate.position_m.rmse >= 0.25", ""),
        (" ate.position_m.count > 6.5 ", ""),
        ("re.8m.position_percent.mean < 2", ""),
        ("re.0_5m.position_percent.mean < 2", "re.0_5m.position_percent.mean was not computed"),
        ("re.pooled.mean < 3", "3"),
        ("none.x.y < 1", "none.x.y was not computed"),
    ],
)
def test_requirements_are_met_or_told(text: str, unmet: str) -> None:
    requirement = Requirement.parse(text)
    expected = f"{requirement} not met: {unmet}" if unmet else ""
    assert requirement.unmet(RUN, ["8m", "0.5m"]) == expected
    assert Requirement.parse(str(requirement)) == requirement


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("ate.position_m", "ate.position_m is not a number; add one of rmse, count"),
        ("ate", "ate is not a number; add one of position_m"),
        ("flag", "flag is not a number"),
        ("ate.form", "ate.form is not a number"),
        (
            "ate.position_mm.x",
            "results have no 'position_mm' in 'ate.position_mm.x'; did you mean",
        ),
        ("ate.xyz", "results have no 'xyz' in 'ate.xyz'; did you mean 'position_m'?"),
        ("ate.form.x", "results have no 'x' in 'ate.form.x'"),
        ("re.9m.x", "results have no '9m' in 're.9m.x'; did you mean '8m'?"),
        (
            "rmse",
            "results have no 'rmse' in 'rmse'; longer paths: ate.position_m.rmse, as in "
            "--require 'ate.position_m.rmse < 1'",
        ),
        (
            "mean",
            "results have no 'mean' in 'mean'; longer paths: re.8m.position_percent.mean, "
            "re.pooled.mean, as in --require 're.8m.position_percent.mean < 1'",
        ),
    ],
)
def test_requirements_on_what_is_no_number_are_refused(path: str, message: str) -> None:
    with pytest.raises(SettingsError) as raised:
        Requirement.parse(f"{path} < 1").unmet(RUN, ["8m", "0.5m"])
    assert str(raised.value).startswith(message)
    for text in (f"{path} = 1", "< 1", f"{path} < x", f"{path} <", f"{path} < 1e"):
        assert is_refused(Requirement.parse, text)
