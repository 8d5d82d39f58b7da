#!/usr/bin/env bash
# The step of action.yml: compare, and put the Markdown in the job's summary.
set -euo pipefail

source_folder=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
output=$TRAJEVAL_OUTPUT

# A path must not be an option, or a second line of the outputs.
for path in "$TRAJEVAL_CONFIG" "$TRAJEVAL_BASELINE" "$output"; do
    if [[ $path == -* || $path == *$'\n'* ]]; then
        echo "the path ${path@Q} starts with a dash or has two lines" >&2
        exit 2
    fi
done

lines() { # lines TEXT: print its lines that are not blank
    grep -v '^[[:space:]]*$' <<<"$1" || true
}

# In a separate environment: the job's Python may have other versions of the dependencies.
version=$(cksum <<<"$source_folder $TRAJEVAL_PYTHON" | cut -d ' ' -f 1)
environment=$RUNNER_TEMP/trajeval-$version
if [ ! -x "$environment/bin/trajeval" ]; then
    "$TRAJEVAL_PYTHON" -m venv "$environment"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check \
        --constraint "$source_folder/constraints.txt" "${source_folder}[compare]"
fi

arguments=("$TRAJEVAL_CONFIG" --output "$output" --quiet)
if [ -n "$TRAJEVAL_BASELINE" ]; then
    arguments+=(--baseline "$TRAJEVAL_BASELINE" --undecided "$TRAJEVAL_UNDECIDED")
    while IFS= read -r gate; do
        arguments+=("--fail-if=$gate")
    done < <(lines "$TRAJEVAL_FAIL_IF")
fi
while IFS= read -r option; do
    arguments+=("$option")
done < <(lines "$TRAJEVAL_OPTIONS")

# Files of an earlier comparison or of the user are older than this one.
begin=$RUNNER_TEMP/trajeval-begin
touch "$begin"
status=0
"$environment/bin/trajeval" compare "${arguments[@]}" || status=$?

{
    for part in gates tables; do
        if [ -f "$output/$part.md" ] && [ "$output/$part.md" -nt "$begin" ]; then
            cat -- "$output/$part.md"
            echo
        fi
    done
    if [ "$status" -gt 1 ]; then
        echo "\`trajeval compare\` ended with status $status; see the job's log."
    fi
} | head -c 1000000 >>"$GITHUB_STEP_SUMMARY" || true # GitHub shows 1 MiB; cat gets SIGPIPE

# A comparison that failed leaves the tables of an earlier one.
if [ "$status" -le 1 ] && [ -f "$output/runs.parquet" ]; then
    printf 'report=%s\nruns=%s\n' "$output/report.html" "$output/runs.parquet" >>"$GITHUB_OUTPUT"
fi
exit "$status"
