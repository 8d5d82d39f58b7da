"""What a small evaluation imports: scipy alone would take longer than all the rest."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from paths import ROOT
from strategies import make_pair

from trajeval_ros import __version__
from trajeval_ros.cli.app import VERBS
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import ODOMETRY, write_bag


def write_tum(path: Path, trajectory: Trajectory) -> Path:
    columns = [trajectory.stamps * 1e-9, trajectory.positions, trajectory.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")
    return path


def write_kitti(path: Path, trajectory: Trajectory) -> Path:
    assert trajectory.rotations is not None
    matrices = np.dstack([trajectory.rotations.as_matrix(), trajectory.positions])
    np.savetxt(path, matrices.reshape(-1, 12))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "options"),
    [
        ("tum", ["--modality", "stereo-inertial"]),
        ("tum", ["--modality", "mono"]),
        ("tum", ["--gauge", "yaw", "--align-states", "1", "--max-gap", "1"]),
        ("tum", ["--protocol", "rpg", "--gauge", "se3"]),
        ("tum", ["--protocol", "evo", "--gauge", "se3"]),
        ("kitti", ["--protocol", "kitti"]),
        ("bag", ["--gauge", "planar"]),
    ],
)
def test_a_plain_evaluation_never_imports_scipy(
    files: str, options: list[str], tmp_path: Path
) -> None:
    pair = make_pair(5, 400, smooth=True)
    if files == "bag":
        topics = {"/truth": (pair.groundtruth, ODOMETRY), "/odom": (pair.estimate, ODOMETRY)}
        write_bag(tmp_path / "bag", topics)
        sources = [f"{tmp_path / 'bag'}:/truth", f"{tmp_path / 'bag'}:/odom"]
    elif files == "kitti":
        truth, estimate = pair.groundtruth[1:-1:2], pair.estimate
        sources = [
            str(write_kitti(tmp_path / f"{name}.txt", item))
            for name, item in (("truth", truth), ("estimate", estimate))
        ]
    else:
        sources = [
            str(write_tum(tmp_path / f"{name}.txt", item))
            for name, item in (("truth", pair.groundtruth), ("estimate", pair.estimate))
        ]
    arguments = ["evaluate", "-g", sources[0], "-e", sources[1], *options]
    arguments += ["--json", str(tmp_path / "result.json")]
    code = (
        "import sys; from trajeval_ros.cli.app import main; "
        f"status = main({arguments!r}); "
        "loaded = {name for name in sys.modules if name.split('.')[0] == 'scipy'}; "
        "sys.exit(', '.join(sorted(loaded)) or status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "name", "unwanted"),
    [("--output", "result", {"scipy.stats"}), ("--rrd", "run.rrd", {"scipy.stats", "matplotlib"})],
)
def test_pictures_without_covariances_import_no_distributions(
    option: str, name: str, unwanted: set[str], tmp_path: Path
) -> None:
    if option == "--rrd":
        pytest.importorskip("rerun")
    pair = make_pair(5, 50, smooth=True)
    truth = write_tum(tmp_path / "truth.txt", pair.groundtruth)
    estimate = write_tum(tmp_path / "estimate.txt", pair.estimate)
    arguments = ["evaluate", str(truth), str(estimate), option, str(tmp_path / name), "--quiet"]
    _, loaded = _loaded(MAIN.format(arguments=arguments))
    assert (tmp_path / name).exists()
    assert not loaded & unwanted, sorted(loaded & unwanted)


THREADS = (
    "import sys; from trajeval_ros.__main__ import main; status = main({arguments!r}); "
    "import os; print({{name: value for name, value in os.environ.items() if 'THREADS' in name}})"
)


def _threads(arguments: list[str], **variables: str) -> str:
    kept = {name: value for name, value in os.environ.items() if "THREADS" not in name}
    done = subprocess.run(
        [sys.executable, "-c", THREADS.format(arguments=arguments)],
        cwd=ROOT, env={**kept, **variables}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.splitlines()[-1]


def test_programs_take_one_thread_of_linear_algebra() -> None:
    text = _threads(["info", "nowhere"])
    assert "'OPENBLAS_NUM_THREADS': '1'" in text
    assert "'OMP_NUM_THREADS': '1'" in text


def test_the_users_number_of_threads_stays() -> None:
    assert _threads(["info", "nowhere"], OMP_NUM_THREADS="3") == "{'OMP_NUM_THREADS': '3'}"
    text = _threads(["info", "nowhere"], OPENBLAS_NUM_THREADS="5")
    assert "'OPENBLAS_NUM_THREADS': '5'" in text


@pytest.mark.slow
def test_an_evaluation_imports_nothing_that_writes_folders_tables_or_styles(
    tmp_path: Path,
) -> None:
    pair = make_pair(5, 6000, smooth=True)  # long enough for all tests of the diagnosis
    truth = write_tum(tmp_path / "truth.txt", pair.groundtruth)
    estimate = write_tum(tmp_path / "estimate.txt", pair.estimate)
    arguments = ["evaluate", str(truth), str(estimate), "--gauge", "se3", "--json", "-"]
    text, loaded = _loaded(MAIN.format(arguments=arguments))
    assert '"position_m"' in text
    _, libraries = _loaded("import numpy, click")  # older ones import more
    unwanted = {
        "rich",
        "rich_click",
        "tempfile",
        "zipfile",
        "csv",
        "html",
        "logging",
        "shlex",
        "secrets",
    }
    unwanted = (unwanted | {"numpy.ma"}) - libraries
    unwanted |= {
        f"trajeval_ros.{module}"
        for module in (
            "cli.evaluation_folder",
            "formatting.text_tables",
            "io.live.state_file",
            "io.npz_file",
            "io.writing",
        )
    }
    assert not loaded & unwanted, sorted(loaded & unwanted)
    text, loaded = _loaded(MAIN.format(arguments=arguments[:-2]))  # with tables
    assert "rotation [deg]" in text
    assert not loaded & ({"rich"} - libraries)


def test_imports_are_no_garbage_to_search_and_later_objects_are() -> None:
    code = MAIN.format(arguments=["info", "nowhere"])
    text, _ = _loaded(f"{code}\nimport gc; print(gc.isenabled(), gc.get_freeze_count() > 10_000)")
    assert text == "True True\n"


def test_version_is_printed_without_any_library() -> None:
    code = (
        "import sys; from trajeval_ros.__main__ import main; status = main(['--version']); "
        "loaded = {'click', 'rich_click', 'numpy', 'rich'} & set(sys.modules); "
        "sys.exit(', '.join(sorted(loaded)) or status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"trajeval_ros {__version__}\n"


def _loaded(code: str, **variables: str) -> tuple[str, set[str]]:
    """Run code in a Python of its own; what it says on stdout, and all modules that it imports."""
    report = "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
    done = subprocess.run(
        [sys.executable, "-c", report + code],
        cwd=ROOT, env={**os.environ, **variables}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout, set(done.stderr.splitlines()[-1].split())


MAIN = "from trajeval_ros.__main__ import main\nmain({arguments!r})"
# The program of the node is also the home of ROS arguments.
FILES = {f"trajeval_ros.cli.{file}" for file in VERBS.values() if file != "programs"}


@pytest.mark.slow
@pytest.mark.parametrize("name", VERBS)
def test_a_verb_imports_none_of_the_others(name: str) -> None:
    text, loaded = _loaded(MAIN.format(arguments=[*name.split(), "--help"]))
    assert f"trajeval {name}" in text
    assert loaded & FILES == FILES & {f"trajeval_ros.cli.{VERBS[name]}"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["evaluate", "finish", "info", "trajectory", "view"])
def test_verbs_that_evaluate_nothing_live_do_without_ros_and_simulation(name: str) -> None:
    _, loaded = _loaded(MAIN.format(arguments=[name, "--nope"]))
    subpackages = {".".join(item.split(".")[:2]) for item in loaded}
    unwanted = {
        f"trajeval_ros.{name}" for name in ("ros", "batch", "papers", "simulation", "viewer")
    }
    assert not subpackages & unwanted
    assert not loaded & {"scipy", "matplotlib", "jinja2", "pyarrow", "rerun"}


@pytest.mark.slow
def test_large_texts_are_read_without_pandas(tmp_path: Path) -> None:
    """Its import takes a tenth of an evaluation of a million poses."""
    for name in ("pandas", "pyarrow"):
        pytest.importorskip(name, reason=f"{name} is missing")
    path = tmp_path / "large.txt"
    path.write_text("".join(f"{second} 1 2 3 0 0 0 1\n" for second in range(100)))
    _, loaded = _loaded(
        "from pathlib import Path; from trajeval_ros.io.text import reader, table; "
        f"table._LARGE = 0; print(len(reader.read_text(Path({str(path)!r}))))"
    )
    assert "pyarrow.csv" in loaded
    assert "pandas" not in loaded


def test_a_misspelt_verb_imports_none() -> None:
    _, loaded = _loaded(MAIN.format(arguments=["evalute"]))
    assert not loaded & {*FILES, "numpy"}


@pytest.mark.slow
def test_all_verbs_are_in_the_help_and_imported_before_ctrl_c_could_break_them() -> None:
    code = "from trajeval_ros.cli import app\napp.load({arguments!r})"
    for arguments in ([], ["--help"], ["-h"]):
        assert _loaded(code.format(arguments=arguments))[1] >= FILES
    assert _loaded(code.format(arguments=["info", "nowhere"]))[1] & FILES == {
        "trajeval_ros.cli.info"
    }
    text, _ = _loaded(MAIN.format(arguments=["--help"]), COLUMNS="200")
    assert all(f" {name.split()[0]} " in text for name in VERBS)


@pytest.mark.slow
def test_completion_of_an_option_imports_one_verb() -> None:
    asked = {
        "_TRAJEVAL_COMPLETE": "bash_complete",
        "COMP_WORDS": "trajeval evaluate --js",
        "COMP_CWORD": "2",
    }
    text, loaded = _loaded(MAIN.format(arguments=[]), **asked)
    assert text == "plain,--json\n"
    assert loaded & FILES == {"trajeval_ros.cli.evaluate"}
