"""`trajeval evaluate`: recorded runs, end to end."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trajeval_ros.cli import options
from trajeval_ros.cli.deliver import deliver, refuse_inputs
from trajeval_ros.cli.pictures import Pictures
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.io.requests.request_words import request_from
from trajeval_ros.io.results.requirement import Requirement
from trajeval_ros.io.sources import read_many
from trajeval_ros.pipeline import run

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory


def evaluate(
    groundtruth: options.GroundtruthOption,
    estimate: options.EstimatesOption,
    protocol: options.ProtocolOption = None,
    modality: options.ModalityOption = None,
    gauge: options.GaugeOption = None,
    align_states: options.AlignStatesOrTableOption = None,
    align_with: options.AlignWithOption = None,
    apply: options.ApplyOption = None,
    association: options.AssociationOption = None,
    max_time_difference: options.MaxTimeDifferenceOption = None,
    max_gap: options.MaxGapOption = None,
    time_offset: options.TimeOffsetOption = None,
    hand_eye: options.HandEyeOption = None,
    continuous_model: options.ContinuousModelOption = None,
    groundtruth_noise: options.GroundtruthNoiseOption = None,
    lengths: options.LengthsOption = None,
    pairs: options.PairsOption = None,
    ate_form: options.AteFormOption = None,
    re_form: options.ReFormOption = None,
    covariance: options.CovarianceOption = None,
    rotation_covariance_frame: options.RotationCovarianceFrameOption = None,
    up: options.UpOption = None,
    start: options.StartOption = None,
    end: options.EndOption = None,
    json: options.JsonOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write result.json, errors.npz, figures and run.rrd (for Rerun) to this folder.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a recording for Rerun's viewer; `trajeval view FILE` shows it.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    viewer: Annotated[
        bool,
        typer.Option(
            "--viewer",
            help="Show the result in Rerun's viewer, until it is closed.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    require: options.RequireOption = None,
    strict: options.StrictOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Evaluate estimated trajectories against groundtruth: ATE and relative errors.

    Two text files, groundtruth and a stereo-inertial VIO:

        trajeval evaluate -g groundtruth.txt -e estimate.txt --modality stereo-inertial

    Two topics of a bag, with result.json and figures in a folder:

        trajeval evaluate -g run.mcap:/mocap/pose -e run.mcap:/vio/odometry --output result

    Groundtruth of a marker body with a clock of its own (docs/calibration.md):

        trajeval evaluate -g mocap.txt -e vio.txt --time-offset auto --hand-eye auto

    Numbers as evo or rpg_trajectory_evaluation compute them: --protocol evo, --protocol rpg.

    As evo_rpe -d 10 -u f, and the ATE by the number of aligned states (tutorial, Table III):

        trajeval evaluate -g gt.txt -e vio.txt --protocol evo --gauge none --lengths 10f
        trajeval evaluate -g gt.txt -e vio.txt --align-states 1,25%,50%,75%,all

    Whether errors fit the covariances in the estimate's messages:

        trajeval evaluate -g gt.txt -e run:/odom --gauge yaw --align-states 1 --covariance message

    Slow groundtruth with dropouts, such as RTK or a total station of 2 Hz and 1 cm:

        trajeval evaluate -g rtk.txt -e vio.txt --association continuous --groundtruth-noise 0.01,1
    """
    request = request_from(
        {
            "protocol": protocol,
            "modality": modality,
            "gauge": gauge,
            "align_states": align_states,
            "align_with": align_with,
            "apply": apply,
            "association": association,
            "max_time_difference": max_time_difference,
            "max_gap": max_gap,
            "time_offset": time_offset,
            "hand_eye": hand_eye,
            "continuous_model": continuous_model,
            "groundtruth_noise": groundtruth_noise,
            "lengths": lengths,
            "pairs": pairs,
            "ate_form": ate_form,
            "re_form": re_form,
            "covariance": covariance,
            "rotation_covariance_frame": rotation_covariance_frame,
            "up": up,
            "start": start,
            "end": end,
        }
    )
    requirements = [Requirement.parse(text) for text in require or []]
    pictures = Pictures(rrd=rrd, viewer=viewer, in_output=True)
    pictures.check()
    sources = [groundtruth, *estimate]
    refuse_inputs([rrd, None if json in (None, "-") else Path(json), output], sources)
    truth, *estimates = _read(sources, covariances=request.reads_covariances, strict=strict)
    outcome = run(truth, estimates, request)
    chose_gauge = gauge is not None or modality is not None or protocol not in (None, "default")
    deliver(
        outcome,
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        gauge_given=chose_gauge,
        pictures=pictures,
    )


def _read(sources: Sequence[str], *, covariances: bool, strict: bool) -> list[Trajectory]:
    """Read groundtruth and estimates; covariances are the estimates'."""
    names = names_of(sources)
    with progress(f"reading {', '.join(names)}") as advance:
        trajectories = read_many(
            sources,
            advance=advance,
            covariances=[False, *[covariances] * (len(sources) - 1)],
            strict=strict,
        )
    return [
        dataclasses.replace(trajectory, name=name)
        for trajectory, name in zip(trajectories, names, strict=True)
    ]
