"""The tight tape: the same bits as the tape played as it is written, from fewer operations."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from hybrid.compiler import compile_patch
from hybrid.engine.bursts import run_bursts
from hybrid.engine.helper_functions import INSTANT, PER_SITE, compute_helper
from hybrid.engine.lookup import look_up, new_places, note_missed
from hybrid.engine.preparation import deck_of, written_deck
from hybrid.engine.rounding import compute
from hybrid.graph import grouped_order
from hybrid.numbering import Burst
from hybrid.patchfile import parse_patch, read_patch
from hybrid.tape import FIRST_WIDE, Memory, Op
from hybrid.tightening import tighten

PATCHES = Path(__file__).parent.parent / "patches"
CYCLES = 120


class Written:
    """Plays a tape of doubles operation by operation, as it is written."""

    def __init__(self, tape):
        self.tape, self.deck, self.r = tape, written_deck(tape), tape.registers.copy()
        self.places = new_places(self.deck.axes)

    def cycle(self, program, notes):
        r, k, end = self.r, *self.deck.programs["code"][program : program + 2].tolist()
        tables = (self.deck.figures, self.deck.axes, self.deck.tables, *self.places, notes)
        while k < end:
            op, target, a, b = self.tape.code[k].tolist()
            if op == Op.LOOK_UP:
                r[target] = look_up(r, a, b, *tables)
            elif op >= FIRST_WIDE:
                r[target] = compute_helper(op, r, a, b, notes)
            elif op == Op.SKIP:
                k += int(r[b]) if r[a] == 0.0 else 0
            elif op == Op.POW and r[b] == 2.0:  # a constant in all programs here
                r[target] = r[a] * r[a]
            else:
                r[target] = compute(op, r[target], r[a], r[b])
            k += 1


class Tight:
    """Plays it tight, as the kernel does."""

    def __init__(self, tape):
        self.tape, (self.deck, registers) = tape, deck_of(tape)
        self.r, self.places = registers.copy(), new_places(self.deck.axes)

    def cycle(self, program, notes):
        deck, (first, end) = self.deck, self.deck.programs["code"][program : program + 2]
        tables = (deck.figures, deck.axes, deck.tables, *self.places, notes)
        if run_bursts(deck.bursts, first, end, deck.steps, self.r, *tables):
            first, end = deck.programs["asks"][program : program + 2].tolist()
            note_missed(deck.asks, first, end, *self.places, notes)


def played(player, adcs):
    """Words after every cycle with random ADC words, and what was out of range."""
    tape, r, rng = player.tape, player.r, np.random.default_rng(1)
    notes = np.zeros((len(tape.sites) * PER_SITE + 1, 6))
    words, found = np.zeros(len(tape.words)), []
    for cycle in range(CYCLES):
        notes[-1, INSTANT] = cycle
        r[:adcs] = rng.uniform(-1.0, 1.0, adcs) * (10.0 if cycle % 7 == 0 else 1.0)
        if cycle == CYCLES - 20:
            r[:adcs] = np.nan
        for program, (start, end) in enumerate(itertools.pairwise(tape.starts.tolist())):
            for register, word in tape.shared[start[3] : end[3]]:
                r[register] = words[word]
            player.cycle(program, notes)
            own = slice(start[1], end[1])
            words[own] = r[tape.word_registers[own]]
            for row in tape.memory[start[2] : end[2]]:
                assert row[Memory.LENGTH] == 0
                r[row[Memory.KEEPS]] = r[row[Memory.SOURCE]]
        found.append(words.copy())
    return np.array(found), notes


def assert_same_bits(tape, adcs=0):
    (words, notes), (tight_words, tight_notes) = (
        played(Written(tape), adcs),
        played(Tight(tape), adcs),
    )
    np.testing.assert_array_equal(words, tight_words)
    np.testing.assert_array_equal(notes, tight_notes)
    return words, notes


EVERYTHING = """
title: a bit of everything
parameters: {unit: 1 1/s, k: 0.3, radius: 6.4e6 m, high: 1 km, rho: 1 kg/m^3, speed: 1 m/s, g: 1 m/s^2}
tables:
  line: {inputs: {x: 1}, values: {-1: 0.1, 0: 0.4, 0.5: -0.3, 1: 0.2}, outside: clamp}
  like: {inputs: {x: 1}, values: {-1: 2, 0: -0.4, 0.5: 0.3, 1: -0.2}, outside: clamp}
  free: {inputs: {x: 1}, values: {-1: 2, 0: -0.4, 0.5: 0.3, 1: -0.2}, outside: extrapolate}
  curve:
    {inputs: {x: 1}, values: {-1: 2, 0: -0.4, 0.5: 0.3, 1: -0.2}, outside: extrapolate, method: cubic}
  plane:
    inputs: {x: 1, y: 1}
    values: {-1: {0: 1, 0.5: 2}, 0: {0: 3, 0.5: -1}, 0.5: {0: 0, 0.5: 2}, 1: {0: 1, 0.5: 3}}
    outside: clamp
  sheet:
    inputs: {y: 1, x: 1}
    values: {-1: {0: 1, 0.5: 2}, 0: {0: 3, 0.5: -1}, 0.5: {0: 0, 0.5: 2}}
    outside: clamp
    method: cubic
  solid:
    inputs: {x: 1, y: 1, z: 1}
    values: {-1: {0: {0: 1, 1: 2}, 1: {0: 3, 1: 5}}, 1: {0: {0: 2, 1: 7}, 1: {0: 1, 1: -1}}}
    outside: clamp
digital:
  period: 0.1 s
  integration: FORMULA
  remember: {w: 0.2, u: 0.1}
  states:
    x: {integrate: "y*unit", initial: 1}
    y: {integrate: pull, initial: 0}
    z: {integrate: "(line(x) - z*k)*unit", initial: 0.5, formula: OTHER}
    wound: {integrate: "sin(x)*cos(x)*unit", initial: 0, reset_when: wound > 0.3, reset_to: -x/9}
  program:
    pull: -(sin(x) + k*line(y)*like(y))*unit
    u: line(x) + like(x)*free(x) - curve(x)
    twice: line(x) + like(x)*free(x) - curve(x)
    v: plane(x, z) + sheet(z, x) + plane(x, 0.25)*solid(x, y, z)
    w: select(x > y and not z > 1, previous(w)*0.9, -previous(u)) + limit(x, -k, k) - dead_zone(y, -k, k)
    same: u
    powers: x**2 + abs(y)**0.5 - 2**z + min(x, y, z) + max(x, -y) + z/(1 + x*x) - y/2
    air: density_us76(high*(1 + 100*x))/rho + sound_speed_us76(high*(1 + 100*x))/speed
    pulls: (gravity_x_j2(radius, radius*x, radius*y) - gravity_z_j2(radius, radius*x, radius*y))/g
    where: latitude_wgs84(radius, radius*x, radius*y) + longitude_wgs84(radius, radius*x, radius*y)
    height: (height_wgs84(radius, radius*x, radius*y) + height_wgs84(radius, radius*y, radius*x))/radius
    there: (x_wgs84(x, y, high) - z_wgs84(x, y, high))/radius
    late: next(x)*next(wound) - next(z)
run: {until: 10 s}
"""


@pytest.mark.parametrize(
    ("formula", "other"),
    [("euler", "rk4"), ("ab2", "ab4"), ("ab4", "rk2"), ("rk2", "rk3"), ("rk4", "rk4")],
)
def test_programs_with_a_bit_of_everything(formula, other):
    patch = parse_patch(EVERYTHING.replace("FORMULA", formula).replace("OTHER", other))
    tape = compile_patch(patch).tape
    words, notes = assert_same_bits(tape)
    assert np.all(np.isfinite(words))
    assert np.count_nonzero(notes[:-1, 0]) >= 5  # some tables and the air were asked out of range
    assert len(tighten(tape).steps) < 0.7 * len(tape.code)


SHIPPED = (
    "cannonball entry_probe orbiting_cylinder pitch_loop_lead rate_groups reentry tumbling_brick"
)


@pytest.mark.parametrize("name", SHIPPED.split())
def test_programs_that_ship(name):
    machine = compile_patch(read_patch(PATCHES / f"{name}.yaml"))
    assert_same_bits(machine.tape, len(machine.samplers))


def test_constants_of_a_sweep_are_its_own():
    patch = parse_patch(EVERYTHING.replace("FORMULA", "ab2").replace("OTHER", "rk4"))
    tapes = [compile_patch(patch, {"k": k}).tape for k in (0.31, 0.7, 0.45)]
    assert tighten(tapes[0]).steps is tighten(tapes[1]).steps  # laid out once for all
    found = [assert_same_bits(tape)[0] for tape in tapes]
    assert not np.array_equal(found[0], found[1])


# --- what is left out ------------------------------------------------------------------------------

SMALL = """
title: small
parameters: {a: 3}
tables:
  one: {inputs: {x: 1}, values: {0: 1, 1: 2, 2: 5}}
  two: {inputs: {x: 1}, values: {0: 3, 1: 2, 2: 1}}
digital:
  period: 1 s
  remember: {x: 0.1, y: 0.3}
  program:
    x: 1 - previous(y)/9
    y: PROGRAM
run: {until: 5 s}
"""


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("x + 0.2", "+ "),  # beside what x takes, a quotient and a difference
        ("x*a + x*previous(x)", "* *+"),
        ("x*a + x*a", "* +"),
        ("(x + a)*(x + a) - (x + a)", "+ * -"),
        ("-x*a", "* -"),
        ("x", "copy"),
        ("x**2 + a", "*+"),
        ("x**a", "**"),
        ("one(x) + two(x)", "find line line +"),
        ("sin(x) + a*cos(x)", "both *+"),
        ("sin(x) + a*sin(x)", "sin *+"),
        ("select(x > a, x, a)", "> select"),
    ],
)
def test_nothing_is_done_twice(text, steps):
    tape = compile_patch(parse_patch(SMALL.replace("PROGRAM", text))).tape
    tight = tighten(tape)
    assert len(tight.steps) == 2 + len(steps.split())
    assert_same_bits(tape)


def test_a_search_is_shared_only_where_nothing_differs():
    tight = {}
    for outside in ("clamp", "extrapolate"):
        text = SMALL.replace("2: 1}}", "2: 1}, outside: OUTSIDE}").replace("OUTSIDE", outside)
        text = text.replace("2: 5}}", "2: 5}, outside: clamp}")
        text = text.replace("PROGRAM", "one(x) + two(x)")
        tight[outside] = tighten(compile_patch(parse_patch(text)).tape)
    assert len(tight["clamp"].finds) == 1
    assert len(tight["extrapolate"].finds) == 2


# --- order -----------------------------------------------------------------------------------------


def test_equal_steps_come_together_as_far_as_they_can():
    # Two chains a b a and one a: the first of all three go together, then b b, then a a.
    kinds = [1, 2, 1, 1, 2, 1, 1]
    needs = [set(), {0}, {1}, set(), {3}, {4}, set()]
    assert [sorted(group) for group in grouped_order(kinds, needs)] == [[0, 3, 6], [1, 4], [2, 5]]


def test_every_order_keeps_what_steps_need():
    rng = np.random.default_rng(4)
    for _ in range(200):
        count = int(rng.integers(1, 40))
        kinds = rng.integers(0, 4, count).tolist()
        needs = [
            {int(rng.integers(0, k)) for _ in range(int(rng.integers(0, 3))) if k}
            for k in range(count)
        ]
        groups = list(grouped_order(kinds, needs))
        order = [step for group in groups for step in group]
        assert sorted(order) == list(range(count))
        place = {step: i for i, step in enumerate(order)}
        assert all(place[other] < place[step] for step in range(count) for other in needs[step])
        assert all(len({kinds[step] for step in group}) == 1 for group in groups)


def test_most_of_a_program_is_in_long_bursts():
    tight = tighten(compile_patch(read_patch(PATCHES / "tumbling_brick.yaml")).tape)
    longest = max(tight.bursts[:, 2] - tight.bursts[:, 1])
    assert tight.bursts[np.argmax(tight.bursts[:, 2] - tight.bursts[:, 1]), 0] == Burst.MULTIPLY_ADD
    assert longest > len(tight.steps) / 4
