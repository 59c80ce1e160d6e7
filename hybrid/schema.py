"""The patch language for editors and readers: JSON Schema and a reference table.

Stage 3. Both are generated from the definitions that the reader of patch files checks by.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hybrid import language
from hybrid.components import CATALOG
from hybrid.language import Bound, Holds, Key, Unit
from hybrid.machines import PRESETS

_NAME = "^[A-Za-z_][A-Za-z0-9_]{0,63}$"


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a patch file as YAML reads it."""
    top = _object(language.TOP_KEYS)
    properties = top["properties"]
    properties["machine"] = {
        "anyOf": [{"enum": sorted(PRESETS)}, _object(language.MACHINE_KEYS)],
        "description": properties["machine"]["description"],
    }
    properties["parameters"] = _map(_quantity(), "name: quantity")
    components = [_component(kind.key) for kind in CATALOG.values()]
    properties["analog"] = _map({"oneOf": components}, "signal: component")
    dac = _object((*language.DAC_KEYS, *language.ERROR_KEYS))
    properties["interface"] = _map(
        {"oneOf": [_object(language.ADC_KEYS), dac]}, "signal: converter"
    )
    properties["digital"] = _object(language.DIGITAL_KEYS)
    properties["run"] = _object(language.RUN_KEYS)
    readouts = [
        _object((Key(kind, Holds.SIGNAL, doc, required=True), *language.READOUT_KEYS))
        for kind, doc in language.READOUT_KINDS.items()
    ]
    properties["readouts"] = _map({"oneOf": readouts}, "name: readout")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Hybrid patch",
        **top,
    }


def _component(key: str) -> dict[str, Any]:
    kind = CATALOG[key]
    keys = (kind.main, *kind.keys, language.FULL_SCALE, language.UNIT, *language.ERROR_KEYS)
    return {"title": key, "description": kind.doc, **_object(keys)}


def _object(keys: Iterable[Key]) -> dict[str, Any]:
    keys = tuple(keys)
    return {
        "type": "object",
        "properties": {key.name: {**_holds(key), "description": key.doc} for key in keys},
        "required": [key.name for key in keys if key.required],
        "additionalProperties": False,
    }


def _map(values: dict[str, Any], doc: str) -> dict[str, Any]:
    return {
        "type": "object",
        "description": doc,
        "patternProperties": {_NAME: values},
        "additionalProperties": False,
    }


def _quantity() -> dict[str, Any]:
    return {"type": ["number", "string"]}


def _holds(key: Key) -> dict[str, Any]:
    if key.holds is Holds.QUANTITY:
        return _quantity()
    if key.holds is Holds.INTEGER:
        return {"type": "integer"}
    if key.holds is Holds.TERMS:
        return {"type": "object", "additionalProperties": _quantity()}
    if key.holds is Holds.SIGNALS:
        return {"type": "array", "items": {"type": "string"}}
    return {"type": "string"}


def reference() -> str:
    """Every key of the language as Markdown tables."""
    sections = [
        ("top level", language.TOP_KEYS),
        ("machine", language.MACHINE_KEYS),
        ("interface, adc", language.ADC_KEYS),
        ("interface, dac", (*language.DAC_KEYS, *language.ERROR_KEYS)),
        ("digital", language.DIGITAL_KEYS),
        ("run", language.RUN_KEYS),
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
    return key.holds.value + (", required" if key.required else "")


def _unit_words(key: Key) -> str:
    return key.unit.value if key.holds is Holds.QUANTITY and key.unit is not Unit.ANY else ""


def _meaning(key: Key) -> str:
    bound = f"; {key.bound.value}" if key.bound is not Bound.ANY else ""
    default = f"; default {key.default}" if key.default else ""
    return key.doc + bound + default
