"""`trajeval groundtruth`: errors of a groundtruth, from an IMU, and its repair."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import OUTPUT, argument, option, shared_options
from trajeval_ros.cli.programs import write_json
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.requests.setting import INPUT, parse_imu_noise

_HERE, _NAME = Path(), "groundtruth"
_PARAMETERS = (
    argument("truth", metavar="SOURCE",
        help="Groundtruth to examine, such as mocap.bag:/vicon/pose or groundtruth.csv."),
    option("--imu", metavar="BAG:TOPIC|FILE", panel=INPUT,
        help="IMU of the same rig: a topic of sensor_msgs/Imu, or a table of time, angular "
        "velocity (rad/s) and acceleration (m/s^2), as mav0/imu0/data.csv of EuRoC. Without "
        "it, only the poses are checked."),
    option("--imu-noise", metavar="G,A", panel=INPUT,
        help="Effective noise densities of the IMU: rad/s/sqrt(Hz), m/s^2/sqrt(Hz). They include "
        "vibration and scale errors and are larger than in data sheets. Default: 8e-4,2e-2."),
    option("--time-offset", kind=float, metavar="S", panel=INPUT,
        help="Approximate offset to add to the groundtruth's timestamps, in seconds. Default: "
        "from the rotation rates."),
    option("--save-as", metavar="FORMAT", panel=OUTPUT,
        help="Format of the repaired groundtruth: tum, euroc (with velocities and biases), or "
        "mcap or rosbag2 (Odometry with covariances)."),
    option("--output", kind=Path, metavar="FOLDER", default=_HERE, panel=OUTPUT,
        help="Folder of the repaired groundtruth."),
    option("--figure", kind=Path, metavar="FILE", panel=OUTPUT,
        help="Output file of a figure with residuals, jumps and both horizons: png, pdf, svg or "
        "pgf."),
    option("--rrd", kind=Path, metavar="FILE", panel=OUTPUT,
        help="Output file for Rerun's viewer: repaired against original groundtruth. Open it with "
        "`trajeval view FILE`."),
    *shared_options("groundtruth"),
)  # fmt: skip


@verb(*_PARAMETERS)
def groundtruth(
    truth: str,
    imu: str | None,
    imu_noise: str | None,
    time_offset: float | None,
    save_as: str | None,
    output: Path,
    figure: Path | None,
    rrd: Path | None,
    json: str | None,
    quiet: bool,
) -> None:
    r"""Examines a groundtruth with the IMU of the same rig, and repairs it.

    It measures body rotation, lever arm, clock, tilt, jumps, frozen poses and noise:

        trajeval groundtruth mocap.bag:/vicon/pose --imu run.bag:/imu \
            --save-as mcap --output repaired

    Check only the poses:

        trajeval groundtruth groundtruth.csv

    docs/groundtruth.md describes the verdicts and their limits.
    """
    from trajeval_ros.calibration.groundtruth_quality.examine import IMU_NOISE, examine
    from trajeval_ros.cli.evaluation_output import refuse_inputs
    from trajeval_ros.cli.pictures import Pictures
    from trajeval_ros.cli.progress import progress, report_dropped
    from trajeval_ros.geometry.trajectory import NANOSECONDS
    from trajeval_ros.io.results.groundtruth_json import groundtruth_json
    from trajeval_ros.io.save_trajectories import files_of, save_trajectories
    from trajeval_ros.io.source_names import names_of
    from trajeval_ros.io.sources import read_many
    from trajeval_ros.io.watched_sources import imu_of

    noise = IMU_NOISE if imu_noise is None else parse_imu_noise(imu_noise)
    if imu is None and (save_as or figure or rrd or imu_noise or time_offset is not None):
        raise SettingsError(
            "--save-as, --figure, --rrd, --imu-noise and --time-offset need --imu; add it"
        )
    if save_as is not None:
        files_of(output, [_NAME], save_as)  # raises an error for an unknown format before reading
    elif output != _HERE:
        raise SettingsError("--output needs --save-as; add it")
    Pictures(rrd).check()
    sources = [item for item in (truth, imu) if item is not None]
    refuse_inputs([figure, rrd, json], sources)
    with progress(f"reading {', '.join(names_of([truth]))}") as advance:
        (original,) = read_many([truth], advance=advance, covariances=False)
        readings = None if imu is None else imu_of(imu)
    examined = examine(original, readings, imu_noise=noise, time_offset_s=time_offset)
    saved: list[Path] = []
    if save_as is not None and examined.fits is not None:
        named = dataclasses.replace(examined.fits.repaired, name=_NAME)
        saved = save_trajectories(output, [named], save_as, "Odometry")
    if figure is not None and examined.fits is not None:
        from trajeval_ros.report.figure_style import apply_style
        from trajeval_ros.report.figures import write_figure
        from trajeval_ros.report.groundtruth_report import groundtruth_figure

        with apply_style():
            write_figure(groundtruth_figure(original, examined, examined.fits), figure)
    if rrd is not None and examined.fits is not None:
        from trajeval_ros.metrics.evaluation import evaluate
        from trajeval_ros.metrics.protocol import Protocol
        from trajeval_ros.viewer.recorded_scene import write_recording

        late = round(examined.fits.rig.offset_s * NANOSECONDS)
        by_imu = dataclasses.replace(original, stamps=original.stamps + late)
        compared = Protocol(gauge="none", lengths="none")
        repaired = dataclasses.replace(examined.fits.repaired, name="repaired")
        write_recording(rrd, [evaluate(by_imu, repaired, compared)])
    write_json(json, groundtruth_json(truth, imu, original, examined))
    if not quiet and json != "-":
        from trajeval_ros.report.console import console
        from trajeval_ros.report.groundtruth_report import print_groundtruth

        print_groundtruth(console(), examined, saved)
    report_dropped([original])
