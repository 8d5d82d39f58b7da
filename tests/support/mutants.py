"""Change the package's code at random, and tell which changes no test notices: `make mutate`.

cosmic-ray's operators change one place at a time in a copy of the checkout: an operator, a
comparison, a number, a loop. Then the tests of the file are run until one fails. A change
that survives is a place that no law holds, or one that means the same.

    python tests/support/mutants.py SUBPACKAGE [--count 50] [--seed 0] [--only FILE,FILE]
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
import shutil
import sys
import tempfile
from collections import defaultdict
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

PATIENCE_S = 300.0

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
    "studies": ["studies"],
    "visual_inertial": ["visual_inertial"],
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
            found = (place for node in nodes for place in operator.mutation_positions(node))
            for occurrence, (start, _) in enumerate(found):
                places[file, start].append((operator, occurrence))
    order = list(places)
    generator.shuffle(order)
    for file, start in order:
        before = file.read_text()
        after = mutate_code(before, *generator.choice(places[file, start]))
        with contextlib.suppress(SyntaxError):
            if after is not None and what_runs(after) != what_runs(before):
                yield file, after


def is_green(tests: list[str], patience_s: float | None = PATIENCE_S) -> bool:
    """Run tests in a child, which has all libraries already and imports the package anew."""
    child = multiprocessing.get_context("fork").Process(target=_run, args=(tests,))
    child.start()
    child.join(patience_s)
    if child.is_alive():
        child.kill()
        child.join()
    return child.exitcode == 0


def _run(tests: list[str]) -> None:
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    sys.path.insert(0, str(Path.cwd()))
    np.random.seed(0)  # noqa: NPY002  other people's
    for speed in ("not slow", "slow"):  # most changes are noticed by the fast ones
        marks = ["-m", f"{speed} and not ros and not oracles", "-p", "no:cacheprovider"]
        status = pytest.main(["-x", "-q", *marks, *tests])
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            sys.exit(status)
    sys.exit(0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subpackage", choices=SUBPACKAGES)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="files of the subpackage, with commas between")
    asked = parser.parse_args()
    sys.dont_write_bytecode = True
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        left_out = shutil.ignore_patterns(".*", "*.egg-info", "demo_output", "build")
        shutil.copytree(ROOT, copy, ignore=left_out)
        if (ROOT.parent / "shared").exists():  # recordings, which some tests need
            (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
        os.chdir(copy)
        compileall.compile_dir(copy / "trajeval_ros", quiet=1)
        tests = [f"tests/{folder}" for folder in SUBPACKAGES[asked.subpackage]]
        only = asked.only.split(",") if asked.only else []
        files = [
            file
            for file in sorted((copy / "trajeval_ros" / asked.subpackage).glob("*.py"))
            if file.stem != "__init__" and (not only or file.stem in only)
        ]
        if not is_green(tests, None):
            print("the tests fail without any change", file=sys.stderr)
            return 2
        survivors = 0
        chosen = mutants(files, random.Random(asked.seed))
        for number, (file, after) in zip(range(1, asked.count + 1), chosen, strict=False):
            before, times = file.read_text(), file.stat()
            file.write_text(after)
            survived = is_green(tests)
            file.write_text(before)
            os.utime(file, (times.st_atime, times.st_mtime))  # its bytecode is valid again
            survivors += survived
            name = str(file.relative_to(copy))
            print(f"{number:3} {name}: {'SURVIVED' if survived else 'killed'}", flush=True)
            if survived:
                lines = (each.splitlines() for each in (before, after))
                changed = list(difflib.unified_diff(*lines, name, name, n=0, lineterm=""))[2:]
                print(*changed, sep="\n", flush=True)
    print(f"{survivors} of {asked.count} changes of {asked.subpackage} survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
