"""From the calls of other programs in data/parity to the options of `trajeval evaluate`.

data/parity/README.md has the table.
"""

from __future__ import annotations

from typing import Any

from parity import ENTRIES, Row, Setting

EVO_UNITS = {"f": "f", "m": "m", "d": "deg", "r": "rad"}
# By evo's options: those of `Selection`.
EVO_SELECTION = {
    "--all_pairs": "sub_trajectories: all",
    "--pairs_from_reference": "sub_trajectory_path: groundtruth",
    "-t": "sub_trajectory_tolerance: {}",
}
RPG_GAUGES = {"none": "none", "posyaw": "yaw", "se3": "se3", "sim3": "sim3"}
RPG_LENGTHS = "10%,20%,30%,40%,50%,8,16"


# Why a row is not compared.
REFUSED = "the program refused the files"
DEFECT = "a defect of the program, which trajeval doesn't reproduce"
TOO_FEW = "the program reports zeros of fewer than two sub-trajectories"


def rows() -> list[Row]:
    """Return every row of every reference."""
    return [row for entry in ENTRIES for row in _TOOLS[entry["tool"]](entry)]


def _rows(entry: dict[str, Any], setting: Setting | None, **others: Any) -> list[Row]:
    why = others.pop("unanswered", None)
    refused = REFUSED if "results" not in entry else None
    names = entry.get("results") or {"": None}
    return [
        Row(entry["pair"], entry["tool"], name, entry, why or refused, setting, **others)
        for name in names
    ]


_EVO_OPTIONS = ("-r", "-d", "-u", "-t", "--n_to_align", "--t_offset", "--t_max_diff")
_EVO_FLAGS = ("-a", "-s", "-as", "--align_origin", "--all_pairs", "--pairs_from_reference")


def _evo_words(call: str) -> tuple[str, dict[str, str]]:
    """Return the program and its options of "evo_ape tum GROUNDTRUTH ESTIMATE OPTIONS"."""
    program, _, _, _, *words = call.split()
    given: dict[str, str] = {}
    rest = iter(words)
    for word in rest:
        assert word in _EVO_FLAGS + _EVO_OPTIONS, call
        given[word] = next(rest) if word in _EVO_OPTIONS else ""
    return program, given


def _evo(entry: dict[str, Any]) -> list[Row]:
    program, given = _evo_words(entry["call"])
    relative = program == "evo_rpe"
    gauge = "se3" if "-a" in given or "--align_origin" in given else "none"
    gauge = "sim3" if {"-as", "-s"} & given.keys() else gauge
    setting = Setting(
        "evo",
        gauge=gauge,
        align_states="1" if "--align_origin" in given else given.get("--n_to_align"),
        max_time_difference=_number(given.get("--t_max_diff")),
        time_offset=_number(given.get("--t_offset")),
        protocol_text=_evo_relative(given) if relative else _evo_scale(given),
    )
    return _rows(entry, setting, relative=relative)


def _evo_relative(given: dict[str, str]) -> str:
    """Return the protocol file of evo_rpe's options."""
    selection = [
        text.format(given[option]) for option, text in EVO_SELECTION.items() if option in given
    ]
    length = given["-d"] + EVO_UNITS[given["-u"]]
    return "\n".join(["base: evo", f"lengths: [{length}]", *selection, ""])


def _evo_scale(given: dict[str, str]) -> str | None:
    """Return the protocol file of evo_ape -s; None without it."""
    return "base: evo\ngauge: sim3\napply: scale\n" if "-s" in given else None


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _rpg(entry: dict[str, Any]) -> list[Row]:
    relative = "length_m" in entry
    states = entry["align_num_frames"]
    everything = relative or (states == -1 and entry["align_type"] in ("se3", "sim3"))
    setting = Setting(
        "rpg",
        gauge=RPG_GAUGES[entry["align_type"]],
        align_states=None if states == -1 else str(states),
        lengths=RPG_LENGTHS if everything else "none",
    )
    reasons = {"slip": DEFECT, "few": TOO_FEW}
    return _rows(entry, setting, relative=relative, unanswered=reasons.get(entry.get("note", "")))


_TOOLS = {"evo": _evo, "rpg": _rpg}
