"""What is no number is never lost on the way: whoever compares it gets no number either."""

import pytest

import hybrid
from hybrid.patchfile import parse_patch

# n is -1, 0, 1 ...: the root has no value in the first cycle.
TEXT = """\
title: A root of less than nothing
machine: ideal
digital:
  period: 1 s
  compute_time: 0
  remember: {n: -2}
  WORD
  program:
    n: previous(n) + 1
    w: EXPR
run: {until: 3 s}
"""


@pytest.mark.parametrize("word", ["", "word: float32"])
@pytest.mark.parametrize(
    ("expr", "values"),
    [
        ("max(1, sqrt(n))", None),
        ("max(sqrt(n), 1)", None),
        ("min(1, sqrt(n))", None),
        ("min(sqrt(n), 1)", None),
        ("max(1, 2, sqrt(n), 3)", None),
        ("max(1, sqrt(abs(n)))", [1, 1, 1, 2**0.5]),
        ("min(n, 1)", [-1, 0, 1, 1]),
        ("max(1, n)", [1, 1, 1, 2]),
    ],
)
def test_the_smaller_and_the_larger_of_what_is_no_number_end_a_run(word, expr, values):
    result = hybrid.run(parse_patch(TEXT.replace("WORD", word).replace("EXPR", expr)))
    found = result.record["w"].values
    if values is None:
        assert result.status == "stopped"
        assert result.status_note.startswith("stopped at 0 s: in cycle 1")
        assert "no finite number for w" in result.status_note
    else:
        assert result.status == "complete" and found == pytest.approx(values, rel=1e-6)
