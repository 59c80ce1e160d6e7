"""The words of the patch language: every key, what it holds, its unit and its meaning.

One definition serves three readers: `patchfile` validates by it, `schema` generates the JSON Schema
and the reference table from it, and messages list the valid alternatives from it. What a key is stands
in `keys`, the digital machine's keys in `digital_keys`; all are had from here.
Stage 1.
"""

from __future__ import annotations

from hybrid.digital_keys import (
    COUNTED,
    DIGITAL_KEYS,
    EDGES,
    MODEL_KEYS,
    ONE_PROGRAM_KEYS,
    OVERFLOWS,
    PROCESSOR_KEYS,
    ROUNDINGS,
    STATE_KEYS,
    TABLE_KEYS,
    TASK_KEYS,
    WORD_KEYS,
    WORD_LENGTHS,
    WORD_LENGTHS_OF_ALL,
)
from hybrid.keys import Bound, Holds, Key, Unit

__all__ = [
    "ADC_KEYS",
    "COUNTED",
    "DAC_KEYS",
    "DEFAULT_ROWS",
    "DEFINITION_KEYS",
    "DIGITAL_KEYS",
    "EDGES",
    "ERROR_KEYS",
    "FULL_SCALE",
    "LEAK",
    "LEAK_LIMIT",
    "MACHINES",
    "MACHINE_KEYS",
    "MODEL_KEYS",
    "MODES_KEYS",
    "ONE_PROGRAM_KEYS",
    "OVERFLOWS",
    "PART_DIGITAL_KEYS",
    "PART_KEYS",
    "PROCESSOR_KEYS",
    "READOUT_KEYS",
    "READOUT_KINDS",
    "ROUNDINGS",
    "RUN_KEYS",
    "STATE_KEYS",
    "TABLE_KEYS",
    "TASK_KEYS",
    "TIME_SCALE",
    "TOP_KEYS",
    "UNIT",
    "WORD_KEYS",
    "WORD_LENGTHS",
    "WORD_LENGTHS_OF_ALL",
    "Bound",
    "Holds",
    "Key",
    "Unit",
]

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
