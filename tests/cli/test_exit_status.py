"""Exit status of programs: what is printed for each error, and no more than a line."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from comparison_runs import write_run

from trajeval_ros.cli.app import main
from trajeval_ros.cli.programs import INTERRUPTED, Debugging, exit_status
from trajeval_ros.exceptions import InputError, SettingsError


def raising(error: BaseException, cause: BaseException | None = None) -> Callable[[], int | None]:
    def work() -> int | None:
        raise error from cause

    return work


@pytest.mark.parametrize(
    ("work", "status", "message"),
    [
        (lambda: None, 0, ""),
        (lambda: 0, 0, ""),
        (lambda: 1, 1, ""),
        (lambda: INTERRUPTED, 130, "trajeval: interrupted\n"),
        (raising(KeyboardInterrupt()), 130, "trajeval: interrupted\n"),
        (raising(RuntimeError("set"), KeyboardInterrupt()), 130, "trajeval: interrupted\n"),
        (raising(ImportError("set"), KeyboardInterrupt()), 130, "trajeval: interrupted\n"),
        (raising(InputError("a: b\n  c\t; d")), 2, "trajeval: a: b c ; d\n"),
        (raising(SettingsError("\x1b[31mred")), 2, "trajeval: \\x1b[31mred\n"),
        (raising(OSError(28, "No space left", "x.txt")), 2, "trajeval: x.txt: no space left\n"),
        (raising(OSError(28, "No space left")), 2, "trajeval: no space left\n"),
        (raising(OSError("broken")), 2, "trajeval: broken\n"),
    ],
)
def test_status_and_message(
    work: Callable[[], int | None], status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_status(work) == status
    assert capsys.readouterr() == ("", message)


@pytest.mark.parametrize("option", ["--json", "--hand-eye", "--protocol", "--gauge", "--require"])
@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("https://me:hidden@host.net/x.yaml", "…@host.net/x.yaml"),
        ("zip://x.yaml::https://hidden@host.net/x.zip", "…@host.net/x.zip"),
        ("https://host.net/x?part=1&Access_Token=hidden&b=1", "host.net/x?part=1&Access_Token=…"),
    ],
)
def test_no_message_repeats_the_secret_of_a_url(
    option: str, url: str, shown: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(write_run(tmp_path / "run.txt"))
    assert main(["evaluate", run, run, option, url]) == 2
    text = capsys.readouterr().err
    assert "hidden" not in text
    assert shown in text or "which results and logs repeat" in text  # parsed as a SOURCE


def test_defects_are_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError):
        exit_status(lambda: 1 // 0)
    with pytest.raises(RuntimeError, match="defect"):
        exit_status(raising(RuntimeError("defect"), ValueError()))


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_closed_output_is_replaced(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, name, None)
    assert exit_status(lambda: print("lost", file=getattr(sys, name))) == 0
    assert isinstance(getattr(sys, name), io.TextIOBase)
    getattr(sys, name).close()


@pytest.mark.parametrize("is_joint", [False, True])
def test_the_traceback_of_a_refusal_is_written_on_request(
    is_joint: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(Debugging, "path", None)
    damaged, traceback = tmp_path / "poses.npy", tmp_path / "traceback.txt"
    damaged.write_bytes(b"\x93NUMPY\x01\x00")
    words = [f"--debug={traceback}"] if is_joint else ["--debug", str(traceback)]
    assert main([*words, "evaluate", str(damaged), str(damaged)]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"trajeval: {damaged} is not a readable array of numpy")
    assert printed.count("\n") == 1
    text = traceback.read_text()
    assert text.index("ValueError: EOF") < text.index(
        "InputError: "
    )  # the cause, then the refusal


def test_a_traceback_that_cannot_be_written_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Debugging, "path", None)
    assert main(["--debug", f"{tmp_path}/none/x", "info", f"{tmp_path}/absent"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith(f"trajeval: {tmp_path}/none/x can't be written")
    assert f"{tmp_path}/absent" in second


def test_causes_in_a_circle_have_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error, cause = InputError("refused"), ValueError("damaged")
    error.__cause__, cause.__cause__ = cause, error
    monkeypatch.setattr(Debugging, "path", tmp_path / "traceback.txt")
    assert exit_status(raising(error, cause)) == 2
    assert "ValueError: damaged" in (tmp_path / "traceback.txt").read_text()
