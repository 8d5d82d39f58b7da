"""A process that draws a simulated flight on Rerun's sinks, as the live evaluator does.

    rerun_driver.py SINKS FOLDER SECONDS SPEED [X,Y,Z] [PAUSE,...]

The flight is at X, Y, Z if they are given. It is no faster than its file is drawn. At each pause,
seconds of the flight, it prints "paused at SECOND" when all sinks have drawn what came before, and
waits for a line. It prints "all is handed over", and then JSON: what each sink made of it, and the
numbers that were handed over.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import sys
import time
from pathlib import Path

import numpy as np
from state_rows import as_drawn, states, trajectory
from waiting import PATIENCE_S, until

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.simulation.drifting_odometry import simulate
from trajeval_ros.viewer import stream as drawing
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.viewer.sinks import FileTarget, sinks_for
from trajeval_ros.viewer.stream import DrawingThread, lower_priority

NAME = "vio_odometry"
TICK_S = 0.05
_REPORT_EVERY = 10
_MOST_WAITING = 1000  # half of what a queue takes


def rows(trajectory: Trajectory) -> np.ndarray:
    return states(trajectory.positions, trajectory.quaternions, trajectory.velocities)


def flight_at(place: np.ndarray, seconds: float) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a flight somewhere."""
    flight = simulate(0, seconds)
    groundtruth, estimate = (
        dataclasses.replace(item, positions=item.positions + place)
        for item in (flight.groundtruth, flight.estimate)
    )
    return groundtruth, estimate


def main(
    value: str, folder: Path, seconds: float, speed: float, place: str = "0,0,0", pauses: str = ""
) -> None:
    groundtruth, estimate = flight_at(
        np.array([float(word) for word in place.split(",")]), seconds
    )
    groundtruth_rows, estimate_rows = rows(groundtruth), rows(estimate)
    evaluator = OnlineEvaluator(OnlineSettings(Protocol(gauge=Gauge.YAW)))
    streams = []
    # The end may take long on a machine that is busy, but less than the test waits.
    drawing._PATIENCE_S = PATIENCE_S / 4
    FileTarget.check_every_s /= speed  # as much between two flushes as in a flight in real time
    lower_priority()
    for sink in sinks_for(value, folder / "run.rrd", "flight"):
        scene = LiveScene("flight", [NAME], Gauge.YAW)
        streams.append((DrawingThread(sink, scene), scene))
    handed: dict = {"position_error": [], "ate_position": [], "alignment": []}
    pause_at = {round(float(word) / TICK_S): word for word in pauses.split(",") if word}

    def put(draw) -> None:
        for stream, scene in streams:
            stream.put(functools.partial(draw, scene))

    due = time.monotonic()
    for tick in range(round(seconds / TICK_S)):
        if tick in pause_at:
            until(lambda: not any(stream._jobs for stream, _ in streams), "all is drawn so far")
            print(f"paused at {pause_at[tick]}", flush=True)
            sys.stdin.readline()
            due = time.monotonic()
        until(lambda: len(streams[0][0]._jobs) < _MOST_WAITING, "the file is drawn")
        end = groundtruth.stamps[0] + round((tick + 1) * TICK_S * NANOSECONDS)
        since = end - round(TICK_S * NANOSECONDS)
        part = (groundtruth.stamps > since) & (groundtruth.stamps <= end)
        evaluator.add_groundtruth(trajectory(groundtruth.stamps[part], groundtruth_rows[part]))
        taken = groundtruth.stamps[part], groundtruth_rows[part]
        put(lambda scene, taken=taken: scene.groundtruth(*taken))
        part = (estimate.stamps > since) & (estimate.stamps <= end)
        evaluator.add_estimate(trajectory(estimate.stamps[part], estimate_rows[part]))
        pairs = evaluator.made()
        update = evaluator.evaluate(pairs)
        if pairs is not None:
            put(lambda scene, pairs=pairs: scene.pairs(NAME, *as_drawn(pairs)))
        if update.stamp is not None:
            put(lambda scene, update=update: scene.update(NAME, update))
            if update.position_m is not None:
                handed["position_error"].append((update.stamp, update.position_m))
        if tick % _REPORT_EVERY == 0 and evaluator.pairs:
            snapshot, stamp = evaluator.snapshot(), int(evaluator.store.stamps()[-1])
            put(
                lambda scene, stamp=stamp, snapshot=snapshot: scene.snapshot(
                    NAME, stamp, snapshot, None
                )
            )
            if snapshot.window_position_rmse_m is not None:
                handed["ate_position"].append((stamp, snapshot.window_position_rmse_m))
            if snapshot.alignment is not None:
                similarity = snapshot.alignment.similarity
                handed["alignment"].append(
                    (
                        stamp,
                        *similarity.rotation.ravel().tolist(),
                        *similarity.translation.tolist(),
                    )
                )
        due += TICK_S / speed
        time.sleep(max(0.0, due - time.monotonic()))
    print("all is handed over", flush=True)
    closed = [stream.close() for stream, _ in streams]
    print(
        json.dumps(
            {
                "closed": closed,
                "dropped": [stream.dropped for stream, _ in streams],
                "trouble": [stream.trouble for stream, _ in streams],
                "handed": handed,
            }
        ),
        flush=True,
    )


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]), *sys.argv[5:])
