"""Word length: every operation rounds, as exact fractions and numpy's float32 say it should."""

import math
from fractions import Fraction

import numpy as np
import pytest

import hybrid
from hybrid.coupling import exact_modes, ideal_modes
from hybrid.engine.compiling import compiled, strictly
from hybrid.engine.rounding import code_of, compute, left_out, odd, rounded_float, within
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.runs import run
from hybrid.tape import Op
from hybrid.wordlength import FLOAT32, Kind, Overflow, WordLength

RANDOM = 20_000


@strictly
def multiplied_and_added(a, b, c):
    return a * b + c


@compiled
def within_another(a, b, c):
    return multiplied_and_added(a, b, c)


def test_what_is_compiled_strictly_is_so_within_other_functions():
    # (1 + e)^2 is 1 + 2 e + e^2, of which a double keeps 1 + 2 e: nothing is left but where it is fused.
    x = 1.0 + 2.0**-30
    assert within_another(x, x, -(1.0 + 2.0**-29)) == 0.0


def exact(op, a, b):
    x, y = Fraction(a), Fraction(b)
    return {Op.ADD: x + y, Op.SUB: x - y, Op.MUL: x * y, Op.DIV: x / y if y else Fraction(0)}[op]


def rounded(value, bits, cuts):
    """A Fraction to so many significant bits, by integers alone."""
    if value == 0:
        return 0.0
    exponent = 0
    size = abs(value)
    exponent = size.numerator.bit_length() - size.denominator.bit_length()
    if size < Fraction(2) ** exponent:
        exponent -= 1
    scaled = value * Fraction(2) ** (bits - 1 - exponent)
    whole = math.trunc(scaled) if cuts else round(scaled)  # Python rounds halves to even
    return float(Fraction(whole) * Fraction(2) ** (exponent - bits + 1))


@strictly
def play(op, a, b, row):
    result = compute(op, 0.0, a, b)
    error = left_out(op, a, b, result)
    return rounded_float(odd(result, error) if error != 0.0 else result, row)


@strictly
def play_each(op, a, b, row, found):
    for i in range(a.size):
        found[i] = play(op, a[i], b[i], row)


def played(op, a, b, length):
    return play(op, a, b, np.array(length.row))


def operands(bits, rng):
    """Numbers of so many bits, near each other and far apart, some of them powers of two."""
    for _ in range(RANDOM // 200):
        whole = rng.integers(2 ** (bits - 1), 2**bits, 2)
        whole[rng.random(2) < 0.2] = 2 ** (bits - 1)
        shift = rng.integers(-2, 60) if rng.random() < 0.7 else rng.integers(-2, 3)
        sign = rng.choice([-1.0, 1.0], 2)
        yield float(sign[0] * whole[0]), float(sign[1] * math.ldexp(float(whole[1]), -int(shift)))


@pytest.mark.parametrize("cuts", [False, True])
@pytest.mark.parametrize("bits", [2, 8, 20, 24, 27, 36, 48, 50])
def test_arithmetic_is_rounded_once(bits, cuts):
    rng = np.random.default_rng(bits)
    length = WordLength(Kind.BITS, bits, cuts)
    for a, b in operands(bits, rng):
        for op in (Op.ADD, Op.SUB, Op.MUL, Op.DIV):
            assert played(op, a, b, length) == rounded(exact(op, a, b), bits, cuts), (op, a, b)
        root = played(Op.SQRT, abs(a), 0.0, length)
        low, high = rounded(Fraction(root), bits, True), abs(a)
        ulp = Fraction(math.ldexp(1.0, math.frexp(root)[1] - bits))
        below, above = (0, ulp) if cuts else (ulp / 2, ulp / 2)
        assert low == root
        assert (Fraction(root) - below) ** 2 <= Fraction(high) <= (Fraction(root) + above) ** 2


def test_float32_is_numpys():
    rng = np.random.default_rng(1)
    a, b = (
        (rng.normal(size=RANDOM) * 10.0 ** rng.integers(-40, 38, RANDOM)).astype(np.float32),
        (rng.normal(size=RANDOM) * 10.0 ** rng.integers(-20, 20, RANDOM)).astype(np.float32),
    )
    with np.errstate(all="ignore"):
        expected = {Op.ADD: a + b, Op.SUB: a - b, Op.MUL: a * b, Op.DIV: a / b}
    for op, due in expected.items():
        found = np.empty(RANDOM)
        play_each(op, a.astype(float), b.astype(float), np.array(FLOAT32.row), found)
        assert found.tolist() == due.astype(float).tolist()
    constants = rng.normal(size=1000) * 10.0 ** rng.integers(-46, 39, 1000)
    with np.errstate(over="ignore"):
        assert [FLOAT32.constant(c) for c in constants.tolist()] == [
            float(np.float32(c)) for c in constants
        ]


@pytest.mark.parametrize("scale", [1.0, 0.3048, 7000.0])
@pytest.mark.parametrize("bits", [2, 16, 24, 40])
def test_codes_of_fixed_point(bits, scale):
    rng = np.random.default_rng(bits)
    most = 2 ** (bits - 1)
    step = scale / most
    for cuts in (False, True):
        length = WordLength(Kind.FIXED, bits, cuts, scale)
        row = np.array(length.row)
        codes = rng.integers(-most, most, 300)
        # Codes stay codes, their sums too; between two codes the rounding decides.
        other = rng.integers(-most, most, 300)
        for n, m in zip(codes.tolist(), other.tolist(), strict=True):
            assert code_of(n * step, row) == n
            assert code_of(n * step + m * step, row) == n + m
            part = 0.3 if bits < 40 else 0.25
            assert code_of((n + part) * step, row) == n
            assert code_of((n - part) * step, row) == (n - 1 if cuts else n)


def test_beyond_the_range():
    for overflow, due in (
        (Overflow.SATURATE, [7, 7, 7, -8, -8, -8]),
        (Overflow.WRAP, [7, -8, -6, 7, -8, 5]),
    ):
        row = np.array(WordLength(Kind.FIXED, 4, False, 1.0, overflow).row)
        assert [within(c, row) for c in (7.0, 8.0, 10.0, -9.0, -8.0, -11.0)] == due


# -- programs


def test_a_program_of_doubles_is_played_without_looking_at_word_lengths(compiled):
    text = PROGRAM.replace("WORD", "word: float64\n  words: {x: float64}")
    assert (
        compiled(text).tape.length_of.size
        == compiled(PROGRAM.replace("  WORD\n", "")).tape.length_of.size
        == 0
    )
    single = compiled(PROGRAM.replace("WORD", "words: {late: float32}")).tape
    assert len(single.length_of) == len(single.code)


PROGRAM = """
title: rounding in a program
parameters: {third: 1/3, unit: 1 m, until: 40 s}
digital:
  period: 1 s
  compute_time: 0 s
  WORD
  remember: {x: 0.1, k: -1}
  program:
    x: 3.7*previous(x)*(1 - previous(x)) + third*0.01
    k: previous(k) + 1
    late: previous(x, 3)
run: {until: until}
"""


def test_a_chaotic_program_in_float32_is_numpys_bit_for_bit(play):
    one, third = np.float32(1), np.float32(1 / 3 * 0.01)
    x, due = np.float32(0.1), []
    for _ in range(40):
        x = np.float32(3.7) * x * (one - x) + third
        due.append(float(x))
    found = play(PROGRAM.replace("WORD", "word: float32"))["x"][:40]
    assert found.tolist() == due
    # The same with 24 bits, as long as no exponent matters.
    assert play(PROGRAM.replace("WORD", "word: {mantissa: 24}"))["x"][:40].tolist() == due
    doubles = play(PROGRAM.replace("WORD", "word: float64"))["x"][:40]
    assert 1e-6 < np.max(np.abs(doubles - due)) < 1.0
    assert doubles.tolist() == play(PROGRAM.replace("  WORD\n", ""))["x"][:40].tolist()


def test_one_word_with_a_length_of_its_own(play):
    found = play(PROGRAM.replace("WORD", "words: {late: float32, k: {fixed: 16, full_scale: 100}}"))
    plain = play(PROGRAM.replace("  WORD\n", ""))
    assert found["x"].tolist() == plain["x"].tolist()
    assert found["late"].tolist() == np.float32(plain["late"]).astype(float).tolist()
    # 100/2^15 is no divisor of 1: each sum is rounded to the nearest code, and so is -1.
    step = 100 / 2**15
    k, due = round(-1 / step), []
    for _ in range(40):
        k = round(k + 1 / step)
        due.append(k * step)
    np.testing.assert_allclose(found["k"][:40], due, rtol=1e-15)


FIXED = "word: {fixed: 8, full_scale: 16, overflow: POLICY}"
COUNT = PROGRAM.replace("    x: 3.7*previous(x)*(1 - previous(x)) + third*0.01\n", "    x: 0.5\n")


def test_overflow_of_fixed_point_is_reported_and_acts_as_declared():
    """A count from 0 in steps of 1 with a range of -16 to 15.875: it leaves it at 16."""
    text = COUNT.replace("WORD", FIXED)
    results = {p: run(parse_patch(text.replace("POLICY", p))) for p in ("saturate", "wrap", "stop")}
    wrapped = [*range(16), *range(-16, 16), *range(-16, 0)]
    assert results["wrap"].record["k"].values[:40].tolist() == wrapped[:40]
    assert results["saturate"].record["k"].values[:40].tolist() == [*range(16), *[15.875] * 24]
    for result in results.values():
        (overload,) = result.overloads
        assert (overload["signal"], overload["time_s"]) == ("k", 16.0)
        assert (overload["value"], overload["full_scale"]) == (16.0, 16.0)
    assert results["wrap"].status == results["saturate"].status == "complete"
    assert results["stop"].status == "stopped"
    assert "k does not fit into its word" in results["stop"].status_note
    assert results["wrap"].overloads[0]["instants"] == 1
    # The cycle at the end of the run counts, too.
    assert results["saturate"].overloads[0]["instants"] == 25


def test_the_run_may_stop_at_the_overflow_of_a_word():
    text = COUNT.replace("WORD", FIXED.replace("POLICY", "wrap"))
    result = run(parse_patch(text.replace("until: until", "until: until, on_overload: stop")))
    assert result.status == "stopped"
    assert result.record["k"].values[-1] == 15


def test_no_number_stops_a_program_of_any_word_length():
    text = PROGRAM.replace("late: previous(x, 3)", "late: 1/(5 - previous(k))")
    for word in ("float32", "{mantissa: 8}", "{fixed: 24, full_scale: 1024, overflow: wrap}"):
        result = run(parse_patch(text.replace("WORD", f"word: {word}")))
        assert result.status == "stopped"
        assert "no finite number for late" in result.status_note


# -- integration: the paper's finding

ORBIT = """
title: From perigee at 100 nmi to apogee at the moon's distance, lengths in 1e6 ft
parameters: {step: 10 s, until: 1 s, second: 1 s, mu: 0, near: 0, speed: 0}
digital:
  period: step
  compute_time: 0 s
  integration: rk4
  WORD
  states:
    x: {integrate: u, initial: near}
    y: {integrate: v, initial: 0}
    u: {integrate: -x*pull/second, initial: 0 1/s}
    v: {integrate: -y*pull/second, initial: speed/second}
  program:
    r2: x*x + y*y
    pull: mu/(r2*sqrt(r2))/second
run: {until: until, every: until}
record: [x, y]
"""
MILLION_FEET = 0.3048e6
MU = 3.986004418e14 / MILLION_FEET**3
NEAR, FAR = 6378137.0 + 185200.0, 384.4e6
AXIS = (NEAR + FAR) / 2 / MILLION_FEET


def error_ft(play, word, step_s):
    """Position error at the last multiple of 20 s before apogee, against Kepler's equation."""
    until = 20.0 * math.floor(math.pi * math.sqrt(AXIS**3 / MU) / 20)
    mean = math.sqrt(MU / AXIS**3) * until
    e, anomaly = (FAR - NEAR) / (FAR + NEAR), mean
    for _ in range(50):
        anomaly -= (anomaly - e * math.sin(anomaly) - mean) / (1 - e * math.cos(anomaly))
    x = AXIS * (math.cos(anomaly) - e)
    y = AXIS * math.sqrt(1 - e * e) * math.sin(anomaly)
    near = NEAR / MILLION_FEET
    start = {"mu": MU, "near": near, "speed": math.sqrt(MU * (2 / near - 1 / AXIS))}
    text = ORBIT.replace("WORD", f"word: {word}")
    end = play(text, {"step": step_s, "until": until, **start})
    return 1e6 * math.hypot(end["x"][-1] - x, end["y"][-1] - y)


def test_single_and_double_precision_of_an_orbit(play):
    """The paper's Fig. 1, position error at the moon's distance: 30,000 ft with a word of 24 bits, under
    2,000 ft in double precision. An independent integration of the same orbit by RK4 in Cartesian
    coordinates found 14 and 240 ft at steps of 10 and 20 s in double, which is truncation and falls by
    16, and 40,000 to 80,000 ft in single precision, which is rounding and does not."""
    double = [error_ft(play, "float64", step) for step in (10.0, 20.0)]
    assert double == pytest.approx([14, 240], rel=0.04)
    assert double[1] / double[0] == pytest.approx(16, rel=0.1)
    single = [error_ft(play, "float32", step) for step in (10.0, 20.0)]
    assert all(3e3 < error < 3e5 for error in single)
    # Between the two, a word of 36 bits errs 2^12 times less by rounding, 20 ft or so.
    assert error_ft(play, "{mantissa: 36}", 10.0) < 2e-2 * max(single)
    # Cut in place of rounded, errors have one sign, and add up.
    assert error_ft(play, "{mantissa: 24, rounding: truncate}", 10.0) > 10 * max(single)


def test_a_fast_integration_in_single_is_kept_right_by_a_slow_one_in_double(play):
    """The paper's two simultaneous integrations: every 16 cycles the fast state takes over the slow one,
    which makes one step of 16 cycles then."""
    text = """
title: two integrations of x' = -x + 1/2
parameters: {step: 1 ms, second: 1 s}
digital:
  period: step
  compute_time: 0 s
  word: float32
  integration: rk4
  words: {slow: float64}
  remember: {count: -1}
  states:
    fast: {integrate: (0.5 - fast)/second, initial: 1, reset_when: last, reset_to: next(slow)}
    alone: {integrate: (0.5 - alone)/second, initial: 1}
    slow: {integrate: "select(last, 16*(0.5 - slow)/second, 0/second)", initial: 1}
  program:
    count: mod(previous(count) + 1, 16)
    last: count == 15
run: {until: 16 s, every: 16 ms}
"""
    played = play(text)
    rows = np.arange(1000)
    exact_ = 0.5 + 0.5 * np.exp(-16e-3 * rows)
    slow, fast, alone = (played[name][:1000] for name in ("slow", "fast", "alone"))
    # RK4 of step h = 16 ms: h^4/120 of t e^-t/2 at most.
    assert np.max(np.abs(slow - exact_)) < 0.016**4 / 120 * 0.5
    # The fast one equals it rounded where it has just been set: half a unit of the last place, 2^-25.
    assert np.max(np.abs(fast - slow)) <= 2**-25
    # By itself it drifts: each step rounds x, here by up to 2^-25, and forgets that within a second.
    drift = np.max(np.abs(alone - exact_))
    assert 2**-25 < drift < 1000 * 2**-25
    assert drift > 5 * np.max(np.abs(fast - exact_))


SPRING = """
title: a spring
parameters: {step: 1 ms, unit: 1 1/s}
digital:
  period: step
  compute_time: 0 s
  integration: rk4
  WORD
  states: {x: {integrate: v, initial: 1}, v: {integrate: -x*unit**2, initial: 0 1/s}}
run: {until: 1 s}
"""


TABLE = """
title: a table and a helper function at the stages of a formula
parameters: {step: 0.125 s, second: 1 s, metre: 1 m}
tables: {twice: {inputs: {x: 1}, values: {0: 0, 4: 8}, outside: stop}}
digital:
  period: step
  compute_time: 0 s
  integration: rk4
  WORD
  states: {x: {integrate: rate, initial: 1}}
  program:
    rate: -twice(x)/(2*second)
    rho: density_us76(x*metre*1000)
run: {until: 5 s}
"""


def test_tables_and_helpers_at_stages_and_in_single_precision(play):
    """x' = -x through a table: each step of RK4 multiplies by 1 - h + h^2/2 - h^3/6 + h^4/24."""
    double, single = (play(TABLE.replace("WORD", f"word: {w}")) for w in ("float64", "float32"))
    h = 0.125
    factor = 1 - h + h**2 / 2 - h**3 / 6 + h**4 / 24
    np.testing.assert_allclose(double["x"][:40], factor ** np.arange(40), rtol=1e-14)
    # Every stage asks the table at the same place of the program, and each helper at its own.
    assert [site.function for site in double.machine.tape.sites] == ["twice", "density_us76"]
    # Some twenty roundings a step of 2^-25 at most, each.
    np.testing.assert_allclose(single["x"][:40], double["x"][:40], rtol=40 * 20 * 2**-24)
    for name in ("x", "rho"):
        assert single[name].tolist() == np.float32(single[name]).astype(float).tolist()
        assert np.max(np.abs(single[name] - double[name])) > 0


def test_prediction_leaves_rounding_out(compiled):
    double, single = (
        compiled(SPRING.replace("WORD", w)) for w in ("word: float64", "word: float32")
    )
    a, b = (np.sort_complex(exact_modes(machine)) for machine in (double, single))
    # But constants are those that the program holds: step times weight to 2^-24.
    assert 0 < np.max(np.abs(a - b)) < 2**-22 * np.max(np.abs(a))
    np.testing.assert_array_equal(ideal_modes(double.patch, {}), ideal_modes(single.patch, {}))


# -- mistakes


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("word: float16", "word of digital is 'float16'; valid: float64, float32, {mantissa"),
        ("word: {mantissa: 51}", "it must be a whole number from 2 to 50"),
        ("word: {mantissa: 1.5}", "mantissa"),
        ("word: {fixed: 1}", "it must be a whole number from 2 to 40"),
        ("word: {bits: 3}", "unknown key 'bits' in word of digital"),
        ("word: {rounding: nearest}", "needs either mantissa or fixed"),
        ("word: {mantissa: 3, fixed: 3}", "needs either mantissa or fixed"),
        ("word: {mantissa: 3, full_scale: 2}", "unknown key 'full_scale'"),
        ("word: {mantissa: 3, rounding: up}", "rounding is 'up'; valid: nearest, truncate"),
        ("word: {fixed: 8, overflow: clip}", "overflow is 'clip'; valid: stop, saturate, wrap"),
        ("word: {fixed: 8, full_scale: 0}", "must be greater than 0"),
        ("word: float16", "{fixed: 24, full_scale: 100, rounding"),
        (
            "word: {fixed: 8, full_scale: unit}",
            "word of digital: full_scale is in m; it must be a pure number (rad, deg and % are pure): "
            "it holds for words of all units, in SI; words: takes units",
        ),
        (
            "word: {fixed: 8, full_scale: 0.05}",
            "does not fit into the word of 'k'; its full_scale is 0.05",
        ),
        ("words: {gone: float32}", "words: no word or state 'gone'"),
        ("words: [x]", "words must be a mapping"),
        ("words: {x: {fixed: 8, full_scale: 3 s}}", "it must be a pure number"),
    ],
)
def test_mistakes(word, reason, compiled):
    with pytest.raises(PatchError) as caught:
        compiled(PROGRAM.replace("WORD", word))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.place.line in (7, 8)


def test_a_fixed_point_word_without_a_full_scale_is_told_of():
    """It has 1 in SI units: rarely meant, and not wrong."""
    for word, warned in (("{fixed: 8}", True), ("{fixed: 8, full_scale: 1}", False)):
        digital = f"digital: {{period: 1 s, word: {word}, program: {{x: 0.5}}}}"
        text = f"title: a\n{digital}\nrun: {{until: 2 s}}\n"
        warnings = hybrid.check(parse_patch(text, "a.yaml"), trial=False).warnings
        told = "a.yaml:2: fixed: 8 has no full_scale, so it is 1 in SI units; give one"
        assert (told in warnings) == warned
