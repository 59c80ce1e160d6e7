"""Limits the wrong way round and remainders of 0: refused where known, named where a run meets them."""

import pytest

from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.runs import run

TEXT = """\
title: Counting
parameters: {low: 3, high: 1, none: 0}
digital:
  period: 1 s
  compute_time: 0
  remember: {k: 0}
  program:
    k: previous(k) + 1
    w: WORD
run: {until: 5 s}
"""


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (
            "limit(k, 3, 1)",
            r"limit(..., 3, 1) has no value; it needs a low that is not above its high",
        ),
        ("2*dead_zone(k, low, high)", r"dead_zone(..., 3, 1) has no value; it needs a low that"),
        ("mod(k, 0)", r"mod(..., 0) has no value; it needs a divisor other than 0"),
        ("mod(k, 2*none) + 1", r"mod(..., 0) has no value"),
        ("select(mod(k, none), 1, 2)", r"mod(..., 0) has no value"),
    ],
)
def test_what_never_has_a_value_is_refused_with_its_line(word, said):
    with pytest.raises(PatchError) as told:
        compile_patch(parse_patch(TEXT.replace("WORD", word), "a.yaml"))
    assert str(told.value).startswith("a.yaml:9: word 'w': ") and said in str(told.value)


def test_parameters_that_are_set_decide():
    patch = parse_patch(TEXT.replace("WORD", "limit(k, low, high) + mod(k, none)"))
    settings = {"low": 2.0, "high": 4.0, "none": 2.0}
    found = run(patch, settings).record["w"].values
    assert found.tolist() == [3.0, 2.0, 4.0, 4.0, 5.0, 4.0]


def test_what_a_selection_leaves_out_may_be_without_a_value():
    patch = parse_patch(TEXT.replace("WORD", '"select(none == 0, k, mod(k, none))"'))
    assert run(patch).record["w"].values[-1] == 6.0


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("limit(k, k, 3)", "limits of which the low one is above the high one"),
        ("mod(1, 4 - k)", "a division or mod by zero"),
    ],
)
def test_a_run_that_meets_one_names_it(word, said):
    """k is 4 in the cycle that begins at 3 s."""
    result = run(parse_patch(TEXT.replace("WORD", word)))
    assert result.status == "stopped" and "stopped at 3 s" in result.status_note
    assert "no finite number for w (" in result.status_note and said in result.status_note
