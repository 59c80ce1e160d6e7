"""What a prediction says of programs that have no linear form."""

import pytest

from hybrid.cli import main

PATCH = """\
title: A loop
machine: ideal
parameters: {k: -1, z: 0, q: 2}
analog: {x: {integrate: {u: 1 1/s}, initial: 0.1, full_scale: 1}}
interface:
  s: {adc: x}
  u: {dac: w, full_scale: 1, initial: 0}
digital:
  period: 10 ms
  program:
    w: -s
    p: q + k
run: {until: 1 s}
"""
CHANGE = "change the parameters or constants that make it so"


@pytest.mark.parametrize(
    ("arithmetic", "line", "says"),
    [
        ("-s/z", 11, f"word 'w' divides by 0 in every cycle; {CHANGE}"),
        ("-s/(p - 1)", 11, f"word 'w' divides by 0 in every cycle; {CHANGE}"),
        ("-s + 1/(p - 1)", 11, f"word 'w' divides by 0 in every cycle; {CHANGE}"),
        ("-s*sqrt(-p)", 11, f"word 'w' has no finite value in any cycle: sqrt(-1); {CHANGE}"),
        ("-s*log(p - 1)", 11, f"word 'w' has no finite value in any cycle: log(0); {CHANGE}"),
        ("-s*sqrt(k)", 11, "'sqrt(k)' has no finite value for operands -1; sqrt needs 0 or more"),
        ("-s/s", 11, "word 'w' is not linear in what the program reads"),
    ],
)
def test_the_reason_is_told_in_one_line(tmp_path, capsys, arithmetic, line, says):
    file = tmp_path / "a.yaml"
    file.write_text(PATCH.replace("w: -s\n", f"w: {arithmetic}\n"))
    assert main(["predict", str(file)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and f"a.yaml:{line}: " in told and says in told
    sound = PATCH.replace("w: -s\n", "w: -s/(p + 1)\n")  # what is not 0 is no mistake
    file.write_text(sound)
    assert main(["predict", str(file)]) == 0
