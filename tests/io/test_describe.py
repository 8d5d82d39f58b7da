"""`trajeval info`: what is in a source."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from strategies import make_groundtruth

from trajeval_ros.cli.app import main
from trajeval_ros.cli.info import info
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.write_bag import ODOMETRY, POSE_STAMPED, write_bag
from trajeval_ros.io.describe import describe


def test_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = make_groundtruth(0)
    bag = tmp_path / "bag"
    write_bag(
        bag,
        {
            "/vicon/pose": (truth, POSE_STAMPED),
            "/vio": (truth, ODOMETRY),
            "/slam": (truth, ODOMETRY),
        },
    )
    summaries = {
        trajectory.source.rpartition(":")[2]: trajectory
        for trajectory in describe(str(bag)).trajectories
    }
    vicon, vio = summaries["/vicon/pose"], summaries["/vio"]
    assert vicon.could_be == "groundtruth"
    assert vio.could_be == "estimate"
    assert vicon.poses == len(truth)
    assert vicon.rate_hz == pytest.approx(10.0, rel=0.1)
    assert (vicon.first_ns, vicon.last_ns) == (truth.stamps[0], truth.stamps[-1])
    assert vicon.path_length_m == pytest.approx(truth.path_length_m)
    assert vio.holds == ("rotation", "velocity")
    info.main([str(bag)], standalone_mode=False)
    printed = capsys.readouterr().out
    (command,) = [line for line in printed.splitlines() if line.startswith("trajeval evaluate")]
    sources = command.split()
    assert sources[2:4] == ["-g", f"{bag}:/vicon/pose"]
    assert sorted(sources[5:8:2]) == [f"{bag}:/slam", f"{bag}:/vio"]
    assert sources[8:] == ["--modality", "stereo-inertial"]


def test_what_a_command_lacks_has_a_placeholder(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def commands(source: Path) -> list[str]:
        info.main([str(source)], standalone_mode=False)
        lines = capsys.readouterr().out.splitlines()
        return [line for line in lines if line.startswith(("trajeval evaluate", "GROUNDTRUTH"))]

    text, file = tmp_path / "vio.txt", shared_data / "bags/tf_example.bag"
    text.write_text("".join(f"{t} {t}.5 0 0 0 0 0 1\n" for t in range(100, 120)))
    other = "GROUNDTRUTH: another file or BAG:TOPIC of the same run"
    evaluated = "trajeval evaluate -g GROUNDTRUTH -e {} --modality SENSORS"
    assert commands(text) == [evaluated.format(text).replace("SENSORS", "stereo-inertial"), other]
    assert commands(file) == [evaluated.format(f"{file}:/tf:odom.base_footprint"), other]
    bag, truth = tmp_path / "bag", make_groundtruth(0)
    topics = ("/vicon/pose", "/mocap/pose", "/vio")
    write_bag(
        bag, {topic: (truth, ODOMETRY if topic == "/vio" else POSE_STAMPED) for topic in topics}
    )
    assert sorted(commands(bag)) == [
        f"trajeval evaluate -g {bag}:{truth} -e {bag}:/vio --modality stereo-inertial"
        for truth in ("/mocap/pose", "/vicon/pose")
    ]


def test_messages_of_files_with_and_without_counts_are_added(tmp_path: Path) -> None:
    truth, folder = make_groundtruth(0), tmp_path / "both"
    folder.mkdir()
    for storage in ("mcap", "sqlite3"):
        write_bag(tmp_path / storage, {"/vio": (truth, ODOMETRY)}, storage=storage)
        for file in (tmp_path / storage).glob("*.[md][cb]*"):
            file.rename(folder / file.name)
    with Bag(folder) as bag:
        [topic] = bag.topics
        assert topic.count == 2 * len(truth)


def test_static_transforms_are_counted(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    info.main([str(shared_data / "bags/tf_example")], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "base_footprint" in printed
    assert "base_link" not in printed
    assert "and 1 static transform" in printed


def test_tf_and_what_holds_no_poses(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = shared_data / "bags"
    description = describe(str(bags / "tf_example"))
    assert {(edge.parent, edge.child, edge.is_static) for edge in description.edges} == {
        ("odom", "base_footprint", False),
        ("base_footprint", "base_link", True),
    }
    services = describe(str(bags / "rosbag2_fixtures/topics_and_services.mcap"))
    assert not services.trajectories
    assert len(services.others) == 5
    info.main([str(bags / "nav2_turtlebot.mcap")], standalone_mode=False)
    assert "odom -> base_link" in capsys.readouterr().out


def test_a_text_file(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = str(shared_data / "tum/fr2_desk_groundtruth.txt")
    (summary,) = describe(source).trajectories
    assert summary.kind == "TUM"
    assert summary.could_be == "groundtruth"
    assert summary.gaps == 6
    assert summary.longest_gap_s == pytest.approx(11.99, abs=0.01)
    info.main([source], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "303.0 Hz" in printed
    assert "1 dropped: duplicate stamp" in printed


@pytest.mark.parametrize(
    ("header", "row", "columns", "ignored"),
    [
        ("", "1700000000{0}00 1 2 3 0 0 0 1", "t_ms x y z qx qy qz qw", ""),
        ("#time x y z gain\n", "1700000000.{0} 1 2 3 9", "t_s x y z", "ignored columns: gain"),
        ("gain,x_mm,y_mm,z_mm,t_us\n", "9,1,2,3,170000000{0}000000",
         "_ x_mm y_mm z_mm t_us", "ignored columns: gain"),
    ],
)  # fmt: skip
def test_the_columns_of_a_text_file_can_be_given_to_columns(
    header: str, row: str, columns: str, ignored: str,
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path = tmp_path / "run.txt"
    path.write_text(header + "".join(row.format(at) + "\n" for at in range(5)))
    assert main(["info", str(path)]) == 0
    printed = capsys.readouterr().out
    assert re.search(rf"(?m)^columns +{columns}$", printed)
    assert ignored in printed
    assert main(["info", str(path), "--columns", columns]) == 0
    again = capsys.readouterr().out
    assert [line for line in again.splitlines() if line.startswith("timestamps")] == [
        line for line in printed.splitlines() if line.startswith("timestamps")
    ]


def test_without_stamps(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info.main([str(shared_data / "kitti/KITTI_00_ORB.txt")], standalone_mode=False)
    assert "no timestamps" in capsys.readouterr().out


def test_columns_that_nothing_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "odom.txt"
    path.write_text("".join(f"{time}000 7 {time} 0.0 90\n" for time in range(5)))
    assert main(["info", str(path)]) == 2
    assert "--columns" in capsys.readouterr().err
    assert main(["info", str(path), "--columns", "t_ms _ x y yaw_deg"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "columns as named columns t_ms _ x y yaw_deg poses 5 rate 1.0 Hz" in printed
    assert "timestamps 0.000 to 4.000 s" in printed
    assert "path length 4.000 m" in printed


def test_a_rate_of_a_file_without_stamps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "airsim.txt"
    path.write_text("".join(f"{x} 0 0 0 0 0 1\n" for x in range(5)))
    assert main(["info", str(path), "--frame-rate", "10"]) == 0
    assert "10.0 Hz" in capsys.readouterr().out


def test_columns_of_a_folder_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(tmp_path), "--columns", "t x y z"]) == 2
    assert "name the file" in capsys.readouterr().err


def test_a_topic_that_cannot_be_evaluated_is_still_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from made_bags import pose_stamped, write

    messages = [
        (topic, POSE_STAMPED, row, pose_stamped(row if topic == "/good" else 7, float(row)))
        for row in range(1, 4)
        for topic in ("/bad", "/good")
    ]
    bag = write(tmp_path / "bag", messages)
    bad, good = describe(str(bag)).trajectories
    assert "all timestamps (3) are equal" in bad.problem
    assert not good.problem
    info.main([str(bag)], standalone_mode=False)
    assert "all timestamps (3) are equal" in capsys.readouterr().out


def test_the_path_of_a_bag_names_no_role(tmp_path: Path) -> None:
    from made_bags import pose_stamped, write

    messages = [
        (topic, POSE_STAMPED, row, pose_stamped(row, float(row)))
        for row in (1, 2)
        for topic in ("/mocap/body", "/slam/pose")
    ]
    bag = write(tmp_path / "groundtruth" / "run_with_truth", messages)
    roles = {
        item.source.rpartition(":")[2]: item.could_be for item in describe(str(bag)).trajectories
    }
    assert roles == {"/mocap/body": "groundtruth", "/slam/pose": "estimate or groundtruth"}


def test_a_bag_of_one_topic_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from made_bags import pose_stamped, write

    poses = [pose_stamped(row, float(row)) for row in (1, 2)]
    messages = [("/mocap/body", POSE_STAMPED, row, pose) for row, pose in enumerate(poses)]
    assert main(["info", str(write(tmp_path / "bag", messages))]) == 0
    assert "topic            /mocap/body" in capsys.readouterr().out
