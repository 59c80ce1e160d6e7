"""The JSON Schema says what the reader of patch files does, and the reference names every key."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest
import yaml
from bad_patches import KEYS, NAMES, PATCH, VALUES, Wrong

from hybrid import language
from hybrid.cli import main
from hybrid.components import CATALOG
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.schema import EXAMPLE, json_schema, reference
from hybrid.shipped import shipped_patches

SCHEMA = json_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
EVERY_KEY = {
    key.name
    for keys in (
        language.TOP_KEYS,
        language.MACHINE_KEYS,
        language.ADC_KEYS,
        language.DAC_KEYS,
        language.DIGITAL_KEYS,
        language.STATE_KEYS,
        language.WORD_KEYS,
        language.TASK_KEYS,
        language.PROCESSOR_KEYS,
        language.MODES_KEYS,
        language.RUN_KEYS,
        language.PART_KEYS,
        language.DEFINITION_KEYS,
        language.READOUT_KEYS,
        language.ERROR_KEYS,
        (language.FULL_SCALE, language.UNIT),
        *((kind.main, *kind.keys) for kind in CATALOG.values()),
    )
    for key in keys
} | set(language.READOUT_KINDS)


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert json.loads(json.dumps(SCHEMA)) == SCHEMA


@pytest.mark.parametrize("name", shipped_patches())
def test_shipped_patches_are_valid(name: str) -> None:
    text = shipped_patches()[name].read_text(encoding="utf-8")
    VALIDATOR.validate(yaml.safe_load(text))


def test_the_patch_of_the_tests_is_valid() -> None:
    VALIDATOR.validate(yaml.safe_load(PATCH))


# What a schema cannot say: which of two optional keys is due, whether a name exists, what texts mean.
BEYOND = {
    "sine without omega", "sine with both", "code", "escape in title", "two lines", "long title",
    "underscore", "hexadecimal", "infinity", "nan", "named nan", "too large", "too small",
    "two numbers", "comma", "division by zero", "overflow", "root", "attribute", "attribute of a number",
    "unclosed", "deep",
    "deep minus", "long expression", "full_scale 0", "full_scale negative",
    "tiny full_scale", "huge full_scale", "initial", "DAC initial", "huge coefficient", "huge rate",
    "overflowing rate", "huge omega", "tiny tau", "negative tau", "noise 5", "noise alone", "range",
    "same key", "same section", "same component", "same key of one", "parameter and signal",
    "analog and interface", "word and ADC", "longest key",
}  # fmt: skip
# A plain YAML loader stumbles over these or makes no text of the key.
NOT_FOR_SAFE_LOAD = {"list key", "mapping key", "merge key", "null key", "integer"}
NOT_FOR_SAFE_LOAD |= {"bits, long", "longest key"}


def _structural() -> Iterator[object]:
    for wrong in (*KEYS, *NAMES, *VALUES):
        if wrong.name not in BEYOND | NOT_FOR_SAFE_LOAD:
            yield pytest.param(wrong, id=wrong.name)


@pytest.mark.parametrize("wrong", list(_structural()))
def test_the_schema_rejects_what_the_reader_rejects(wrong: Wrong) -> None:
    assert not VALIDATOR.is_valid(yaml.safe_load(wrong.text))
    with pytest.raises(PatchError):
        parse_patch(wrong.text)


@pytest.mark.parametrize("wrong", [w for w in (*KEYS, *NAMES, *VALUES) if w.name in BEYOND])
def test_what_the_schema_cannot_say(wrong: Wrong) -> None:
    if wrong.name not in NOT_FOR_SAFE_LOAD:
        VALIDATOR.validate(yaml.safe_load(wrong.text))


def _text(patch: dict[str, Any]) -> str:
    return yaml.safe_dump(patch, sort_keys=False)


def _example() -> dict[str, Any]:
    return copy.deepcopy(dict(EXAMPLE))


def test_the_whole_example_is_a_patch() -> None:
    VALIDATOR.validate(_example())
    patch = parse_patch(_text(_example()))
    assert patch.signals == ("moment", "moment_word", "theta", "theta_dot", "theta_sample")


def _first(properties: dict[str, Any], key: str) -> Any:
    return properties[key]["examples"][0]


def _component_examples() -> Iterator[object]:
    """Every kind with its required keys and one other, as the schema's own examples say."""
    for kind in SCHEMA["properties"]["analog"]["additionalProperties"]["oneOf"]:
        properties, required = kind["properties"], kind["required"]
        least = {key: _first(properties, key) for key in required}
        for key in properties:
            for example in properties[key]["examples"]:
                entries = {**least, key: example}
                if kind["title"] == "sine" and not {"omega", "frequency"} & set(entries):
                    entries["omega"] = "10 rad/s"
                if key == "frequency" and example == "omega_p":
                    continue  # the example is meant for omega
                if key == "frequency":
                    entries["frequency"] = "2 Hz"
                if kind["title"] == "pulse" and key == "duty":
                    entries["period"] = "1 s"
                elif kind["title"] == "pulse":
                    entries["width"] = "1 ms"
                if key == "full_scale" and example == 1:
                    entries = {k: 0.1 if v == "0.1 rad" else v for k, v in entries.items()}
                yield pytest.param(entries, id=f"{kind['title']}, {key}: {example}")


@pytest.mark.parametrize("entries", list(_component_examples()))
def test_examples_of_components(entries: dict[str, Any]) -> None:
    patch = _example()
    patch["analog"]["extra"] = entries
    VALIDATOR.validate(patch)
    parse_patch(_text(patch))


def _section_examples() -> Iterator[object]:
    properties = SCHEMA["properties"]
    adc, dac = properties["interface"]["additionalProperties"]["oneOf"]
    machine = properties["machine"]["anyOf"][1]
    readouts = properties["readouts"]["additionalProperties"]["oneOf"]
    state = properties["digital"]["properties"]["states"]["additionalProperties"]
    task = properties["digital"]["properties"]["tasks"]["additionalProperties"]
    places = [
        ("", SCHEMA, ("title", "description", "record")),
        ("machine", machine, ("serial", "tau", "tolerance", "offset", "noise")),
        ("interface/theta_sample", adc, adc["properties"]),
        ("interface/moment", dac, set(dac["properties"]) - {"initial", "full_scale"}),
        ("digital", properties["digital"], properties["digital"]["properties"]),
        ("digital/states/angle", state, set(state["properties"]) - {"reset_when", "reset_to"}),
        ("digital/tasks/slow", task, set(task["properties"]) - {"program", "priority"}),
        ("digital/tasks/only", task, {"priority"}),
        ("modes", properties["modes"], properties["modes"]["properties"]),
        ("run", properties["run"], properties["run"]["properties"]),
        *(("readouts/pitch_mode", readout, readout["properties"]) for readout in readouts),
    ]
    for path, content, keys in places:
        for key in sorted(keys):
            for example in content["properties"][key]["examples"]:
                yield pytest.param(path, key, example, id=f"{path} {key}: {example}")


@pytest.mark.parametrize(("path", "key", "example"), list(_section_examples()))
def test_examples_of_sections(path: str, key: str, example: Any) -> None:
    patch = _example()
    with_tasks = {"tasks": SCHEMA["properties"]["digital"]["properties"]["tasks"]["examples"][0]}
    if path.startswith("digital/tasks") or key in ("task", "transfer", "tasks", "scheduling"):
        patch["digital"] = copy.deepcopy(with_tasks)
    table = patch
    for step in path.split("/") if path else ():
        table = table.setdefault(step, {})
    if path.startswith("readouts") and key not in ("from", "until"):
        table.clear()
    if path == "digital/states/angle":
        table |= {"integrate": "theta_sample", "initial": 0}
    if path == "modes" and key not in ("reset_when", "hold_when"):
        table |= {"reset": "1 ms", "operate": "9 ms"}
    if path == "digital/tasks/slow" and key == "words":
        example = {"seen": "float32"}  # the example is meant for the one program
    if key == "when":  # in place of the period
        del table["period"]
        patch["analog"]["beyond"] = {"compare": {"theta": 1}, "high": 1, "full_scale": 1}
    if path == "digital/tasks/only":  # of all tasks or none
        patch["digital"]["tasks"] = {"only": table | with_tasks["tasks"]["fast"]}
        table = patch["digital"]["tasks"]["only"]
    if path == "interface/moment" and key == "unit":
        example = "mrad/s^2"  # the example is meant for a component in rad
    table[key] = example
    VALIDATOR.validate(patch)
    parse_patch(_text(patch))


def test_without_a_digital_machine_the_record_needs_an_interval() -> None:
    patch: dict[str, Any] = {
        "title": "Ramp",
        "analog": {
            "one": {"constant": 1, "full_scale": 1},
            "ramp": {"integrate": {"one": 1}, "initial": 0, "full_scale": 2},
        },
        "run": {"until": 1},
    }
    assert not VALIDATOR.is_valid(patch)
    with pytest.raises(PatchError, match="every"):
        parse_patch(_text(patch))
    patch["run"]["every"] = 0.1
    VALIDATOR.validate(patch)
    parse_patch(_text(patch))


def test_converters_need_a_digital_machine() -> None:
    patch = _example()
    del patch["digital"]
    patch["run"]["every"] = 1
    assert not VALIDATOR.is_valid(patch)
    with pytest.raises(PatchError, match="digital"):
        parse_patch(_text(patch))


@pytest.mark.parametrize("key", sorted(EVERY_KEY))
def test_the_reference_names_every_key(key: str) -> None:
    assert f"| `{key}` |" in reference()


@pytest.mark.parametrize("kind", CATALOG)
def test_the_reference_describes_every_kind(kind: str) -> None:
    assert f"### analog, {kind}: {CATALOG[kind].doc}" in reference()


def test_every_row_of_the_reference_has_four_cells() -> None:
    rows = [line for line in reference().splitlines() if line.startswith("|")]
    assert {row.count("|") for row in rows} == {5}


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == SCHEMA
    assert main(["schema", "--markdown"]) == 0
    assert capsys.readouterr().out == reference() + "\n"
