"""Change the package's code at random, and tell which changes no test notices: `make mutate`.

cosmic-ray's operators change one place at a time in a copy of the checkout: an operator, a
comparison, a number, a loop. Then the tests of the file are run until one fails. A change
that survives is a place that no law holds, or one that means the same.

    python tests/support/mutants.py SUBPACKAGE [--count 50] [--seed 0] [--only FILE,FILE]

Of `all`, files are chosen from the whole package but `ros`, and the tests are those that import
the file, then those of its folder. What is not noticed within --patience seconds is undecided.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import contextlib
import difflib
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import hypothesis.extra.numpy  # noqa: F401  what is imported here, no run has to import again
import numpy as np
import pytest
import scipy.sparse.linalg
import scipy.spatial.transform
import scipy.stats  # noqa: F401
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from paths import ROOT

MOST_FILES = 20

# Subpackages whose files are changed. Their tests are in the folder of the same name; `metrics`,
# which everything uses, also has tests of whole evaluations.
SUBPACKAGES = {
    "batch": ["batch"],
    "calibration": ["calibration"],
    "cli": ["cli"],
    "consistency": ["consistency"],
    "diagnosis": ["diagnosis"],
    "geometry": ["geometry"],
    "io/bags": ["io/bags"],
    "io/text": ["io/text"],
    "metrics": ["metrics", "system"],
    "papers": ["papers"],
    "watchdog": ["watchdog"],
}


class WithoutWords(ast.NodeTransformer):
    """Takes away what doesn't run: annotations and docstrings."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        self.generic_visit(node)
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        node.annotation = ast.Constant(None)
        self.generic_visit(node)
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.Expr:
        return ast.Expr(ast.Constant(None)) if isinstance(node.value, ast.Constant) else node


def what_runs(source: str) -> str:
    return ast.dump(WithoutWords().visit(ast.parse(source)))


def mutants(files: list[Path], generator: random.Random) -> Iterator[tuple[Path, str]]:
    """Yield files and what they become, at random: first a place, then what is done to it."""
    operators = [get_operator(name) for name in operator_names()]
    ready = [kind() for kind in operators if not kind.arguments()]
    places = defaultdict(list)
    for file in files:
        nodes = list(ast_nodes(get_ast(file.read_text())))
        for operator in ready:
            result = (place for node in nodes for place in operator.mutation_positions(node))
            for occurrence, (start, _) in enumerate(result):
                places[file, start].append((operator, occurrence))
    order = list(places)
    generator.shuffle(order)
    for file, start in order:
        before = file.read_text()
        # An operator of exceptions knows no attributes, as in `except np.linalg.LinAlgError`.
        with contextlib.suppress(SyntaxError, AttributeError):
            after = mutate_code(before, *generator.choice(places[file, start]))
            if after is not None and what_runs(after) != what_runs(before):
                yield file, after


def outcome(tests: list[str], patience_s: float | None) -> str:
    """Run tests in a child, which has all libraries already and imports the package anew."""
    child = multiprocessing.get_context("fork").Process(target=_run, args=(tests,))
    child.start()
    child.join(patience_s)
    if child.is_alive():
        child.kill()
        child.join()
        return "UNDECIDED"
    return "SURVIVED" if child.exitcode == 0 else "killed"


def tests_of(file: Path) -> list[str]:
    """Return the tests that import a file of the package, and the folder of its subpackage."""
    folder = file.parent.relative_to("trajeval_ros")
    while not (Path("tests") / folder).is_dir():
        folder = folder.parent
    module = re.compile(rf"\b{'.'.join(file.with_suffix('').parts)}\b".replace(".", r"\."))
    result = [path for path in Path("tests").rglob("test_*.py") if module.search(path.read_text())]
    near = sorted(result, key=lambda item: (item.parent != Path("tests") / folder, item))
    own = Path("tests") / (folder if folder.parts else "system")
    of_all = Path("tests/system/test_package.py")  # it reads every file
    # To collect everything that uses the file takes minutes.
    return list(map(str, [*near[:MOST_FILES], own, of_all]))


def _run(tests: list[str]) -> None:
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    sys.path.insert(0, str(Path.cwd()))
    del sys.modules["paths"]  # the copy has its own
    np.random.seed(0)  # noqa: NPY002  other people's
    for speed in ("not slow", "slow"):  # most changes are noticed by the fast ones
        marks = ["-m", f"{speed} and not ros and not oracles", "-p", "no:cacheprovider"]
        status = pytest.main(["-x", "-q", *marks, *tests])
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            sys.exit(status)
    sys.exit(0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subpackage", choices=[*SUBPACKAGES, "all"])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="files of the subpackage, with commas between")
    parser.add_argument("--patience", type=float, default=300.0, help="seconds for each change")
    asked = parser.parse_args()
    sys.dont_write_bytecode = False
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"  # for the processes that tests start
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        left_out = shutil.ignore_patterns(".*", "*.egg-info", "demo_output", "build")
        shutil.copytree(ROOT, copy, ignore=left_out)
        if (ROOT.parent / "shared").exists():  # recordings, which some tests need
            (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
        os.chdir(copy)
        compileall.compile_dir(copy / "trajeval_ros", quiet=1)
        outcome(["--collect-only", "tests"], None)  # keeps the bytecode of rewritten tests
        sys.dont_write_bytecode = True
        everything = asked.subpackage == "all"
        tests = (
            []
            if everything
            else [f"tests/{subpackage}" for subpackage in SUBPACKAGES[asked.subpackage]]
        )
        only = asked.only.split(",") if asked.only else []
        package = Path("trajeval_ros")
        result = package.rglob("*.py") if everything else (package / asked.subpackage).glob("*.py")
        files = [
            file
            for file in sorted(result)
            if file.stem != "__init__"
            and file.parent != package / "ros"
            and (not only or file.stem in only)
        ]
        if tests and outcome(tests, None) != "SURVIVED":
            print("the tests fail without any change", file=sys.stderr)
            return 2
        counts: Counter[str] = Counter()
        chosen = mutants(files, random.Random(asked.seed))
        for number, (file, after) in zip(range(1, asked.count + 1), chosen, strict=False):
            before, times = file.read_text(), file.stat()
            file.write_text(after)
            become = outcome(tests or tests_of(file), asked.patience)
            file.write_text(before)
            os.utime(file, (times.st_atime, times.st_mtime))  # its bytecode is valid again
            counts[become] += 1
            print(f"{number:3} {file}: {become}", flush=True)
            if become != "killed":
                lines = (item.splitlines() for item in (before, after))
                changed = difflib.unified_diff(*lines, str(file), str(file), n=0, lineterm="")
                print(*list(changed)[2:], sep="\n", flush=True)
    print(f"changes of {asked.subpackage}, seed {asked.seed}: {dict(counts)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
