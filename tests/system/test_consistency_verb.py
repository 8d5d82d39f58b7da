"""From `trajeval simulate` to a verdict about covariances, and what can't be used for one."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajeval_ros.cli.app import main
from trajeval_ros.consistency.consistency_result import BOUND_STATEMENT, OWN_GAUGE_STATEMENT
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.io.covariance_file import read_joint_covariance, write_joint_covariance
from trajeval_ros.io.sources import read_trajectory

SECONDS = "6"


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of the estimator, with its joint covariance beside it."""
    bag = tmp_path_factory.mktemp("honest") / "flight"
    arguments = ["--profile", "euroc", "--duration", SECONDS, "--seed", "2"]
    assert main(["simulate", str(bag), *arguments]) == 0
    return bag


@pytest.fixture(scope="module")
def overconfident(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("bad") / "flight"
    arguments = ["--profile", "overconfident", "--duration", SECONDS]
    assert main(["simulate", str(bag), *arguments]) == 0
    return bag


def _evaluate(bag: Path, *arguments: str) -> dict[str, Any]:
    result = bag.with_name("result.json")
    sides = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    given = ["evaluate", *sides, "--lengths", "none", "--json", str(result), *arguments]
    assert main([*given, "--quiet"]) == 0
    (run,) = json.loads(result.read_text())["runs"]
    return run["consistency"]


def _refused(bag: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    sides = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    assert main(["evaluate", *sides, *arguments]) == 2
    text = capsys.readouterr().err
    assert len(text.splitlines()) == 1
    return text


ALIGNMENTS = [
    ["--gauge", "yaw", "--align-states", "1"],
    ["--gauge", "yaw"],
    ["--gauge", "se3"],
    ["--gauge", "sim3"],
    ["--gauge", "yaw", "--align-states", "20"],
]


@pytest.mark.slow
@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_joint_covariance_acquits_and_convicts_in_every_gauge(
    honest: Path, overconfident: Path, alignment: list[str]
) -> None:
    good = _evaluate(honest, *alignment, "--covariance", f"{honest}.npz")
    assert (good["exactness"], good["verdict"]) == ("exact", "consistent")
    assert good["gauge"] == alignment[1]
    low, high = good["joint"]["band_95"]
    assert low < good["joint"]["nees_per_dof"] < high
    dimensions = {"yaw": 4, "se3": 6, "sim3": 7}
    assert good["joint"]["dof"] == 6 * 61 - dimensions[alignment[1]]
    assert 6 < good["per_pose"]["effective_dof"] < 366
    bad = _evaluate(overconfident, *alignment, "--covariance", f"{overconfident}.npz")
    assert bad["verdict"] == "overconfident"


def test_messages_are_exact_in_the_estimators_own_gauge_alone(
    honest: Path, overconfident: Path
) -> None:
    own, other = ALIGNMENTS[0], ALIGNMENTS[1]
    exact = _evaluate(honest, *own, "--covariance", "message")
    assert (exact["exactness"], exact["statement"]) == ("exact", OWN_GAUGE_STATEMENT)
    assert exact["verdict"] == "undecided"
    # The mean over the poses of one run has no band that marginals could tell.
    assert exact["joint"] is None
    assert exact["per_pose"]["band_95"] is None
    joint = _evaluate(honest, *own, "--covariance", f"{honest}.npz")
    # To first order: the published gauge is upright, the alignment's leans as the estimate errs.
    assert exact["per_pose"]["mean"] == pytest.approx(joint["per_pose"]["mean"], rel=1e-3)
    bound = _evaluate(honest, *other, "--covariance", "message")
    assert (bound["exactness"], bound["statement"]) == ("bound", BOUND_STATEMENT)
    joint = _evaluate(honest, *other, "--covariance", f"{honest}.npz")
    assert bound["per_pose"]["mean"] < joint["per_pose"]["mean"]
    assert _evaluate(overconfident, *own, "--covariance", "message")["verdict"] == "overconfident"
    assert _evaluate(honest, *own) is None


def test_groundtruth_noise_makes_errors_less_of_a_surprise(honest: Path) -> None:
    for source in ("message", f"{honest}.npz"):
        with_noise, without = (
            _evaluate(honest, *ALIGNMENTS[0], "--covariance", source, *noise)
            for noise in (["--groundtruth-noise", "0.01,0.2"], [])
        )
        assert with_noise["per_pose"]["mean"] < without["per_pose"]["mean"]


@pytest.mark.slow
def test_output_holds_the_bands(honest: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    sides = ["-g", f"{honest}:/groundtruth/pose", "-e", f"{honest}:/vio/odometry"]
    arguments = ["--gauge", "yaw", "--covariance", f"{honest}.npz", "--output", str(folder)]
    assert main(["evaluate", *sides, *arguments, "--quiet"]) == 0
    if find_spec("matplotlib") is not None:
        from matplotlib.image import imread

        for figure in ("consistency.png", "uncertainty_top.png"):
            assert imread(folder / figure).std() > 0.05
    with np.load(folder / "errors.npz") as arrays:
        errors, sigmas, nees = (
            arrays[f"vio_odometry.consistency.{name}"] for name in ("errors", "sigmas", "nees")
        )
        np.testing.assert_allclose(
            np.linalg.norm(errors[:, :3], axis=1), arrays["vio_odometry.position_m"], atol=1e-12
        )
    assert errors.shape == sigmas.shape == (61, 6)
    assert np.abs(errors / sigmas).max() < 6.0
    assert nees.shape == (61,)


@pytest.mark.slow
def test_runs_differ_in_noise_and_share_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "many"
    given = ["simulate", str(bag), "--profile", "paper", "--duration", "12", "--runs", "3"]
    assert main([*given, "--storage", "sqlite3"]) == 0
    assert "sampled" in capsys.readouterr().out
    bags = [tmp_path / f"many_{number}" for number in range(3)]
    truths = [read_trajectory(f"{item}:/groundtruth/pose") for item in bags]
    estimates = [read_trajectory(f"{item}:/vio/odometry") for item in bags]
    np.testing.assert_array_equal(truths[0].positions, truths[2].positions)
    assert not np.array_equal(estimates[0].positions, estimates[1].positions)
    # The same seed gives the same bytes.
    first = (tmp_path / "many_1.npz").read_bytes(), estimates[1].positions
    assert main([*given, "--storage", "sqlite3", "--overwrite"]) == 0
    assert (tmp_path / "many_1.npz").read_bytes() == first[0]
    again = read_trajectory(f"{bags[1]}:/vio/odometry")
    np.testing.assert_array_equal(again.positions, first[1])
    for item in bags[:1]:
        result = _evaluate(item, "--gauge", "yaw", "--covariance", f"{item}.npz")
        assert result["verdict"] in ("consistent", "overconfident", "conservative")
        assert result["joint"]["nees_per_dof"] == pytest.approx(1.0, abs=0.2)


def _changed(path: Path, **changes: Any) -> dict[str, Any]:
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays.update(changes)
    return {name: value for name, value in arrays.items() if value is not None}


def test_says_what_is_wrong_with_a_joint_covariance(
    honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, file = Path(f"{honest}.npz"), tmp_path / "joint.npz"
    covariance = np.eye(549)
    no_information = dict.fromkeys(("info_data", "info_indices", "info_indptr"))
    with np.load(source) as archive:
        stamps, positions = archive["stamps_ns"], archive["positions"]
    negative = covariance.copy()
    negative[7, 7] = -1.0
    skew = covariance.copy()
    skew[0, 10] += covariance.max()
    low_rank = np.zeros_like(covariance)
    low_rank[:9, :9] = covariance[:9, :9]
    cases: list[tuple[dict[str, Any], str]] = [
        ({"cov": covariance[:-9, :-9], **no_information}, "540 x 540"),
        ({"cov": skew, **no_information}, "not symmetric"),
        ({"cov": negative, **no_information}, "is not positive"),
        ({"cov": covariance * np.nan, **no_information}, "not finite"),
        ({"cov": low_rank, **no_information}, "rank is too low"),
        (no_information, "neither a covariance nor an information"),
        ({"stamps_ns": stamps + 1}, "no pose at timestamp"),
        ({"positions": positions + 0.01}, "differ from the estimate"),
        ({"positions": None}, "has no positions"),
    ]
    for changes, why in cases:
        np.savez(file, **_changed(source, **changes))
        assert why in _refused(honest, capsys, "--gauge", "yaw", "--covariance", str(file)), why
    file.write_text("not an archive")
    assert "not an npz archive" in _refused(
        honest, capsys, "--gauge", "yaw", "--covariance", str(file)
    )
    assert "align by gauge yaw" in _refused(
        honest, capsys, "--gauge", "none", "--covariance", str(source)
    )
    missing = str(tmp_path / "nowhere.npz")
    assert "does not exist" in _refused(honest, capsys, "--gauge", "yaw", "--covariance", missing)


def test_information_with_a_prior_must_not_claim_the_free_gauge(
    honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joint = read_joint_covariance(Path(f"{honest}.npz"))
    assert joint.information is not None
    information = joint.information.tolil()
    for index in (0, 1, 2, 5):
        information[index, index] += 1e8
    file = tmp_path / "prior.npz"
    outcomes = []
    for gauge in ("free", "prior"):
        parts = joint.stamps, joint.positions, joint.quaternions, 9, None, information.tocsr()
        write_joint_covariance(file, JointCovariance(*parts, gauge))
        if gauge == "free":
            assert "set gauge prior" in _refused(
                honest, capsys, "--gauge", "yaw", "--covariance", str(file)
            )
        else:
            outcomes.append(_evaluate(honest, "--gauge", "yaw", "--covariance", str(file)))
    expected = _evaluate(honest, "--gauge", "yaw", "--covariance", f"{honest}.npz")
    assert outcomes[0]["joint"]["nees"] == pytest.approx(expected["joint"]["nees"], rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--gauge", "translation", "--covariance", "message"], "gauge translation"),
        (["--rotation-covariance-frame", "camera"], "unknown rotation covariance frame"),
        (["--rotation-covariance-frame", "body"], "add --covariance message"),
        (["--groundtruth-noise", "0.1,0.1"], "add --covariance"),
        (["--covariance", "message", "--groundtruth-noise", "0.1"], "is not valid"),
        (
            ["--covariance", "message", "--groundtruth-noise", "0,1"],
            "must be greater than zero",
        ),
    ],
)
def test_says_what_settings_mean_nothing(
    honest: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], why: str
) -> None:
    assert why in _refused(honest, capsys, *arguments)


def test_unknown_covariances_in_messages_are_recognised(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "drift"
    assert main(["simulate", str(bag), "--duration", "6"]) == 0
    text = _refused(bag, capsys, "--gauge", "yaw", "--covariance", "message")
    assert "unknown" in text


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--profile", "honest"], "unknown profile"),
        (["--runs", "3"], "--runs needs a simulated estimator"),
        (["--profile", "euroc", "--runs", "0"], "--runs must be at least 1"),
        (["--profile", "euroc", "--duration", "2"], "flight takes 5 to 1800 s"),
        (["--profile", "euroc", "--duration", "nan"], "flight takes 5 to 1800 s"),
        (["--profile", "euroc", "--duration", "1801"], "memory grows with the length"),
        (["--profile", "overconfident", "--duration", "60"], "use --duration 10"),
    ],
)
def test_says_what_can_not_be_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], why: str
) -> None:
    assert main(["simulate", str(tmp_path / "bag"), *arguments]) == 2
    text = capsys.readouterr().err
    assert why in text
    assert len(text.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("runs", ["1", "2"])
@pytest.mark.parametrize("folder", [".", "..", "/"])
def test_runs_need_a_name(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    folder: str,
    runs: str,
) -> None:
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    command = ["simulate", folder, "--profile", "paper", "--duration", "5", "--runs", runs]
    assert main(command) == 2
    text = capsys.readouterr().err
    assert f"{folder} has no folder name" in text
    assert len(text.splitlines()) == 1
    assert [path.name for path in tmp_path.rglob("*")] == ["inside"]


def test_an_estimate_without_covariances_does_not_prevent_the_test_of_others(
    honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = [
        "trajectory",
        f"{honest}:/vio/odometry",
        "--save-as",
        "tum",
        "--output",
        str(tmp_path),
    ]
    assert main(plain) == 0
    [file] = tmp_path.glob("*.txt")
    sides = ["-g", f"{honest}:/groundtruth/pose", "-e", f"plain={file}"]
    both = [*sides, "-e", f"vio={honest}:/vio/odometry", "--lengths", "none", "--gauge", "yaw"]
    result = tmp_path / "result.json"
    asked = ["--covariance", "message", "--alert-limit", "1", "--json", str(result)]
    assert main(["evaluate", *both, *asked]) == 0
    without, tested = json.loads(result.read_text())["runs"]
    assert without["consistency"] is without["integrity"] is None
    assert tested["consistency"] is not None
    assert tested["integrity"] is not None
    [text] = [remark for remark in without["remarks"] if remark["code"] == "no_consistency_test"]
    assert text["level"] == "warning"
    capsys.readouterr()
    assert main(["evaluate", *sides, "--covariance", "message"]) == 2  # nothing to test
    assert "has no covariances" in capsys.readouterr().err
