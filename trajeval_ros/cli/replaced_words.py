"""Verbs and options of version 0.3, of evo and of other verbs, with what replaces them here."""

from __future__ import annotations

from typing import Final

# By the end of the error message: verbs, options, and options of a verb.
_WORDS = {
    # Version 0.3.
    "use trajeval evaluate GROUNDTRUTH ESTIMATE --diagnosis": ("diagnose",),
    "Rerun's viewer has a map: trajeval view FILE.rrd": (
        "trajectory --map", "trajectory --map-bounds", "trajectory --ros_map_yaml",
    ),
    # evo; docs/coming_from.md has a table.
    "formats are detected by content: trajeval evaluate GROUNDTRUTH ESTIMATE, or trajeval "
    "trajectory FILE": ("tum", "kitti", "euroc", "bag", "bag2"),
    "use trajeval evaluate, with --protocol evo for evo's numbers": (
        "ape", "rpe", "evo_ape", "evo_rpe",
    ),
    "use trajeval trajectory": ("traj", "evo_traj"),
    "use trajeval compare RESULT...": ("res", "evo_res"),
    "give a style sheet of matplotlib: --style FILE.mplstyle": ("config",),
    "figures are not saved for later changes; draw them again": ("fig",),
    "use --gauge se3, or --gauge sim3 for -as, and --protocol evo for evo's numbers": (
        "-a", "--align",
    ),
    "use --gauge sim3 for evo's -as; for -s alone, give a file with base: evo, gauge: sim3 and "
    "apply: scale as --protocol FILE.yaml": ("-s", "--correct_scale"),
    "all details are printed; remove it": ("-v", "--verbose"),
    "use --align-states 1": ("--align_origin",),
    "use --align-states": ("--n_to_align",),
    "use --lengths, as in 8, 10f or 5deg, and --protocol evo for evo's numbers": (
        "-d", "--delta", "-u", "--delta_unit",
    ),
    "write base: evo and sub_trajectories: all to a YAML file, and give the file as --protocol "
    "FILE.yaml": ("--all_pairs",),
    "use trajeval info FILE": ("trajectory --full_check",),
    "--plot xy draws the path": ("trajectory -p",),
    "--output DIR draws figures into a folder": (
        "-p", "--save_plot", "evaluate --plot", "evaluate --plot_mode",
    ),
    "use --output DIR": ("--save_results",),
    "trajeval compare RESULT... --output DIR writes the tables": ("--save_table",),
    "use --plot xy, xz, yz or 3d": ("trajectory --plot_mode",),
    "evaluate prints errors of positions and rotations": ("-r", "--pose_relation"),
    "use --max-time-difference": ("--t_max_diff",),
    "use --time-offset": ("--t_offset",),
    "use --reference": ("trajectory --ref",),
    "give the groundtruth first, or as -g": ("evaluate --ref",),
    "use --synchronise": ("trajectory --sync",),
    "use --save-as tum": ("trajectory --save_as_tum",),
    "use --save-as kitti": ("trajectory --save_as_kitti",),
    # Options of another verb, and of other programs.
    "use trajeval evaluate --require for a run, or --baseline and --fail-if": (
        "compare --require",
    ),
    "use trajeval compare --common-time-span": ("evaluate --common-time-span",),
    "the alignment is that of the live run; for another one, use trajeval evaluate with a bag": (
        "finish --modality", "finish --gauge",
    ),
    'add to ~/.bashrc: eval "$(_TRAJEVAL_COMPLETE=bash_source trajeval)"': (
        "--install-completion",
    ),
    "run _TRAJEVAL_COMPLETE=bash_source trajeval": ("--show-completion",),
}  # fmt: skip
REPLACED: Final[dict[str, str]] = {
    word: answer for answer, words in _WORDS.items() for word in words
}
