"""The campaign of changed inputs, in small: `make fuzz` runs all of it."""

from __future__ import annotations

import pytest

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from fuzz_changes import Changed
from fuzz_formats import FORMATS
from fuzz_structures import one_input, verdict_on
from strategies import make_groundtruth


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.filterwarnings("ignore")
def test_changed_inputs_are_read_or_refused_in_a_sentence(name: str) -> None:
    taken: set[str] = set()
    for number in range(400):
        taken.add(one_input(name, 7, number)[0])
        if number >= 40 and len(taken) > 1:
            break
    assert "refused" in taken
    assert len(taken) > 1


def test_poses_that_are_lost_without_a_word_are_found() -> None:
    read = make_groundtruth(3)
    verdict_on(Changed("nothing", lambda strict: read, len(read)), strict=False)
    with pytest.raises(AssertionError, match="1 poses were lost without a word"):
        verdict_on(Changed("one too few", lambda strict: read, len(read) + 1), strict=False)
