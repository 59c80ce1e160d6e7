"""The words of the patch language: every key, what it holds, its unit and its meaning.

One definition serves three readers: `patchfile` validates by it, `schema` generates the JSON Schema
and the reference table from it, and messages list the valid alternatives from it.
Stage 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from hybrid.formulas import DEFAULT_FORMULA, FORMULAS


class Holds(Enum):
    """What the value of a key may be."""

    QUANTITY = "quantity"  # number, "1 ms" or arithmetic over parameters
    EITHER = "quantity or signal"
    INTEGER = "integer"
    TEXT = "text"
    CHOICE = "word"
    SIGNAL = "signal"  # the name of one signal
    TERMS = "terms"  # {signal: coefficient, ...}
    SIGNALS = "signals"  # [name, ...]
    POINTS = "points"  # {input: output, ...}
    GRID = "grid"  # {input: output, ...} or {input: {input: output, ...}, ...} and so on


class Unit(Enum):
    """Which physical dimension a quantity must have."""

    OWN = "that of full_scale"
    OWN_RATE = "that of full_scale, per time"
    PURE = "none"
    TIME = "time, such as 1 ms"
    RATE = "1/time, such as 3 1/s or 10 rad/s"
    ANY = "any"


class Bound(Enum):
    """Which values a quantity may take."""

    ANY = "any finite value"
    POSITIVE = "greater than zero"
    NOT_NEGATIVE = "zero or greater"


@dataclass(frozen=True, slots=True)
class Key:
    """One word of the language."""

    name: str
    holds: Holds
    doc: str
    unit: Unit = Unit.PURE
    bound: Bound = Bound.ANY
    required: bool = False
    default: str = ""  # in words, for the reference; '' = none
    choices: tuple[str, ...] = ()  # of a CHOICE


FULL_SCALE = Key(
    "full_scale",
    Holds.QUANTITY,
    "largest magnitude the signal may take; equals one machine unit and gives the signal its unit",
    Unit.ANY,
    Bound.POSITIVE,
    required=True,
)

UNIT = Key("unit", Holds.TEXT, "unit the signal is shown in", default="that of full_scale")

# The separate errors of a component; each defaults to the machine preset's figure.
ERROR_KEYS = (
    Key("tau", Holds.QUANTITY, "first-order lag of the output", Unit.TIME, Bound.NOT_NEGATIVE),
    Key(
        "tolerance",
        Holds.QUANTITY,
        "limit of the gain error, a fraction; the error is drawn once per machine serial number",
        Unit.PURE,
        Bound.NOT_NEGATIVE,
    ),
    Key("offset", Holds.QUANTITY, "constant error, a fraction of full scale", Unit.PURE),
    Key(
        "offset_limit",
        Holds.QUANTITY,
        "limit of a further offset, a fraction of full scale, drawn once per machine serial number",
        Unit.PURE,
        Bound.NOT_NEGATIVE,
    ),
    Key(
        "noise",
        Holds.QUANTITY,
        "rms noise, a fraction of full scale, of bandwidth 1/tau",
        Unit.PURE,
        Bound.NOT_NEGATIVE,
    ),
    Key(
        "saturation",
        Holds.QUANTITY,
        "level beyond which the output cannot go, in full scales; an integrator stops there",
        Unit.PURE,
        Bound.POSITIVE,
        default="none",
    ),
)

# Of integrators and track-stores, and of a machine for all of them.
LEAK = Key(
    "leak",
    Holds.QUANTITY,
    "rate at which the held value is lost (finite gain, capacitor loss)",
    Unit.RATE,
    Bound.NOT_NEGATIVE,
    default="0 1/s",
)
LEAK_LIMIT = Key(
    "leak_limit",
    Holds.QUANTITY,
    "of an integrator or track-store, limit of a leak beside the one given, drawn once per machine "
    "serial number",
    Unit.RATE,
    Bound.NOT_NEGATIVE,
)

ADC_KEYS = (
    Key("adc", Holds.SIGNAL, "the analog signal that is sampled and held", required=True),
    Key("bits", Holds.INTEGER, "word length, sign included, 2 to 32", default="no quantisation"),
    Key(
        "range",
        Holds.QUANTITY,
        "largest magnitude converted",
        Unit.OWN,
        Bound.POSITIVE,
        default="full scale of the signal",
    ),
    Key(
        "conversion_time",
        Holds.QUANTITY,
        "from the sample to the word",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
    Key(
        "channel",
        Holds.INTEGER,
        "multiplexer channel: channel n is sampled n times the skew after the cycle starts",
        default="0",
    ),
    Key(
        "task",
        Holds.TEXT,
        "the task whose clock samples it",
        default="of those that read it, the one of highest priority",
    ),
)

DAC_KEYS = (
    Key("dac", Holds.SIGNAL, "the program word that is converted and held", required=True),
    Key("bits", Holds.INTEGER, "word length, sign included, 2 to 32", default="no quantisation"),
    FULL_SCALE,
    UNIT,
    Key("initial", Holds.QUANTITY, "output before the first result", Unit.OWN, required=True),
    Key(
        "transfer",
        Holds.TEXT,
        "double-buffered: shows what was loaded when this task's cycle ends, with all others that do",
        default="the task that computes its word",
    ),
    Key(
        "lead",
        Holds.QUANTITY,
        "shows the word as it will be so much later, along its last change; the word itself in the "
        "first cycle",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
)

DIGITAL_KEYS = (
    Key(
        "period",
        Holds.QUANTITY,
        "the cycle time T: one cycle starts every period",
        Unit.TIME,
        Bound.POSITIVE,
        required=True,
    ),
    Key(
        "compute_time",
        Holds.QUANTITY,
        "from the last conversion of a cycle to its results at the DACs; counted: from the operations",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="one period",
    ),
    Key(
        "skew",
        Holds.QUANTITY,
        "time between neighbouring multiplexer channels (0: all sample at once)",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
    Key(
        "remember",
        Holds.TERMS,
        "first values of the words read with previous(...)",
    ),
    Key("word", Holds.TEXT, "word length: float64, float32, or a mapping", default="float64"),
    Key("words", Holds.TERMS, "word lengths of single words and states", default="that of word"),
    Key(
        "full_scales",
        Holds.TERMS,
        "word: full scale, for when the word is put on the analog machine",
        default="that of a DAC of the word",
    ),
    Key(
        "units",
        Holds.TERMS,
        "units in which words and states are shown, such as deg",
        default="that of the DAC, or SI",
    ),
    Key("program", Holds.TERMS, "assignments, word: arithmetic; needed where there are no states"),
    Key("states", Holds.TERMS, "words that the program integrates, state: {integrate: rate, ...}"),
    Key(
        "integration",
        Holds.TEXT,
        "integration formula of the states that name none",
        default=DEFAULT_FORMULA,
    ),
    Key("processor", Holds.TEXT, "operation times: a make by name, or a mapping of times"),
    Key("tasks", Holds.TERMS, "several programs on one processor, in place of period and program"),
    Key(
        "scheduling",
        Holds.CHOICE,
        "whether a task of higher priority takes the processor away from one that computes",
        default="preemptive",
        choices=("preemptive", "cooperative"),
    ),
)
COUNTED = "counted"  # in place of a compute time

PROCESSOR_KEYS = (
    Key("add", Holds.QUANTITY, "an addition", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
    Key("multiply", Holds.QUANTITY, "a product", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
    Key("divide", Holds.QUANTITY, "a quotient", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
    Key("store", Holds.QUANTITY, "storing a word", Unit.TIME, Bound.NOT_NEGATIVE, default="0 s"),
    Key(
        "square_root",
        Holds.QUANTITY,
        "a square root",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="a subroutine of three divisions and additions",
    ),
)

WORD_LENGTHS = (
    "float64, float32, {mantissa: 20, rounding: truncate}, "
    "{fixed: 24, full_scale: 100 m, rounding: nearest, overflow: saturate}"
)
# Of all words of a program or task, whatever their units.
WORD_LENGTHS_OF_ALL = WORD_LENGTHS.replace("100 m", "100")
ROUNDINGS = ("nearest", "truncate")
OVERFLOWS = ("stop", "saturate", "wrap")
WORD_KEYS = (
    Key("mantissa", Holds.INTEGER, "floating point of so many significant bits"),
    Key("fixed", Holds.INTEGER, "fixed point of so many bits, sign included"),
    Key(
        "rounding",
        Holds.TEXT,
        "nearest (ties to even) or truncate (mantissa: towards zero, fixed: towards minus infinity)",
        default=ROUNDINGS[0],
    ),
    Key(
        "full_scale",
        Holds.QUANTITY,
        "of fixed point: range of the word and of all that is computed for it",
        Unit.ANY,
        Bound.POSITIVE,
        default="1",
    ),
    Key("overflow", Holds.TEXT, "of fixed point: stop, saturate or wrap", default=OVERFLOWS[0]),
)

STATE_KEYS = (
    Key("integrate", Holds.QUANTITY, "arithmetic: its rate of change", Unit.ANY, required=True),
    Key("initial", Holds.QUANTITY, "value in the first cycle", Unit.ANY, required=True),
    Key(
        "formula",
        Holds.TEXT,
        "integration formula, whose step is the period: " + ", ".join(FORMULAS),
        default="that of integration",
    ),
    Key(
        "reset_when",
        Holds.QUANTITY,
        "arithmetic: where it is not 0, the step ends at reset_to",
        Unit.PURE,
    ),
    Key("reset_to", Holds.QUANTITY, "arithmetic; may read next(...) of other states", Unit.ANY),
)

# What each task has for itself.
ONE_PROGRAM_KEYS = ("period", "compute_time", "program", "states")

# The ways in which a comparator switches that start a task.
EDGES = ("rises", "falls", "changes")
TASK_KEYS = (
    Key(
        "period",
        Holds.QUANTITY,
        "a cycle begins every period; needed unless when says what starts one",
        Unit.TIME,
        Bound.POSITIVE,
    ),
    Key(
        "when",
        Holds.TEXT,
        "in place of period: the comparator that starts a cycle, NAME rises, NAME falls or NAME changes",
    ),
    Key(
        "phase",
        Holds.QUANTITY,
        "when the first begins",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
    Key(
        "priority",
        Holds.INTEGER,
        "the higher goes first, equal ones by name; of all tasks or none",
        default="tasks with when, then the shorter the period, the higher",
    ),
    Key(
        "compute_time",
        Holds.QUANTITY,
        "processor time of a cycle; counted: from the operations",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        required=True,
    ),
    Key(
        "overrun",
        Holds.CHOICE,
        "when a cycle is due and the one before has not ended: leave it out (skip), begin it after that "
        "one (queue), end the run (stop)",
        default="skip",
        choices=("skip", "queue", "stop"),
    ),
    Key(
        "jitter",
        Holds.QUANTITY,
        "a cycle begins late by up to this, drawn evenly for each by the run's seed in 64 steps",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
    Key("program", Holds.TERMS, "assignments, word: arithmetic; needed where there are no states"),
    Key("states", Holds.TERMS, "words that the task integrates, its period being the step"),
    Key(
        "integration",
        Holds.TEXT,
        "integration formula of its states that name none",
        default="that of digital",
    ),
    Key("word", Holds.TEXT, "word length of its words, or a mapping", default="that of digital"),
    Key("words", Holds.TERMS, "word lengths of single words and states", default="that of word"),
)

TABLE_KEYS = (
    Key("inputs", Holds.TERMS, "one to four variables, input: unit (1: none)", required=True),
    Key("unit", Holds.TEXT, "unit of the values", default="1, none"),
    Key("values", Holds.GRID, "breakpoint: value, nested one level deeper for every further input"),
    Key(
        "file",
        Holds.TEXT,
        "CSV file in place of values, relative to the patch: a line of headings with the inputs, then a "
        "row for every combination of breakpoints (of simplices: for every point)",
    ),
    Key(
        "output",
        Holds.TEXT,
        "column of the values",
        default="the only one left, or the table's name",
    ),
    Key(
        "method",
        Holds.CHOICE,
        "straight lines, monotone cubics (of Fritsch and Carlson; one variable after the other), or "
        "straight within simplices between points that lie anywhere",
        default="linear",
        choices=("linear", "cubic", "simplices"),
    ),
    Key(
        "outside",
        Holds.CHOICE,
        "beyond the first or last breakpoint, or all points: end the run, take the value there, or go "
        "on along the line, plane or tangent there; the run says how often and when first",
        default="stop",
        choices=("stop", "clamp", "extrapolate"),
    ),
)

MODEL_KEYS = (
    Key("file", Holds.TEXT, "DAVE-ML file (AIAA S-119), relative to the patch", required=True),
    Key("inputs", Holds.TERMS, "variable: arithmetic of the program", default="none"),
    Key(
        "units", Holds.TERMS, "variable: unit, in place of what the file says", default="the file's"
    ),
)

DEFAULT_ROWS = 1_000_000

MODES_KEYS = (
    Key("reset", Holds.QUANTITY, "IC lasts so long", Unit.TIME, Bound.POSITIVE),
    Key("operate", Holds.QUANTITY, "then OP so long", Unit.TIME, Bound.POSITIVE),
    Key(
        "hold",
        Holds.QUANTITY,
        "then HOLD so long, and IC again",
        Unit.TIME,
        Bound.NOT_NEGATIVE,
        default="0 s",
    ),
    Key(
        "operations",
        Holds.INTEGER,
        "how often; the machine stays in HOLD after the last",
        default="to the end of the run",
    ),
    Key("reset_when", Holds.SIGNAL, "a comparator or a DAC: IC while it is high"),
    Key("hold_when", Holds.SIGNAL, "a comparator or a DAC: HOLD while it is high"),
)

RUN_KEYS = (
    Key("until", Holds.QUANTITY, "end of the run", Unit.TIME, Bound.POSITIVE, required=True),
    Key(
        "every",
        Holds.QUANTITY,
        "time between rows of the record",
        Unit.TIME,
        Bound.POSITIVE,
        default="one period; needed where there is no digital part",
    ),
    Key(
        "max_rows",
        Holds.INTEGER,
        "most rows kept; a longer run keeps every n-th row and says so",
        default=str(DEFAULT_ROWS),
    ),
    Key(
        "on_overload",
        Holds.TEXT,
        "what the first signal beyond full scale does: continue, hold (the machine is in HOLD from then "
        "on) or stop (the run ends)",
        default="continue",
    ),
)

MACHINE_KEYS = (
    Key("preset", Holds.TEXT, "a machine by name", default="nominal"),
    Key("serial", Holds.INTEGER, "serial number: which machine of the make", default="1"),
    Key(
        "pot_resolution",
        Holds.QUANTITY,
        "step of the potentiometers' settings, which go from 0 to 1 (1e-4: dials of four digits)",
        Unit.PURE,
        Bound.NOT_NEGATIVE,
        default="0, any setting",
    ),
    *ERROR_KEYS,
    LEAK_LIMIT,
)

TIME_SCALE = Key(
    "time_scale",
    Holds.QUANTITY,
    "problem seconds in a machine second: the patch is in problem time, the machine's own times are not",
    Unit.PURE,
    Bound.POSITIVE,
    default="1",
)

MACHINES = ("analog", "digital")

# A sub-patch is a file with these keys, or a definition.
DEFINITION_KEYS = (
    Key("description", Holds.TEXT, "what it is about"),
    Key(
        "inputs",
        Holds.TERMS,
        "name: a component (an analog input) or arithmetic (a word); gives the unit, and stands in for "
        "the input where the sub-patch is run by itself",
    ),
    Key("outputs", Holds.SIGNALS, "what may be read outside", default="all its own signals"),
    Key("parameters", Holds.TERMS, "name: quantity, unless it is set where the sub-patch is used"),
    Key("tables", Holds.TERMS, "name: look-up table"),
    Key("models", Holds.TERMS, "name: DAVE-ML model"),
    Key("analog", Holds.TERMS, "signal: component"),
    Key("interface", Holds.TERMS, "signal: adc or dac"),
    Key("digital", Holds.TERMS, "words: program, states, remember, words and units"),
    Key("parts", Holds.TERMS, "name: sub-patch"),
)

PART_DIGITAL_KEYS = tuple(
    key
    for key in DIGITAL_KEYS
    if key.name in ("program", "remember", "states", "words", "full_scales", "units")
)

PART_KEYS = (
    Key("file", Holds.TEXT, "the sub-patch's file, as seen from this one; or one that ships"),
    Key("use", Holds.TEXT, "a definition of this file (or of `file`) by name"),
    Key("inputs", Holds.TERMS, "input: signal; arithmetic, where the input is a word"),
    Key("parameters", Holds.TERMS, "parameter: quantity"),
    Key(
        "task",
        Holds.TEXT,
        "which task computes its words, of a machine with tasks; with `on: digital` all of it",
    ),
    Key(
        "on",
        Holds.CHOICE,
        "the machine that all of it runs on",
        default="that of each section",
        choices=MACHINES,
    ),
)

TOP_KEYS = (
    Key("title", Holds.TEXT, "one line", required=True),
    Key("description", Holds.TEXT, "what the patch is about, where its figures come from"),
    Key("machine", Holds.TEXT, "preset name, or a mapping of the machine's keys"),
    TIME_SCALE,
    Key("parameters", Holds.TERMS, "name: quantity; may be set from the command line"),
    *(key for key in DEFINITION_KEYS if key.name in ("inputs", "outputs", "parts")),
    Key("definitions", Holds.TERMS, "name: sub-patch, for parts of this file"),
    Key("tables", Holds.TERMS, "name: look-up table, a function of the program"),
    Key(
        "models", Holds.TERMS, "name: DAVE-ML model, whose outputs the program reads as name.output"
    ),
    Key("analog", Holds.TERMS, "signal: component"),
    Key("interface", Holds.TERMS, "signal: adc or dac"),
    Key("digital", Holds.TERMS, "the digital machine"),
    Key("modes", Holds.TERMS, "when the machine is in IC, OP and HOLD", default="always OP"),
    Key("run", Holds.TERMS, "length and record of the run", required=True),
    Key("record", Holds.SIGNALS, "signals kept", default="all"),
    Key("readouts", Holds.TERMS, "name: {quantity: signal}"),
)

READOUT_KINDS = {
    "transient": "omega, omega_damped, zeta of the signal's dominant mode",
    "final": "last value",
    "maximum": "largest value and its time",
    "minimum": "smallest value and its time",
    "rms": "root of the time mean of the square (trapezoidal rule over the rows)",
    "mean": "time mean (trapezoidal rule over the rows)",
}

READOUT_KEYS = (
    Key("from", Holds.QUANTITY, "start of the part that is read", Unit.TIME, Bound.NOT_NEGATIVE),
    Key("until", Holds.QUANTITY, "end of the part that is read", Unit.TIME, Bound.POSITIVE),
)
