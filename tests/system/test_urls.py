"""Passwords in URLs: refused before anything is asked for, and never repeated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from trajeval_ros.batch.config import plan_of, plan_of_sources
from trajeval_ros.batch.patterns import Pattern
from trajeval_ros.batch.plan import Plan
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.sources import parse_source, require_no_password


@pytest.mark.parametrize(
    "url",
    [
        "s3://me:secret@bucket/{sequence}.mcap:/odometry",
        "sftp://me:se@cret@host/{sequence}",
        "https://secret@host.net/{sequence}.mcap",
        "s3://secret@bucket/{sequence}.mcap:/odometry",
        "zip://{sequence}.mcap::https://secret@host.net/x.zip",
    ],
)
def test_a_password_in_a_url_is_refused_and_not_repeated(url: str) -> None:
    for read in (parse_source, Pattern.parse):
        with pytest.raises(InputError, match="has a user name or password") as told:
            read(url)
        assert "cret" not in str(told.value)


@pytest.mark.parametrize(
    "name", ["X-Amz-Signature", "sig", "access_token", "key", "pwd", "passphrase"]
)
@pytest.mark.parametrize("before", ["?", "?part=1&", "?part=1;", "#"])
def test_a_token_in_a_url_is_refused_and_not_repeated(name: str, before: str) -> None:
    for read in (parse_source, Pattern.parse):
        with pytest.raises(
            InputError, match=r"https://host\.net has a secret in its query"
        ) as told:
            read(f"https://host.net/x.mcap{before}{name}=hidden")
        assert "hidden" not in str(told.value)


@pytest.mark.parametrize(
    "url",
    [
        "s3://bucket/a:b@c.mcap",
        "sftp://me@host:22/x:/tf:a:b@c",
        "abfs://container@account.dfs.core.windows.net/x.mcap",
        "s3://bucket:/topic@x",
        "github://owner:repository@main/x.txt",
    ],
)
def test_a_user_a_port_and_a_topic_are_no_password(url: str) -> None:
    require_no_password(url)


SIGNED = "https://host.net/x.yaml?X-Amz-Signature=hidden"


@pytest.mark.parametrize(
    "plan",
    [
        lambda folder: plan_of_sources([SIGNED, "a.txt"], {}),
        lambda folder: plan_of_sources(["a.txt", f"vio={SIGNED}"], {}),
        lambda folder: plan_of(SIGNED, {}),
        lambda folder: plan_of(f"{SIGNED}.csv", {}),
        lambda folder: plan_of(yaml_with(folder, f"manifest: '{SIGNED}.csv'"), {}),
        lambda folder: plan_of(
            yaml_with(folder, f"groundtruth: 'g_{{sequence}}'\nruns: {{a: '{SIGNED}'}}"), {}
        ),
    ],
    ids=["groundtruth", "estimate", "target", "manifest", "manifest of YAML", "runs of YAML"],
)
def test_no_plan_of_a_comparison_has_a_token(plan: Callable[[Path], Plan], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has a secret in its query") as told:
        plan(tmp_path)
    assert "hidden" not in str(told.value)


def yaml_with(folder: Path, text: str) -> Path:
    path = folder / "comparison.yaml"
    path.write_text(text)
    return path
