"""Safe arithmetic: what is read, what is refused, what it is worth and in which units."""

import math
import operator
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.dimensions import dimension_of
from hybrid.expressions import (
    FUNCTIONS,
    Binary,
    Call,
    ExpressionError,
    Name,
    Number,
    Unary,
    evaluate,
    is_constant,
    names,
    previous_names,
    sub_expressions,
    to_text,
)
from hybrid.parsing import parse
from hybrid.units import PURE, TIME, Dimension

LENGTH = Dimension((("length", 1),))
SPEED = LENGTH / TIME

seeded = settings(derandomize=True, deadline=None, max_examples=200)


# Reading


@pytest.mark.parametrize(
    ("text", "tree"),
    [
        (5, Number(5.0)),
        (-2.5, Number(-2.5)),
        ("5", Number(5.0)),
        ("-5", Number(-5.0)),
        ("--5", Number(5.0)),
        ("+x", Name("x")),
        ("pi", Number(math.pi)),
        ("1 ms", Number(1e-3, TIME)),
        ("5 1/s", Number(5.0, PURE / TIME)),
        ("180 deg", Number(math.pi)),
        ("-x**2", Unary("-", Binary("**", Name("x"), Number(2.0)))),
        ("x^2^y", Binary("**", Name("x"), Binary("**", Number(2.0), Name("y")))),
        ("(-2)**x", Binary("**", Number(-2.0), Name("x"))),
        ("a - b - c", Binary("-", Binary("-", Name("a"), Name("b")), Name("c"))),
        (" a\n + b ", Binary("+", Name("a"), Name("b"))),
        ("atan2(y, x)", Call("atan2", (Name("y"), Name("x")))),
        ("a < b", Binary("<", Name("a"), Name("b"))),
        ("a+1 >= b*c", Binary(">=", parse("a + 1"), parse("b*c"))),
        ("a < b <= c", Binary("and", parse("a < b"), parse("b <= c"))),
        ("not a == b", Unary("not", parse("a == b"))),
        ("a or b and c or a", Binary("or", Binary("or", Name("a"), parse("b and c")), Name("a"))),
        ("1 and a", Binary("and", Number(1.0), Name("a"))),
        ("a > 1 and not b", Binary("and", parse("a > 1"), Unary("not", Name("b")))),
        ("lambda_1 + if_", Binary("+", Name("lambda_1"), Name("if_"))),
    ],
)
def test_reading(text, tree):
    assert parse(text) == tree


VALID = "valid are numbers"


@pytest.mark.parametrize(
    ("text", "reason", "column"),
    [
        ("", VALID, None),
        (" \n", VALID, None),
        ("x +", VALID, 3),
        ("x y", VALID, 3),
        ("x)", "unmatched", 2),
        ("sin.real", "not arithmetic", 1),
        ("1 + sin.real", "not arithmetic", 5),
        ("x[0]", "unexpected '['", 2),
        ("x = y", "write ==", 3),
        ("x <> y", "not arithmetic", 3),
        ("!x", "unexpected '!'", 1),
        ("x & y", "unexpected '&'", 3),
        ("x is y", "reserved word", 3),
        ("x < y < 2 ms", "must stand alone", 9),
        ("x and", VALID, 5),
        ("limit(x, 1)", "takes 3 arguments, not 2", 1),
        (" and ".join("x" * 150), "100 operations deep", None),
        (" < ".join("x" * 150), "100 operations deep", None),
        ("'os'", 'unexpected "\'"', 1),
        ("(x := 1)", "unexpected ':'", 4),
        ("f'{x}'", "unexpected", 2),
        ("θ + 1", "unexpected 'θ'", 1),
        ("x // y", "not arithmetic", 1),
        ("x, y", "not arithmetic", 1),
        ("abs(*x)", "not arithmetic", 5),
        ("abs()(x)", "not arithmetic", 1),
        ("...", "not arithmetic", 1),
        ("lambda", "reserved word", 1),
        ("y + (x if x else y)", "write select(condition, a, b)", 8),
        ("True", "write 1", 1),
        ("2*(3j)", "write 3*j", 4),
        ("1 + 2x", "write 2*x", 5),
        ("1 + 2 ms", "must stand alone", 5),
        ("1 + 1_000", "write", 5),
        ("1e999", "too large", 1),
        ("x + 1" + "0" * 400, "too large", 5),
        ("sine(x)", "did you mean 'sin'", 1),
        ("x^2 + y^2 + foo(2)", "unknown function 'foo'", 13),
        ("\n x + foo(2)", "unknown function", 7),
        ("sin", "write sin(...)", 1),
        ("x*previous", "write previous(...)", 3),
        ("sin(1, 2)", "takes 1 argument, not 2", 1),
        ("atan2(1)", "takes 2 arguments, not 1", 1),
        ("min(1)", "takes 2 to 8", 1),
        ("__import__(1)", "unknown function", 1),
        ("y + previous(x)", "only in a digital program", 5),
        ("3 furlongz", "furlongz", None),
        (
            "2 ms + 1",
            "'2 ms' must stand alone, as any number with a unit; in arithmetic it is a",
            None,
        ),
        ("2 rad/s -x", "declare one, as in parameters: {extra: 2 rad/s}, and write its name", None),
        ("2 rad-s", "cannot read the unit 'rad-s'", None),
        ("2 gain", "a product needs *", None),
        (".inf", "not a finite number", None),
        ("-inf", "not a finite number", None),
        ("1,5 ms", "not a comma: 1.5", 1),
        ("2*1,5", "not a comma: 1.5", 3),
        ("1 " + "m" * 300, "at most 200", None),
        ("x" * 2001, "at most 2000", None),
        ("sin(" * 101 + "x" + ")" * 101, "100 operations deep", None),
        ("+".join("x" * 200), "100 operations deep", None),
        ("-" * 1999 + "x", "100 operations deep", None),
        (True, "not a quantity", None),
        (None, "not a quantity", None),
        (math.nan, "finite", None),
        (math.inf, "finite", None),
    ],
)
def test_a_refusal_says_why_and_where(text, reason, column):
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.column == column


def test_previous_takes_one_name_and_only_where_allowed():
    assert parse("previous(x)", allow_previous=True) == Call("previous", (Name("x"),))
    assert parse("previous(x, 3)", allow_previous=True) == Call(
        "previous", (Name("x"), Number(3.0))
    )
    refused = ("previous(1)", "previous(x + y)", "previous(x, 1, 2)", "previous(pi)", "previous()")
    for text in refused:
        with pytest.raises(ExpressionError, match="takes one name"):
            parse(text, allow_previous=True)


@pytest.mark.parametrize("text", ["3 cycle", "3cycle", "-3 cycle", "3 cycle^2", "3 cycle*pi"])
def test_a_product_without_its_sign_is_not_taken_for_a_unit(text):
    known = frozenset({"cycle"})
    with pytest.raises(ExpressionError, match=r"write -?3\*cycle"):
        parse(text, names=known)


def test_a_name_like_a_unit_does_not_hide_the_unit_in_other_quantities():
    known = {"m", "cycle"}
    assert parse("9.81 m/s^2", names=known) == Number(9.81, SPEED / TIME)
    assert parse("3 meter", names=known) == Number(3.0, LENGTH)
    assert parse("3*m", names=known) == Binary("*", Number(3.0), Name("m"))


def test_names_present_and_previous():
    tree = parse("a*previous(b) + previous(a) - sin(c)", allow_previous=True)
    assert names(tree) == {"a", "c"}
    assert previous_names(tree) == {"a", "b"}
    assert names(parse("2*pi")) == previous_names(parse("2*x")) == frozenset()


def test_constants():
    assert is_constant(parse("2*pi + sqrt(2)"))
    assert not is_constant(parse("2*x"))
    assert not is_constant(parse("previous(x)", allow_previous=True))


def test_sub_expressions_come_before_their_operands():
    tree = parse("-a*b")
    assert list(sub_expressions(tree)) == [tree, parse("-a"), Name("a"), Name("b")]


# Trees written with a random choice of parentheses; the text is the input, nothing of ours made it.

JOINTS = [*"+-*/^<>", "**", "<=", ">=", "==", "!=", "and", "or"]
atoms = st.sampled_from(["a", "b", "2", "0.5", "1e-3", "pi"])
texts = st.recursive(
    atoms,
    lambda inner: st.one_of(
        inner.map(lambda x: f"-{x}"),
        inner.map(lambda x: f"({x})"),
        st.tuples(inner, st.sampled_from(JOINTS), inner).map(" ".join),
        inner.map(lambda x: f"(not {x})"),
        inner.map(lambda x: f"sin({x})"),
        st.tuples(inner, inner).map(lambda two: f"max({two[0]}, {two[1]})"),
    ),
    max_leaves=12,
)


@seeded
@given(texts)
def test_text_and_tree_round_trip(text):
    tree = parse(text)
    assert parse(to_text(tree)) == tree


@pytest.mark.parametrize(
    "text", ["1 ms", "-0.1 deg", "5 1/s", "3 V", "2 V/Hz^0.5", "0 s", "-7e-30"]
)
def test_numbers_round_trip_with_their_units(text):
    assert parse(to_text(parse(text))) == parse(text)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("-omega_p ** 2 * theta", "-omega_p**2*theta"),
        ("(a + b)*(c - (d - e))", "(a + b)*(c - (d - e))"),
        ("a/(b/c)", "a/(b/c)"),
        ("(a/b)/c", "a/b/c"),
        ("(a**b)**c", "(a**b)**c"),
        ("a**(b**c)", "a**b**c"),
        ("2^(-x)", "2**-x"),
        ("(a < b) < c", "(a < b) < c"),
        ("a < (b < c)", "a < (b < c)"),
        ("(a and b) and (c or a)", "a and b and (c or a)"),
        ("a and (b and c)", "a and (b and c)"),
        ("not (not a)", "not not a"),
        ("-(not a)*b", "-(not a)*b"),
        ("not (a or b)", "not (a or b)"),
        ("-(a*b)", "-(a*b)"),
    ],
)
def test_text_has_the_parentheses_it_needs_and_no_more(text, shown):
    assert to_text(parse(text)) == shown


snippets = "x 1 1e3 + - * ** ( ) , sin( previous( ms if . _ j".split()  # noqa: SIM905
hostile = (
    st.text(max_size=40)
    | st.text("01.eE+-*/^(), xyms%", max_size=40)
    | st.lists(st.sampled_from(snippets)).map(" ".join)
)


@seeded
@given(hostile, st.booleans())
def test_arbitrary_text_is_read_or_refused_without_a_warning(text, allow_previous):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            tree = parse(text, names={"x", "m"}, allow_previous=allow_previous)
        except ExpressionError as error:
            assert error.column is None or 1 <= error.column <= len(text)
            return
    assert parse(to_text(tree), allow_previous=allow_previous) == tree


# Evaluation


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 + 3*4 - 1", 13.0),
        ("-2**2", -4.0),
        ("2**3**2", 512.0),
        ("7/2/2", 1.75),
        ("2**-1", 0.5),
        ("sign(-3) + sign(0) + 2*sign(9)", 1.0),
        ("min(3, 1, 2) + max(3, 1)", 4.0),
        ("abs(-2) + sqrt(9)", 5.0),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("log(exp(1))", 1.0),
        ("250 us", 2.5e-4),
        ("x - y", -1.0),
        ("1 < 2 and not 3 <= 2", 1.0),
        ("(1 > 2) + (2 >= 2) + (1 != 1) + (0 == -0)", 2.0),
        ("2 or 1/0", 1.0),
        ("0 and 1/0", 0.0),
        ("3 > 2 > 1", 1.0),
        ("(3 > 2) == 1", 1.0),
        ("select(x > y, 1/0, 5)", 5.0),
        ("limit(7, -1, 2) + limit(-7, -1, 2) + limit(0.5, -1, 2)", 1.5),
        ("dead_zone(7, -1, 2) + dead_zone(-7, -1, 2) + dead_zone(0.5, -1, 2)", -1.0),
        ("floor(-1.5) + 10*ceil(-1.5)", -12.0),
        ("round(0.5) + round(1.5) + round(-2.5)", 0.0),
        ("mod(-1, 3) + mod(1, -3)/4", 1.5),
        ("hypot(3, 4) + log10(1000)", 8.0),
    ],
)
def test_values_by_hand(text, value):
    assert evaluate(parse(text), {"x": 1, "y": 2.0}) == value


SCOPE = {"a": 1.25, "b": -0.75}
ARITHMETIC = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": operator.pow,
}


def _or_none(compute, *operands):
    """What Python makes of it; None where that is no finite real number."""
    if None in operands:
        return None
    try:
        value = compute(*operands)
    except (ArithmeticError, ValueError):
        return None
    return value if isinstance(value, float) and math.isfinite(value) else None


def _join(left, op, right):
    return f"({left[0]}) {op} ({right[0]})", _or_none(ARITHMETIC[op], left[1], right[1])


def _apply(name, argument):
    compute = getattr(math, name)
    return f"{name}({argument[0]})", _or_none(compute, argument[1])


worked_out = st.recursive(
    st.sampled_from(sorted(SCOPE.items())) | st.floats(0, 1e6).map(lambda x: (repr(x), x)),
    lambda inner: st.one_of(
        st.builds(_join, inner, st.sampled_from(sorted(ARITHMETIC)), inner),
        st.builds(_apply, st.sampled_from(["sin", "exp", "log", "sqrt", "asin", "atan"]), inner),
        inner.map(lambda x: (f"-({x[0]})", _or_none(operator.neg, x[1]))),
    ),
    max_leaves=10,
)


@seeded
@given(worked_out)
def test_values_agree_with_pythons_own_arithmetic(case):
    text, expected = case
    if expected is None:
        with pytest.raises(ExpressionError, match="no finite value"):
            evaluate(parse(text), SCOPE)
    else:
        assert evaluate(parse(text), SCOPE) == expected


@seeded
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["a", "0.5", "-a", "-1.5"]),
            st.sampled_from([" + ", " - ", "*", "/", "**"]),
        ),
        max_size=6,
    )
)
def test_precedence_is_pythons(terms):
    text = "".join(term + op for term, op in terms) + "1.25"
    with_power = text.replace("**", "^")
    expected = _or_none(eval, text, {"a": 1.1})
    if expected is None:
        return
    assert evaluate(parse(text), {"a": 1.1}) == evaluate(parse(with_power), {"a": 1.1}) == expected


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        (
            "1 + y/(x - x)",
            "'y/(x - x)' has no finite value for operands 2, 0; / needs a divisor other",
        ),
        ("2*sqrt(-y)", "'sqrt(-y)' has no finite value for operands -2; sqrt needs 0 or more"),
        ("log(x - x)", "'log(x - x)' has no finite value for operands 0; log needs more than 0"),
        (
            "exp(1000*x)",
            "'exp(1000*x)' has no finite value for operands 1000; numbers end at 1.8e308",
        ),
        ("1/(1e200*1e200)", "'1e+200*1e+200' has no finite value"),
        ("(-8)**(1/3)", "'(-8)**(1/3)' has no finite value"),
        ("10**10**10", "'10**10**10' has no finite value"),
        ("0**-1", "'0**-1' has no finite value"),
        ("limit(x, 2, 1)", "'limit(x, 2, 1)' has no finite value for operands 1, 2, 1"),
        ("dead_zone(x, 2, 1)", "has no finite value"),
        ("mod(x, 0)", "'mod(x, 0)' has no finite value"),
        ("select(1, 1/0, x)", "'1/0' has no finite value"),
        ("x and 1/0", "'1/0' has no finite value"),
        ("xx", "unknown name 'xx'; did you mean 'x'"),
        ("bad", "'bad' has no finite value"),
    ],
)
def test_what_has_no_value_names_the_culprit(text, culprit):
    with pytest.raises(ExpressionError) as caught:
        evaluate(parse(text), {"x": 1.0, "y": 2.0, "bad": math.inf})
    assert culprit in str(caught.value)


def test_previous_has_no_value_outside_a_program():
    with pytest.raises(ExpressionError, match="while a program runs"):
        evaluate(parse("1 + previous(x)", allow_previous=True), {"x": 1.0})


# Dimensions

UNITS = {"x": LENGTH, "v": SPEED, "t": TIME, "p": PURE, "u": None}


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("x + v*t", LENGTH),
        ("x - v*t", LENGTH),
        ("-x/t", SPEED),
        ("x + u", LENGTH),
        ("u - x", LENGTH),
        ("u*x", None),
        ("x/u", None),
        ("u**2", None),
        ("x + 0", LENGTH),
        ("min(0, x, 0)", LENGTH),
        ("atan2(0, x)", PURE),
        ("0", None),
        ("0 s", TIME),
        ("2", PURE),
        ("1 ms", TIME),
        ("x**2", LENGTH**2),
        ("x**(1/3)", LENGTH ** (1 / 3)),
        ("x**-1", PURE / LENGTH),
        ("p**p", PURE),
        ("sqrt(v*x*t)", LENGTH),
        ("sqrt(x)**2", LENGTH),
        ("max(x, v*t)", LENGTH),
        ("abs(v)", SPEED),
        ("sign(v)", PURE),
        ("sin(x/v/t)", PURE),
        ("exp(u)", PURE),
        ("atan2(x, v*t)", PURE),
        ("previous(x) - x", LENGTH),
        ("previous(x, p) - x", LENGTH),
        ("(x < v*t)*v", SPEED),
        ("x > 0 and not p or u", PURE),
        ("select(x > 0, x, v*t)", LENGTH),
        ("select(u, 0, v)", SPEED),
        ("limit(v, 0, x/t)", SPEED),
        ("mod(x, v*t) + hypot(x, x)", LENGTH),
    ],
)
def test_dimensions(text, dimension):
    assert dimension_of(parse(text, allow_previous=True), UNITS) == dimension


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("p*(x + v)", "in 'x + v': 'x' [m] and 'v' [m/s] must have the same units"),
        ("x + 1", "'x' [m] and '1' [1] must have the same units"),
        ("u + x - t", "'u + x' [m] and 't' [s] must have the same units"),
        ("min(u, x, t)", "'x' [m] and 't' [s] must have the same units"),
        ("atan2(x, v)", "'x' [m] and 'v' [m/s] must have the same units"),
        ("sin(x)", "'x' [m] must be a pure number"),
        ("log(x/v)", "'x/v' [s] must be a pure number"),
        ("p**x", "'x' [m] must be a pure number"),
        ("u**x", "'x' [m] must be a pure number"),
        ("x**p", "its exponent must be a plain number"),
        ("x**u", "its exponent must be a plain number"),
        ("previous(x) - v", "must have the same units"),
        ("previous(x, t)", "'t' [s] must be a pure number"),
        ("x < v", "in 'x < v': 'x' [m] and 'v' [m/s] must have the same units"),
        ("p and x", "'x' [m] must be a pure number"),
        ("not x", "'x' [m] must be a pure number"),
        ("select(x, p, p)", "'x' [m] must be a pure number"),
        ("select(p, x, v)", "'x' [m] and 'v' [m/s] must have the same units"),
        ("floor(x)", "'x' [m] must be a pure number"),
        ("z", "unknown name 'z'; valid: p, t, u, v, x"),
    ],
)
def test_conflicting_dimensions_name_both_sides(text, reason):
    with pytest.raises(ExpressionError) as caught:
        dimension_of(parse(text, allow_previous=True), UNITS)
    assert reason in str(caught.value)


@seeded
@given(texts)
def test_unknown_dimensions_never_conflict(text):
    # Literals apart from 0 are pure, so only names are unknown here.
    unknown = {"a": None, "b": None}
    assert dimension_of(parse(text), unknown) in (None, PURE)


def test_scaling_the_units_scales_the_value():
    # x^a v^b t^c has dimension m^(a+b) s^(c-b): in kilometres and hours its value must change by
    # 1000^-(a+b) 3600^-(c-b). Dimension and value are computed by different code.
    tree = parse("x**2*sqrt(v)/t**3")
    dimension = dict(dimension_of(tree, UNITS).exponents)
    si = {"x": 2.0, "v": 3.0, "t": 5.0}
    scaled = {"x": 2.0 / 1000, "v": 3.0 * 3600 / 1000, "t": 5.0 / 3600}
    expected = evaluate(tree, si) / (1000 ** dimension["length"] * 3600 ** dimension["time"])
    # A dozen roundings at most.
    assert evaluate(tree, scaled) == pytest.approx(expected, rel=12 * 2**-53, abs=0)


def test_every_function_is_read_and_has_a_dimension():
    for name, function in FUNCTIONS.items():
        for count in {function.fewest, function.most}:
            tree = parse(f"{name}({', '.join(['p'] * count)})")
            scope = UNITS if function.helper is None else {"p": None}
            due = PURE if function.helper is None else function.helper.gives
            assert dimension_of(tree, scope) == due
            assert math.isfinite(evaluate(tree, {"p": 2.0 if name == "acosh" else 0.5}))


@pytest.mark.parametrize("text", ["10 rad//s", "10 foo/s", "20 degC", "3 dB"])
def test_no_product_is_meant_where_a_unit_is_wrong(text):
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert "product" not in str(caught.value)


def test_names_like_nan_and_commas_in_functions_are_read():
    assert evaluate(parse("inf", {"inf"}), {"inf": 3.0}) == 3.0
    assert evaluate(parse("max(1,5)"), {}) == 5.0
    assert evaluate(parse("2 + max(1,5)"), {}) == 7.0
