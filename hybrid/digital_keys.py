"""The keys of the digital machine: its clock and tasks, programs and states, word lengths, processors,
tables and models.

Stage 1, for `language`, which has those of all else beside them.
"""

from __future__ import annotations

from hybrid.formulas import DEFAULT_FORMULA, FORMULAS
from hybrid.keys import Bound, Holds, Key, Unit

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
