"""The composite action: its inputs, and its step as a runner of GitHub starts it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import write_run, write_runs
from paths import ROOT
from ruamel.yaml import YAML

SCRIPT = ROOT / "action" / "compare.sh"
ACTION: dict[str, Any] = YAML(typ="safe").load((ROOT / "action.yml").read_text())
[STEP] = ACTION["runs"]["steps"]
pytestmark = pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
# Makes an environment whose pip only writes down what it is asked for, and without figures.
PYTHON = """#!/bin/sh
mkdir -p "$3/bin"
cat > "$3/bin/python" <<END
#!/bin/sh
printf '%s\\n' "\\$@" >> {log}
END
cat > "$3/bin/trajeval" <<END
#!/bin/sh
exec "{python}" -m trajeval_ros "\\$@" --figures 0 --workers 1
END
chmod +x "$3/bin/python" "$3/bin/trajeval"
"""


class Job:
    """A folder with runs, as a job has checked it out."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "repository"
        self.folder.mkdir()
        write_runs(self.folder)
        self.temporary, self.installed = folder / "temporary", folder / "installed"
        self.temporary.mkdir()
        python = folder / "python"
        python.write_text(PYTHON.format(log=self.installed, python=sys.executable))
        python.chmod(0o755)
        self._python = str(python)

    def run(self, **inputs: str) -> subprocess.CompletedProcess[str]:
        """Run the step with these inputs, the others at their defaults."""
        given = {
            name: inputs.get(name.replace("-", "_"), about.get("default", ""))
            for name, about in ACTION["inputs"].items()
        }
        given["python"] = self._python
        expression = re.compile(r"\$\{\{ inputs\.([\w-]+) \}\}")
        variables = {
            name: expression.sub(lambda match: given[match[1]], value)
            for name, value in STEP["env"].items()
        }
        runner = {
            "GITHUB_ACTION_PATH": str(ROOT),
            "GITHUB_STEP_SUMMARY": str(self.folder.parent / "summary.md"),
            "GITHUB_OUTPUT": str(self.folder.parent / "output"),
            "RUNNER_TEMP": str(self.temporary),
            "PYTHONPATH": str(ROOT),
        }
        return subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", STEP["run"]],
            cwd=self.folder,
            env={**os.environ, **runner, **variables},
            capture_output=True,
            text=True,
            check=False,
        )

    @property
    def summary(self) -> str:
        return (self.folder.parent / "summary.md").read_text()

    @property
    def outputs(self) -> dict[str, str]:
        lines = (self.folder.parent / "output").read_text().splitlines()
        return dict(line.split("=", 1) for line in lines)


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job(tmp_path)


def test_inputs_never_stand_in_a_command() -> None:
    assert "${{" not in STEP["run"]
    assert "${{" not in SCRIPT.read_text()
    assert set(STEP["env"].values()) == {f"${{{{ inputs.{item} }}}}" for item in ACTION["inputs"]}
    used = set(re.findall(r"TRAJEVAL_\w+", SCRIPT.read_text()))
    assert used == set(STEP["env"])


def test_outputs_are_those_of_the_step() -> None:
    written = re.search(r"printf '(.*)\\n'", SCRIPT.read_text())
    assert written is not None
    names = [word.split("=")[0] for word in written[1].split("\\n")]
    assert names == list(ACTION["outputs"])
    for name in names:
        value = ACTION["outputs"][name]["value"]
        assert value == f"${{{{ steps.{STEP['id']}.outputs.{name} }}}}"


@pytest.mark.slow
def test_without_a_baseline_the_tables_are_the_summary(job: Job) -> None:
    done = job.run(config="runs.yaml")
    assert done.returncode == 0, done.stderr
    assert "### ATE, position [m]" in job.summary
    assert job.summary == (job.folder / "comparison" / "tables.md").read_text() + "\n"
    for name, file in (("runs", "runs.parquet"), ("report", "report.html")):
        assert job.outputs[name] == f"comparison/{file}"
        assert (job.folder / "comparison" / file).exists()
    installed = job.installed.read_text().split("\n")
    assert f"{ROOT}[compare]" in installed
    assert str(ROOT / "constraints.txt") in installed


@pytest.mark.parametrize("status", [0, 1])
def test_large_tables_do_not_change_the_status(status: int, job: Job) -> None:
    python = job.folder.parent / "python"
    text = python.read_text()
    begin = text.index("exec ")
    made = (
        "mkdir -p comparison; head -c 3000000 /dev/zero | tr '\\0' x >comparison/tables.md; "
        f"touch comparison/runs.parquet; exit {status}"
    )
    python.write_text(text[:begin] + made + text[text.index("\n", begin) :])
    assert job.run(config="runs.yaml").returncode == status
    assert len(job.summary) == 1_000_000
    assert job.outputs["runs"] == "comparison/runs.parquet"


@pytest.mark.slow
def test_what_is_worse_fails_and_is_told_first(job: Job) -> None:
    assert job.run(config="runs.yaml", output="old").returncode == 0
    shutil.copy(job.folder / "old" / "runs.parquet", job.folder / "main.parquet")
    baseline = {"config": "runs.yaml", "baseline": "main.parquet"}
    gates = "ate.position_m.rmse worse than 5 %\n\n  \nate.position_m.max worse than 5 %\n"
    same = job.run(**baseline, fail_if=gates, undecided="pass")
    assert same.returncode == 0, same.stderr
    # Equal errors are no evidence that nothing has become worse.
    assert job.run(**baseline, fail_if=gates).returncode == 1
    for sequence in ("hall", "yard"):
        for trial in (0, 1):
            write_run(job.folder / "good" / f"{sequence}_trial{trial}.txt", 1.05 + 0.001 * trial)
    (job.folder.parent / "summary.md").unlink()
    worse = job.run(**baseline, fail_if=gates, options="--false-alarms\n20\n")
    assert worse.returncode == 1, worse.stderr
    assert job.summary.startswith((job.folder / "comparison" / "gates.md").read_text())
    assert job.summary.index("worse") < job.summary.index("### ATE, position [m]")
    assert "ate.position_m.max" in job.summary


@pytest.mark.slow
def test_what_cannot_be_compared_is_told(job: Job) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    (job.folder / "comparison").mkdir()
    (job.folder / "comparison" / "gates.md").write_text("inconclusive\n")
    (job.folder / "comparison" / "runs.parquet").write_bytes(b"of an earlier comparison")
    done = job.run(config="rnus.yaml")
    assert done.returncode == 2
    assert "rnus.yaml does not exist" in done.stderr
    assert "inconclusive" not in job.summary
    assert not job.folder.parent.joinpath("output").exists()
    assert "ended with status 2" in job.summary


@pytest.mark.slow
def test_files_of_the_user_stay_and_are_not_shown(job: Job) -> None:
    folder = job.folder / "comparison"
    folder.mkdir()
    for name in ("tables.md", "gates.md"):
        (folder / name).write_text(f"the user's {name}\n")
    assert job.run(config="runs.yaml").returncode == 2
    assert {path.name: path.read_text() for path in folder.iterdir()} == {
        name: f"the user's {name}\n" for name in ("tables.md", "gates.md")
    }
    assert "the user's" not in job.summary


@pytest.mark.slow
def test_a_gate_that_cannot_fail_ends_with_its_tables(job: Job) -> None:
    write_runs(job.folder, ["hall"], ["good"], trials=1)
    assert job.run(config="runs.yaml", output="old").returncode == 0
    shutil.copy(job.folder / "old" / "runs.parquet", job.folder / "main.parquet")
    done = job.run(config="runs.yaml", baseline="main.parquet")
    assert done.returncode == 2
    assert "cannot fail" in done.stderr
    assert "inconclusive" in job.summary
    assert "### ATE, position [m]" in job.summary


@pytest.mark.slow
@pytest.mark.parametrize("name", ["config", "baseline", "output", "fail_if", "options"])
def test_an_input_is_never_a_command(name: str, job: Job) -> None:
    evil = 'x\'; touch pwned; "$(touch pwned)`touch pwned`" ; #'
    inputs = {"config": "runs.yaml", "baseline": "main.parquet", name: evil}
    job.run(**inputs)
    assert not list(job.folder.parent.rglob("pwned"))


@pytest.mark.parametrize("name", ["config", "baseline", "output"])
@pytest.mark.parametrize("path", ["--help", "a\nruns=b"])
def test_a_path_is_no_option_and_no_output(name: str, path: str, job: Job) -> None:
    done = job.run(**{"config": "runs.yaml", name: path})
    assert done.returncode == 2
    assert "starts with a dash or has two lines" in done.stderr
    assert not job.temporary.exists() or not list(job.temporary.iterdir())


@pytest.mark.skipif(not shutil.which("make"), reason="make is missing")
def test_an_audit_that_looked_nothing_up_fails(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "pip-audit"
    program.write_text('#!/bin/sh\ncase " $* " in *" --strict "*) exit 1 ;; esac\n')
    program.chmod(0o755)
    (tmp_path / ".installed").touch()
    done = subprocess.run(
        ["make", "--no-print-directory", "audit", f"AUDIT={tmp_path}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout.split() == ["constraints.txt:", "constraints-ros.txt:"]
