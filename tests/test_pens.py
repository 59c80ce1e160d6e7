"""hybrid run --pens: which signals the strip chart draws."""

import pytest
from test_bad_input import complaint, here  # noqa: F401

from hybrid import filing, parse_patch
from hybrid.charts import strip
from hybrid.cli import main
from hybrid.options import MOST_PENS, with_chosen

PATCH = """\
title: Pens
analog:
  x: {integrate: {y: 1}, initial: 1, full_scale: 2}
  y: {integrate: {x: -1}, initial: 0, full_scale: 2}
  z: {sum: {x: 1, y: 1}, full_scale: 4}
run: {until: 1 s, every: 10 ms}
record: [x, y]
"""


def test_the_chosen_pens_are_drawn_in_order_and_recorded(here, monkeypatch):  # noqa: F811
    (here / "pens.yaml").write_text(PATCH)
    drawn = []

    monkeypatch.setattr(filing.Filing, "written", lambda self: filing.write_files(*self.work))
    original = strip.strip_chart

    def chart(record, *given, signals):
        drawn.append((list(record.data_vars), signals))
        return original(record, *given, signals=signals)

    monkeypatch.setattr(strip, "strip_chart", chart)
    assert main(["run", "pens.yaml", "--pens", "z, x"]) == 0
    assert main(["run", "pens.yaml"]) == 0
    assert drawn == [(["x", "y", "z"], ["z", "x"]), (["x", "y"], None)]
    assert MOST_PENS == strip.MAX_LANES


def test_without_a_choice_what_says_most_is_drawn_first():
    """Of 14 signals what the readout reads, then the integrators, then the rest."""
    sums = "".join(f"  a{i}: {{sum: {{x: 1}}, full_scale: 2}}\n" for i in range(11))
    text = PATCH.replace("run:", sums + "run:").replace("record: [x, y]\n", "")
    patch = parse_patch(text + "readouts: {end: {final: z}}\n")
    others = [f"a{i}" for i in range(11)]
    assert with_chosen(patch, None) == (patch, ["z", "x", "y", *sorted(others)])
    assert with_chosen(parse_patch(PATCH), None)[1] is None


@pytest.mark.parametrize(
    ("pens", "said"),
    [
        ("x,w", "--pens: no signal 'w'; valid: x, y, z"),
        ("", "--pens has no signal; give one or more of x, y, z, with commas between"),
        ("x,", "--pens has an empty name in 'x,'; give one or more of x, y, z"),
        ("x,y, x", "--pens names 'x' twice"),
        (",".join(f"s{i}" for i in range(13)), "no signal 's0'"),
    ],
)
def test_pens_that_cannot_be(here, capsys, pens, said):  # noqa: F811
    (here / "pens.yaml").write_text(PATCH)
    assert said in complaint(capsys, here, "pens.yaml", "--pens", pens, verb="run")


def test_a_chart_has_twelve_pens(here, capsys):  # noqa: F811
    more = "".join(f"  s{i}: {{sum: {{x: 1}}, full_scale: 4}}\n" for i in range(13))
    (here / "pens.yaml").write_text(PATCH.replace("run:", f"{more}run:", 1))
    names = ",".join(f"s{i}" for i in range(13))
    said = complaint(capsys, here, "pens.yaml", "--pens", names, verb="run")
    assert said == "--pens names 13 signals; a strip chart has 12 pens"
