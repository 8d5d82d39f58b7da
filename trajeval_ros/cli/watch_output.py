"""Output of `trajeval watch`: JSON, figure and tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trajeval_ros.watchdog.alarm_book import AlarmBook
    from trajeval_ros.watchdog.recording import Watched


def deliver_watch(
    estimate: str,
    seen: Watched,
    book: AlarmBook,
    *,
    json: str | None,
    figure: Path | None,
    quiet: bool,
    learn: Path | None,
) -> None:
    """Write the requested files and print the tables."""
    from trajeval_ros.io.json_file import json_text
    from trajeval_ros.io.results.watch_json import watch_json
    from trajeval_ros.io.writing import write_text

    text = json_text(watch_json(estimate, seen, book), indent=2)
    if json == "-":
        sys.stdout.write(text)
    elif json is not None:
        write_text(Path(json), text, follow_link=True)
    if figure is not None:
        from trajeval_ros.cli.source_names import names_of
        from trajeval_ros.report import canvas
        from trajeval_ros.report.figure_style import house_style
        from trajeval_ros.report.figures import write_figure
        from trajeval_ros.report.watch_figure import watch_figure

        with house_style():
            drawn = watch_figure(seen, book, *canvas.short_names(names_of([estimate])))
            write_figure(drawn, figure)
    if not quiet and json != "-":
        _print(seen, book, learn)


def _print(seen: Watched, book: AlarmBook, learn: Path | None) -> None:
    from trajeval_ros.report import watch_lines
    from trajeval_ros.report.console import add_rows, console, new_table, show

    terminal = console()
    for notice in seen.notices:
        terminal.print(f"note: {notice}", soft_wrap=True)
    if book.alarms:
        table = new_table("", watch_lines.ALARM_WORDS, watch_lines.ALARM_NUMBERS)
        add_rows(table, watch_lines.alarm_rows(book))
        show(terminal, table)
    table = new_table("", watch_lines.SIGNAL_WORDS, watch_lines.SIGNAL_NUMBERS)
    add_rows(table, watch_lines.signal_rows(seen, book))
    show(terminal, table)
    if learn is None:
        terminal.print(watch_lines.seen_line(seen, book), soft_wrap=True)
        terminal.print(watch_lines.evidence_line(book.limits, book.factor), soft_wrap=True)
        return
    said = (
        "healthy against groundtruth, in windows of 1 s"
        if book.limits.checked == "checked against groundtruth"
        else "not checked for health: inspect the largest values and their times, or add "
        "--groundtruth"
    )
    terminal.print(f"wrote {learn} from {seen.hours:.3f} h; {said}", soft_wrap=True)
