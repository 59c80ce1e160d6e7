"""An analog component as program: the arithmetic of what it is for, without its errors.

An integrator becomes a state with the program's formula, a first-order lag too; all else a word. Gains
are exact, and so are products of diode squarers and quotients of feedback circuits.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hybrid.errors import PatchError
from hybrid.expressions import Binary, Call, LookUp, Name, Node, Number, Unary, is_constant
from hybrid.patch import Assignment, Component, State, Value, literal
from hybrid.tables import CONTINUES, Axis, Table
from hybrid.units import PURE, TIME, Dimension

# A state that counts the seconds, for sources that change with time.
CLOCK = "seconds"
# What a cycle may begin before an edge and still be at it: k T and the time that is written for the edge
# are two roundings of one number.
AT_ONCE = 1e-6  # of the period

AT_ZERO = literal(0.0)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the translation of a component needs to know of the others."""

    formula: str  # of its state
    full_scales: Mapping[str, Value]  # of analog signals, for what they switch
    dimensions: Mapping[str, Dimension]
    clock: str  # the name of the state that counts the seconds
    period: Node  # of the program or task, in seconds
    phase: Value = AT_ZERO  # when its first cycle begins


def clock_of(around: Surroundings) -> State:
    """The state that counts the seconds: phase + k T in cycle k, however many there were before.

    A formula adds T to T and its roundings add up, so its result only serves the stages of a cycle.
    """
    clock, begins = Name(around.clock), around.phase.expr
    since = clock if begins == Number(0.0) else Binary("-", clock, begins)
    next_cycle = Call("round", (Binary("+", Binary("/", since, around.period), Number(1.0)),))
    due = Binary("*", next_cycle, around.period)
    return State(
        around.clock,
        Number(1.0),
        around.phase,
        around.formula,
        dimension=TIME,
        reset_when=Number(1.0),
        reset_to=due if begins == Number(0.0) else Binary("+", due, begins),
    )


def edges_of(component: Component, around: Surroundings) -> tuple[Assignment, ...]:
    """The unseen word that is true while a source is on; none for what has no edges.

    It is compared by itself, so that it is right whatever the word length of the source is.
    """
    c = component
    if c.kind not in ("step", "pulse"):
        return ()
    begins = _value(c, "at", 0.0)
    on: Node = Binary(">=", Name(around.clock), _just_before(begins, around))
    if c.kind == "pulse":
        ends = _just_before(Binary("+", begins, _value(c, "width", 0.0)), around)
        on = Binary("and", on, Binary("<", Name(around.clock), ends))
    return (Assignment(_on(c), on, c.place, PURE, hidden=True),)


def _just_before(time: Node, around: Surroundings) -> Node:
    return Binary("-", time, Binary("*", Number(AT_ONCE), around.period))


def _on(component: Component) -> str:
    """A name that no patch can have."""
    return f"{component.name} on"


def words_of(component: Component, around: Surroundings) -> Assignment | State:
    """The word or state that computes what the component is for; it has the component's name.

    Raises PatchError where the digital machine has nothing like it.
    """
    c = component
    if c.kind in ("integrate", "lag"):
        return _state(c, around)
    if c.kind not in _WORDS:
        raise _refused(c, _REASONS.get(c.kind, "the digital machine has nothing like it"))
    return Assignment(c.name, _WORDS[c.kind](c, around), c.place, c.dimension)


def _refused(component: Component, reason: str) -> PatchError:
    return PatchError(
        f"component {component.name!r} ({component.kind}) cannot go to the digital machine: {reason}",
        component.place,
    )


_REASONS = {
    "delay": "its all-pass circuit is analog; write previous(word, n) in the program",
    "amplify": "an open amplifier solves an implicit equation; write that out",
    "backlash": "its circuit is analog; keep it on the analog machine",
    "noise_source": "the program makes no noise; keep it on the analog machine",
    "sawtooth": "keep it on the analog machine",
    "square": "keep it on the analog machine",
    "track": "it stores at any instant, a program once a cycle; write previous(word)",
}


def _times(*factors: Node) -> Node:
    """The product of what is not 1."""
    kept = [factor for factor in factors if factor != Number(1.0)]
    return functools.reduce(lambda a, b: Binary("*", a, b), kept) if kept else Number(1.0)


def _sum(component: Component) -> Node:
    terms = [_times(value.expr, Name(signal)) for signal, value in component.terms]
    return functools.reduce(lambda a, b: Binary("+", a, b), terms)


def _value(component: Component, key: str, default: float) -> Node:
    value = component.values.get(key)
    return value.expr if value else Number(default)


def _state(c: Component, around: Surroundings) -> State:
    for key in ("low", "high"):
        if key in c.values:
            raise _refused(c, f"it stops at {key}, and a state does not stop within a cycle")
    if c.is_switched:
        raise _refused(c, "it has modes of its own or follows a signal in IC")
    rate = _sum(c)
    if c.kind == "lag":
        if "initial" not in c.values:
            raise _refused(c, "it begins settled to its inputs; give it an initial value")
        rate = Binary("/", Binary("-", rate, Name(c.name)), c.values["time_constant"].expr)
    elif "leak" in c.values:
        rate = Binary("-", rate, Binary("*", c.values["leak"].expr, Name(c.name)))
    return State(c.name, rate, c.values["initial"], around.formula, c.place, c.dimension)


def _function(name: str) -> Callable[[Component, Surroundings], Node]:
    def made(c: Component, _: Surroundings) -> Node:
        return _times(_value(c, "amplitude", 1.0), Call(name, (Name(c.signals[0]),)))

    return made


def _between(name: str) -> Callable[[Component, Surroundings], Node]:
    def made(c: Component, _: Surroundings) -> Node:
        return Call(name, (Name(c.signals[0]), _value(c, "low", 0.0), _value(c, "high", 0.0)))

    return made


def _product(c: Component, _: Surroundings) -> Node:
    return _times(_value(c, "gain", 1.0), Name(c.signals[0]), Name(c.signals[1]))


def _quotient(c: Component, _: Surroundings) -> Node:
    return Binary("/", _times(_value(c, "gain", 1.0), Name(c.signals[0])), Name(c.signals[1]))


def _angle(c: Component, _: Surroundings) -> Node:
    across, ahead = c.signals
    return _times(_value(c, "gain", 1.0), Call("atan2", (Name(across), Name(ahead))))


def _root(c: Component, _: Surroundings) -> Node:
    positive = Call("max", (Name(c.signals[0]), Number(0.0)))
    return _times(_value(c, "gain", 1.0), Call("sqrt", (positive,)))


def _points(c: Component, around: Surroundings) -> Node:
    """A look-up table, whose outer lines are prolonged as those of a function generator."""
    if not all(is_constant(value.expr) for point in c.points for value in point):
        raise _refused(c, "its points depend on parameters; write them as numbers")
    numbers = sorted((x.number({}), y.number({})) for x, y in c.points)
    x, y = (np.array(column) for column in zip(*numbers, strict=True))
    (source,) = c.signals
    across = around.dimensions.get(source, PURE)
    axis = Axis(source, x, (float(x[0]), float(x[-1])), CONTINUES, CONTINUES, across)
    return LookUp(Table(c.name, (axis,), y, dimension=c.dimension), (Name(source),))


def _comparison(c: Component, _: Surroundings) -> Node:
    if "hysteresis" in c.values:
        raise _refused(c, "it has hysteresis, which remembers between cycles")
    high = Binary(">", _sum(c), _value(c, "threshold", 0.0))
    return Call("select", (high, _value(c, "high", 0.0), _value(c, "low", 0.0)))


def _switch(c: Component, around: Surroundings) -> Node:
    control = c.control or ""
    if control not in around.full_scales:
        raise _refused(c, "the mode of the analog machine controls it")
    half = Binary("*", Number(0.5), around.full_scales[control].expr)
    chosen = Binary(">", Name(control), half)
    return Call("select", (chosen, Name(c.signals[0]), Name(c.signals[1])))


def _step(c: Component, _: Surroundings) -> Node:
    return Call("select", (Name(_on(c)), _value(c, "step", 0.0), _value(c, "before", 0.0)))


def _ramp(c: Component, around: Surroundings) -> Node:
    begin, end = _value(c, "at", 0.0), _value(c, "until", math.inf)
    time: Node = Call("max", (Name(around.clock), begin))
    if "until" in c.values:
        time = Call("min", (time, end))
    risen = _times(_value(c, "ramp", 0.0), Binary("-", time, begin))
    return Binary("+", _value(c, "before", 0.0), risen)


def _pulse(c: Component, _: Surroundings) -> Node:
    if "period" in c.values:
        raise _refused(c, "it comes again and again; keep it on the analog machine")
    return Call("select", (Name(_on(c)), _value(c, "pulse", 0.0), _value(c, "before", 0.0)))


def _sine(c: Component, around: Surroundings) -> Node:
    omega = _value(c, "omega", 0.0)
    if "frequency" in c.values:
        omega = Binary("*", Number(2.0 * math.pi), c.values["frequency"].expr)
    angle = Binary("+", Binary("*", omega, Name(around.clock)), _value(c, "phase", 0.0))
    wave = _times(_value(c, "sine", 0.0), Call("sin", (angle,)))
    return Binary("+", _value(c, "bias", 0.0), wave) if "bias" in c.values else wave


_WORDS: Mapping[str, Callable[[Component, Surroundings], Node]] = {
    "constant": lambda c, _: _value(c, "constant", 0.0),
    "sum": lambda c, _: _sum(c),
    "coefficient": lambda c, _: _sum(c),
    "invert": lambda c, _: Unary("-", _sum(c)),
    "multiply": _product,
    "divide": _quotient,
    "square_root": _root,
    "sin": _function("sin"),
    "cos": _function("cos"),
    "atan2": _angle,
    "absolute": _function("abs"),
    "limit": _between("limit"),
    "dead_zone": _between("dead_zone"),
    "function": _points,
    "compare": _comparison,
    "switch": _switch,
    "step": _step,
    "ramp": _ramp,
    "pulse": _pulse,
    "sine": _sine,
}
