"""The patch language for editors and readers: JSON Schema and a reference table.

Stage 3. Both are generated from the definitions that the reader of patch files checks by.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hybrid import language
from hybrid.components import CATALOG, Kind
from hybrid.expressions import RESERVED_NAMES
from hybrid.fields import NAME, RANGES, SIGNAL_NAME, TIME_AXIS
from hybrid.formulas import FORMULAS
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.machines import PRESETS
from hybrid.modes import ON_OVERLOAD, RESERVED_SIGNALS
from hybrid.processors import PROCESSORS

# The least patch that has everything; the examples of single keys fit it.
EXAMPLE: Mapping[str, Any] = {
    "title": "Pitch loop",
    "parameters": {"omega_p": "10 rad/s", "cycle": "1 ms"},
    "analog": {
        "theta_dot": {
            "integrate": {"moment": 1},
            "initial": "0 rad/s",
            "full_scale": "2 rad/s",
        },
        "theta": {"integrate": {"theta_dot": 1}, "initial": "0.1 rad", "full_scale": "1 rad"},
    },
    "interface": {
        "theta_sample": {"adc": "theta", "bits": 14},
        "moment": {"dac": "moment_word", "initial": 0, "full_scale": "200 rad/s^2"},
    },
    "digital": {"period": "cycle", "program": {"moment_word": "-omega_p**2 * theta_sample"}},
    "run": {"until": "10 s"},
    "record": ["theta", "moment"],
    "readouts": {"pitch_mode": {"transient": "theta"}},
}

_QUANTITY_EXAMPLES = {
    Unit.OWN: ["0.1 rad", 0.1],
    Unit.OWN_RATE: ["0.1 rad/s", 0.1],
    Unit.PURE: [0.0001, "0.01 %"],
    Unit.TIME: ["1 ms", "2*cycle"],
    Unit.RATE: ["10 rad/s", "omega_p"],
    Unit.ANY: ["1 rad", 1],
}
_INTEGER_EXAMPLES = {
    "bits": 14,
    "channel": 1,
    "serial": 1,
    "max_rows": 100000,
    "order": 4,
    "quarter_square": 23,
    "operations": 10,
    "mantissa": 20,
    "fixed": 24,
    "priority": 2,
}
_TEXT_EXAMPLES = {
    "title": EXAMPLE["title"],
    "description": "Where its figures come from",
    "unit": "mrad",
    "dac": "moment_word",
    "control": "moment",
    "reset_when": "moment",
    "hold_when": "moment",
    "output": "cd",
    "file": "drag.csv",
    "use": "euler",
    "task": "fast",
    "transfer": "slow",
    "when": "beyond rises",
}
_TERMS_EXAMPLES: Mapping[str, Any] = {
    "program": EXAMPLE["digital"]["program"],
    "remember": {"moment_word": 0},
    "full_scales": {"moment_word": "200 rad/s^2"},
    "units": {"bodyMomentOfInertia_Roll": "kg*m^2"},
    "states": {"angle": {"integrate": "theta_sample", "initial": "0 rad*s"}},
    "inputs": {"mach": 1, "height": "ft"},
    "parameters": {"inertia": "3 kg*m^2"},
    "tasks": {
        "fast": {
            "period": "1 ms",
            "compute_time": "0.2 ms",
            "program": EXAMPLE["digital"]["program"],
        },
        "slow": {"period": "10 ms", "compute_time": "3 ms", "program": {"seen": "theta_sample"}},
    },
}


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a patch file as YAML reads it."""
    top = _object(language.TOP_KEYS)
    readouts = [
        (Key(kind, Holds.SIGNAL, doc, required=True), *language.READOUT_KEYS)
        for kind, doc in language.READOUT_KINDS.items()
    ]
    machine = {"anyOf": [_preset(), _object(language.MACHINE_KEYS)]}
    readout = {"not": {"enum": sorted(RESERVED_NAMES | {TIME_AXIS})}}
    contents = {
        "machine": machine,
        **_sections(),
        "digital": _machine(),
        "modes": _modes(),
        "run": _object(language.RUN_KEYS),
        "readouts": _map({"oneOf": [_object(keys) for keys in readouts]}, readout),
        "definitions": _map(_definition(), {}),
    }
    _put(contents, top)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Hybrid patch",
        **top,
        "dependentRequired": {"interface": ["digital"]},
        # Without a digital machine the record needs an interval; the program may be in parts alone.
        "allOf": [
            {
                "if": {"not": {"required": ["digital"]}},
                "then": {"properties": {"run": {"required": ["every"]}}},
            },
            {
                "if": {"not": {"required": ["parts"]}},
                "then": {
                    "anyOf": [{"required": ["analog"]}, {"required": ["digital"]}],
                    "properties": {
                        "digital": {
                            "anyOf": [*_computes(), {"required": ["tasks"]}],
                            "properties": {
                                "tasks": {"additionalProperties": {"anyOf": _computes()}}
                            },
                        }
                    },
                },
            },
        ],
        "examples": [EXAMPLE],
    }


def _computes() -> list[dict[str, Any]]:
    """What a program cannot be without."""
    return [{"required": [key]} for key in ("program", "states")]


def _put(contents: Mapping[str, Any], made: dict[str, Any]) -> None:
    """Say more of some properties; their descriptions stay."""
    for name, content in contents.items():
        described = made["properties"][name]["description"]
        made["properties"][name] = {**content, "description": described}


def _sections() -> dict[str, Any]:
    """What a patch and a sub-patch have alike."""
    signal = _signal_names()
    function = {"not": {"enum": sorted(RESERVED_NAMES)}}
    component = {"oneOf": [_component(kind) for kind in CATALOG.values()]}
    dac = (*language.DAC_KEYS, *language.ERROR_KEYS)
    return {
        "inputs": _map({"oneOf": [_quantity(), *component["oneOf"]]}, signal),
        "parameters": _map(_quantity(), function),
        "tables": _map(_table(), function),
        "models": _map(_object(language.MODEL_KEYS), function),
        "analog": _map(component, signal),
        "interface": _map({"oneOf": [_object(language.ADC_KEYS), _object(dac)]}, signal),
        "parts": _map(_part(), signal),
    }


def _part() -> dict[str, Any]:
    """Where a sub-patch is used."""
    made = _object(language.PART_KEYS)
    made["properties"]["file"]["examples"] = ["parts/euler.yaml"]
    made["properties"]["inputs"]["examples"] = [{"moment": "torque"}]
    return {**made, "minProperties": 1}


def _definition() -> dict[str, Any]:
    """A sub-patch within a file."""
    made = _object(language.DEFINITION_KEYS)
    _put({**_sections(), "digital": _digital(language.PART_DIGITAL_KEYS)}, made)
    return made


def _component(kind: Kind) -> dict[str, Any]:
    keys = (kind.main, *kind.keys, language.FULL_SCALE, language.UNIT, *language.ERROR_KEYS)
    made = _object(keys)
    if kind.single_input:
        made["properties"][kind.main.name]["maxProperties"] = 1
    if kind.main.holds is Holds.SIGNALS:
        count = {"minItems": kind.inputs, "maxItems": kind.inputs}
        names = ["theta", "theta"][: kind.inputs]  # units fit
        made["properties"][kind.main.name].update({**count, "examples": [names]})
    return {"title": kind.key, "description": kind.doc, **made}


def _table() -> dict[str, Any]:
    """Values in the patch or in a file."""
    either = [{"required": [key]} for key in ("values", "file")]
    return {**_object(language.TABLE_KEYS), "oneOf": either}


def _machine() -> dict[str, Any]:
    """The digital machine: one program with its clock, or tasks that each have both."""
    made = _digital(language.DIGITAL_KEYS)
    doc = made["properties"]["processor"]["description"]
    makes = {"enum": list(PROCESSORS)}
    examples = [next(iter(PROCESSORS)), {"add": "4 us", "multiply": "20 us", "divide": "30 us"}]
    own = _object(language.PROCESSOR_KEYS)
    made["properties"]["processor"] = {
        "anyOf": [makes, own],
        "description": doc,
        "examples": examples,
    }
    task = {
        **_digital(language.TASK_KEYS),
        "oneOf": [
            {"required": ["period"], "properties": {"when": False}},
            {
                "required": ["when"],
                "properties": dict.fromkeys(("period", "phase", "jitter"), False),
            },
        ],
    }
    made["properties"]["tasks"] |= _map(task, {}) | {"minProperties": 1}
    one = [key.name for key in language.DIGITAL_KEYS if key.required]
    of_one = language.ONE_PROGRAM_KEYS
    return {
        **made,
        "required": [],
        "oneOf": [
            {"required": one, "properties": {"tasks": False, "scheduling": False}},
            {"required": ["tasks"], "properties": dict.fromkeys(of_one, False)},
        ],
    }


def _signal_names() -> dict[str, Any]:
    """Names that a signal or a word must not have."""
    return {"not": {"enum": sorted(RESERVED_NAMES | {TIME_AXIS} | RESERVED_SIGNALS)}}


def _digital(keys: Iterable[Key]) -> dict[str, Any]:
    """The digital machine, or what a sub-patch has of it: its states have keys of their own."""
    made = _object(keys)
    length = {"anyOf": [{"enum": ["float64", "float32"]}, _word_length()]}
    words = {**_map(length, {}), "examples": [{"moment_word": "float32"}]}
    unit = {"type": "string", "minLength": 1}
    units = {**_map(unit, {}), "examples": [{"moment_word": "deg/s^2"}]}
    contents = {"word": {**length, "examples": ["float32"]}, "words": words, "units": units}
    _put({name: contents[name] for name in contents if name in made["properties"]}, made)
    made["properties"]["program"]["minProperties"] = 1
    states = made["properties"]["states"]
    states.update({**_map(_object(language.STATE_KEYS), _signal_names()), "minProperties": 1})
    state = states["additionalProperties"]
    state["dependentRequired"] = {"reset_when": ["reset_to"], "reset_to": ["reset_when"]}
    return made


def _word_length() -> dict[str, Any]:
    """Floating point of so many bits, or fixed point, which has a scale and overflows."""
    made = _object(language.WORD_KEYS)
    floating = {"required": ["mantissa"], "properties": {"full_scale": False, "overflow": False}}
    return {**made, "oneOf": [floating, {"required": ["fixed"]}]}


def _modes() -> dict[str, Any]:
    """Times of the modes need each other; a signal may do instead."""
    return {
        **_object(language.MODES_KEYS),
        "minProperties": 1,
        "dependentRequired": {
            "operate": ["reset"],
            "reset": ["operate"],
            "hold": ["operate"],
            "operations": ["operate"],
        },
    }


def _object(keys: Iterable[Key]) -> dict[str, Any]:
    keys = tuple(keys)
    return {
        "type": "object",
        "properties": {key.name: {**_holds(key), "description": key.doc} for key in keys},
        "required": [key.name for key in keys if key.required],
        "additionalProperties": False,
    }


def _map(values: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "propertyNames": {"pattern": NAME, **names},
        "additionalProperties": values,
    }


def _quantity() -> dict[str, Any]:
    return {"type": ["number", "string"], "minLength": 1}


def _preset() -> dict[str, Any]:
    return {"enum": sorted(PRESETS)}


def _holds(key: Key) -> dict[str, Any]:
    if key.name == "preset":
        return _preset()
    if key.name == "on_overload":
        return {"enum": list(ON_OVERLOAD), "examples": ["stop"]}
    if key in language.WORD_KEYS and key.holds is Holds.TEXT:
        valid = language.ROUNDINGS if key.name == "rounding" else language.OVERFLOWS
        return {"enum": list(valid), "examples": [valid[-1]]}
    if key.name in ("integration", "formula"):
        return {"enum": list(FORMULAS), "examples": ["rk4"]}
    if key.holds in (Holds.QUANTITY, Holds.EITHER):
        return {**_quantity(), "examples": _QUANTITY_EXAMPLES[key.unit]}
    if key.holds is Holds.INTEGER:
        least, most = RANGES[key.name]
        example = _INTEGER_EXAMPLES[key.name]
        return {"type": "integer", "minimum": least, "maximum": most, "examples": [example]}
    if key.holds is Holds.CHOICE:
        return {"enum": list(key.choices), "examples": [key.choices[-1]]}
    if key.holds is Holds.TERMS:
        made = _map(_quantity(), {"pattern": SIGNAL_NAME})
        example = _TERMS_EXAMPLES.get(key.name, {"theta": 1})
        return {**made, "minProperties": int(key.required), "examples": [example]}
    if key.holds is Holds.POINTS:
        made = {"type": "object", "minProperties": 2, "additionalProperties": _quantity()}
        return {**made, "examples": [{"-1": 0, "0": 0, "1": 1}]}
    if key.holds is Holds.GRID:
        made = {"type": "object", "minProperties": 2}
        return {
            **made,
            "examples": [{"0": 0.1, "1.2": 0.3}, {"0": {"0": 1, "5": 2}, "1": {"0": 3}}],
        }
    if key.holds is Holds.SIGNALS:
        items = {"type": "string", "pattern": SIGNAL_NAME}
        return {
            "type": "array",
            "items": items,
            "minItems": 1,
            "uniqueItems": key.name == "record",
            "examples": [["theta"]],
        }
    made = {"type": "string", "minLength": 1}
    if key.holds is Holds.SIGNAL:
        made["pattern"] = SIGNAL_NAME
    return {**made, "examples": [_TEXT_EXAMPLES.get(key.name, "theta")]}


def reference() -> str:
    """Every key of the language as Markdown tables."""
    sections = [
        ("top level", language.TOP_KEYS),
        ("machine", language.MACHINE_KEYS),
        ("interface, adc", language.ADC_KEYS),
        ("interface, dac", (*language.DAC_KEYS, *language.ERROR_KEYS)),
        ("tables", language.TABLE_KEYS),
        ("models", language.MODEL_KEYS),
        ("digital", language.DIGITAL_KEYS),
        ("digital, states", language.STATE_KEYS),
        ("digital, word and words", language.WORD_KEYS),
        ("digital, processor", language.PROCESSOR_KEYS),
        ("digital, each of the tasks", language.TASK_KEYS),
        ("modes", language.MODES_KEYS),
        ("run", language.RUN_KEYS),
        ("parts", language.PART_KEYS),
        ("definitions, and the file of a sub-patch", language.DEFINITION_KEYS),
        ("every analog component", (language.FULL_SCALE, language.UNIT, *language.ERROR_KEYS)),
    ]
    sections += [
        (f"analog, {kind.key}: {kind.doc}", (kind.main, *kind.keys)) for kind in CATALOG.values()
    ]
    kinds = tuple(Key(k, Holds.SIGNAL, doc) for k, doc in language.READOUT_KINDS.items())
    sections.append(("readouts (one quantity each)", (*kinds, *language.READOUT_KEYS)))
    return "\n".join(_section(title, keys) for title, keys in sections)


def _section(title: str, keys: tuple[Key, ...]) -> str:
    rows = [f"### {title}", "", "| key | holds | unit | meaning |", "| --- | --- | --- | --- |"]
    rows += [f"| `{k.name}` | {_words(k)} | {_unit_words(k)} | {_meaning(k)} |" for k in keys]
    return "\n".join([*rows, ""])


def _words(key: Key) -> str:
    if key.name in RANGES:
        least, most = RANGES[key.name]
        return f"{key.holds.value}, {least} to {'2^63 - 1' if most == 2**63 - 1 else most}"
    if key.choices:
        return " or ".join(key.choices)
    return key.holds.value + (", required" if key.required else "")


def _unit_words(key: Key) -> str:
    has_unit = key.holds in (Holds.QUANTITY, Holds.EITHER) and key.unit is not Unit.ANY
    return key.unit.value if has_unit else ""


def _meaning(key: Key) -> str:
    bound = f"; {key.bound.value}" if key.bound is not Bound.ANY else ""
    default = f"; default {key.default}" if key.default else ""
    return key.doc + bound + default
