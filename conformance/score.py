"""Scores a tool's results against the expected values of the cases.

    python score.py RESULT.json...          one line per tool, and every number that is wrong
    python score.py --table RESULT.json...  a table of the tools in Markdown
    python score.py --relative 1e-12 R.json a tolerance of its own, for numbers of many digits

A result is one JSON file per tool:

    {"tool": "name", "version": "1.0", "results": {"CASE": {"QUANTITY": NUMBER}}}

NUMBER is a JSON number or a text of more digits; "undetermined" if the tool withholds it because
the data do not determine it. A quantity that the tool does not have is left out. "error" in place
of a case's object, or of a number, is a text about what the tool refused.

The exit status is 0 if no number is wrong, else 1. Needs Python 3.8 and nothing else.
"""

import argparse
import json
import re
import sys
from collections import Counter
from decimal import Decimal, InvalidOperation, getcontext
from pathlib import Path

CASES = Path(__file__).parent / "cases"
RIGHT, WITHHELD, WRONG, REFUSED = "right", "undetermined", "wrong", "refused"
ABSENT = "not offered"
OUTCOMES = (RIGHT, WITHHELD, WRONG, REFUSED, ABSENT)
getcontext().prec = 60
# Numbers that are none, as C prints them.
_NAN = re.compile(r"(?<=[:\s])-?(nan|inf)(?=\s*[,}])", re.IGNORECASE)


def expected():
    """Return the expected quantities by case."""
    return {
        file.parent.name: json.loads(file.read_text(encoding="ascii"))["quantities"]
        for file in sorted(CASES.glob("*/expected.json"))
    }


def judge(answer, entry, relative=None):
    """Return the outcome of one answer, and a text about the difference."""
    if answer == "undetermined":
        return (WITHHELD, "") if entry.get("undetermined") else (WRONG, "withheld, has a value")
    try:
        if isinstance(answer, bool):
            raise TypeError
        number = Decimal(str(answer))
    except (InvalidOperation, TypeError):
        return REFUSED, str(answer)
    if not number.is_finite():
        return WRONG, "not a finite number"
    if entry["value"] is None:
        return WRONG, f"{float(number):.6g}, but the data do not determine it"
    value = Decimal(entry["value"])
    difference = abs(number - value)
    tolerance = Decimal(repr(entry["tolerance"]))
    if relative is not None:
        tolerance = relative * max(abs(value), Decimal("1e-12"))
    if difference <= tolerance:
        return RIGHT, ""
    return WRONG, (
        f"expected {float(value):.12g}, got {float(number):.12g} "
        f"({float(difference / tolerance) if tolerance else float(difference):.2g} tolerances)"
    )


def score(result, relative=None):
    """Return (case, quantity, outcome, text) of every quantity of every case."""
    rows = []
    for case, quantities in expected().items():
        answers = result["results"].get(case, {})
        for quantity, entry in quantities.items():
            if isinstance(answers, str):
                rows.append((case, quantity, REFUSED, answers))
            elif quantity not in answers:
                rows.append((case, quantity, ABSENT, ""))
            else:
                rows.append((case, quantity, *judge(answers[quantity], entry, relative)))
    return rows


def group(quantity):
    """Return the column of the table that a quantity belongs to."""
    rule, _, rest = quantity.rpartition(":")
    if rule:
        return "association"
    kind = rest.split(".")[0]
    names = {"position_m": "position ATE", "rotation_deg": "rotation ATE", "scale": "scale"}
    return names.get(kind, {"relative": "relative", "kitti": "KITTI", "nees": "NEES"}.get(kind))


def name_of(result):
    """Return the tool and its version."""
    return f"{result['tool']} {result['version']}".strip()


def table(results, relative):
    """Return the numbers that are right of those that the tool has, by kind, as Markdown."""
    columns = ["position ATE", "rotation ATE", "scale", "association", "relative", "KITTI", "NEES"]
    lines = [
        "| tool | " + " | ".join([*columns, "undetermined", "wrong", "refused"]) + " |",
        "|---|" + "---:|" * (len(columns) + 3),
    ]
    for result in results:
        rows = score(result, relative)
        cells = []
        for column in columns:
            counts = Counter(row[2] for row in rows if group(row[1]) == column)
            answered = counts[RIGHT] + counts[WRONG]
            cells.append(f"{counts[RIGHT]} of {answered}" if answered else "")
        counts = Counter(row[2] for row in rows)
        cells += [str(counts[outcome]) for outcome in (WITHHELD, WRONG, REFUSED)]
        lines.append(f"| {name_of(result)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main():
    """Print the scores of the files on the command line."""
    parser = argparse.ArgumentParser(description="Scores results; see conformance/README.md.")
    parser.add_argument("results", nargs="+", metavar="RESULT.json", help="one file per tool")
    parser.add_argument("--table", action="store_true", help="print a table in Markdown")
    parser.add_argument(
        "--relative", type=Decimal, metavar="R", help="relative tolerance instead of the case's"
    )
    arguments = parser.parse_args()
    results = []
    for name in arguments.results:
        try:
            result = json.loads(_NAN.sub("NaN", Path(name).read_text(encoding="utf-8")))
            results.append({"version": "", **result, "tool": str(result["tool"])})
            unknown = result["results"].keys() - expected().keys()
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            parser.error(
                f"{name}: not a result ({type(error).__name__}: {error}); it needs "
                '{"tool": ..., "results": {"CASE": {"QUANTITY": NUMBER}}}'
            )
        if unknown:
            parser.error(f"{name}: unknown case {sorted(unknown)[0]!r}; see the folder cases")
    wrong = 0
    if arguments.table:
        print(table(results, arguments.relative))
    for result in results:
        rows = score(result, arguments.relative)
        counts = Counter(row[2] for row in rows)
        wrong += counts[WRONG]
        if arguments.table:
            continue
        print(f"{name_of(result)}: " + ", ".join(f"{counts[item]} {item}" for item in OUTCOMES))
        for case, quantity, outcome, text in rows:
            if outcome in (WRONG, REFUSED):
                print(f"  {case}  {quantity}: {outcome}, {text}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
