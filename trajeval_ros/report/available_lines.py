"""The lines about the messages of a bag, and about the as-available accuracy."""

from __future__ import annotations

from trajeval_ros.formatting.numbers import counted, four_digits, significant
from trajeval_ros.metrics.as_available import Availability, Spans
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.metrics.stream_health import StreamHealth

_CLOCKS = {"log": "log times", "publish": "publish times"}


def stream_line(stream: StreamHealth) -> str:
    """Return the line about arrivals, missed messages and gaps of a stream; "" if none."""
    parts = []
    if stream.arrival_p50_s is not None and stream.arrival_p95_s is not None:
        median, p95, most = (
            significant(item or 0.0, 3)
            for item in (stream.arrival_p50_s, stream.arrival_p95_s, stream.arrival_max_s)
        )
        parts.append(f"arrival after timestamp {median} s median, {p95} s p95, {most} s max")
    if stream.missed:
        parts.append(f"{stream.missed} of {stream.messages + stream.missed} messages missed")
    if stream.largest_gap_s is not None and parts:
        parts.append(f"longest gap between messages {significant(stream.largest_gap_s, 3)} s")
    return f"  {'; '.join(parts)}" if parts else ""


def available_lines(numbers: Availability, ate_m: float) -> list[str]:
    """Return the lines about the as-available accuracy, next to the ATE; none if withheld."""
    position, age, parts = numbers.position_m, numbers.age_s, numbers.parts
    moved, latency = numbers.age_error_m, numbers.latency_s
    if position is None or age is None or parts is None or moved is None or latency is None:
        return []
    assert numbers.dropouts is not None
    by = _CLOCKS.get(numbers.received, "receive times")
    shares = ", ".join(
        f"{name} {four_digits(part.rmse_m)} m ({100.0 * part.share:.0f} %)"
        for name, part in parts.items()
    )
    is_relative = numbers.clock is not None and numbers.clock.offset_s is None
    above = " above the fastest message" if is_relative else ""
    lines = [
        f"  as available {four_digits(position.rmse)} m rmse, {four_digits(position.p95)} m p95"
        f"{_degrees(numbers.rotation_deg)} ({numbers.motion}, {numbers.rate_hz} Hz, {by}, "
        f"alignment as above; ATE {four_digits(ate_m)} m)",
        f"    age error  {four_digits(moved.rmse)} m{_degrees(numbers.age_error_deg)}; error by "
        f"part: {shares}",
        f"    pose age   {significant(age.mean, 3)} s mean, {significant(age.p95, 3)} s p95; "
        f"latency{above} {significant(latency.median, 3)} s median; "
        f"{numbers.available_percent:.1f} % of the time within {numbers.deadline_s:g} s; "
        f"{counted(numbers.dropouts.count, 'dropout')}{_longest(numbers.dropouts)}, "
        f"{counted(numbers.late_messages or 0, 'late message')}",
    ]
    corrected = numbers.corrections and numbers.corrections["age_s"]
    if corrected:
        lines[-1] += f"; newest correction {significant(corrected.median, 3)} s old (median)"
    if numbers.recording_s is not None:
        median, most = (significant(item, 2) for item in numbers.recording_s)
        lines[-1] += f"; transport and recording took {median} s median, {most} s max"
    return lines


def _degrees(statistics: Statistics | None) -> str:
    return "" if statistics is None else f", {four_digits(statistics.rmse)} deg"


def _longest(spans: Spans) -> str:
    """Return the longest of spans as text; empty without any."""
    return f" (longest {significant(spans.longest_s, 3)} s)" if spans.count else ""
