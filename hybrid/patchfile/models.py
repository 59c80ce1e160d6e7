"""The section `models`: DAVE-ML files, whose variables become words of the program.

`model:id` is a variable in the units of its file, `model.name` the same in SI units as the program reads
it. Only what the program reads is computed, each variable once a cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hybrid.daveml import Model, Variable, limited, needed, read_model
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import (
    Binary,
    ExpressionError,
    Name,
    Node,
    Number,
    names,
    previous_names,
)
from hybrid.fields import in_words, table_of
from hybrid.language import MODEL_KEYS
from hybrid.parsing import parse
from hybrid.patch import Assignment
from hybrid.patchfile.book import Book, Role
from hybrid.s119 import unit_text
from hybrid.tables import limits
from hybrid.units import Dimension, UnitError, unit_of
from hybrid.yamltree import Table, Text, Tree


@dataclass(frozen=True, slots=True)
class ModelUse:
    """A model with what its inputs are connected to."""

    name: str
    model: Model
    inputs: Mapping[str, Text]  # arithmetic, by the id of the variable
    units: Mapping[str, Text]  # in place of those of the file, by the id
    place: Place

    def scale(self, variable: Variable) -> tuple[float, Dimension, str]:
        """SI value and dimension of a variable's unit, and the unit."""
        if variable.id in self.units:
            given = self.units[variable.id]
            try:
                unit, factor, dimension = unit_of(f"1 {given.text}" if given.text != "1" else "1")
            except UnitError as error:
                what = f"model {self.name!r}: unit of {variable.name!r}"
                raise PatchError(f"{what}: {error}", given.place) from None
            return factor, dimension, unit
        text = unit_text(variable.units)
        if text is None:
            raise PatchError(
                f"{variable.name!r} is in unknown units {quoted(variable.units)}; say in the patch what "
                f"they are: {self.name}: {{units: {{{variable.id}: ft}}}}",
                variable.place,
            )
        unit, factor, dimension = unit_of(f"1 {text}".strip())
        return factor, dimension, unit


def read_models(book: Book) -> None:
    """Read every model and put it into the book."""
    for name, tree, place in book.section("models") or ():
        table = table_of(tree, f"model {quoted(name)}", "file: aero.dml, inputs: {mach: m}")
        fields = book.fields(table, f"model {name!r}", MODEL_KEYS, place)
        path = Text(fields.text("file"), fields.place("file"))
        file, text = book.files.read(path, fields.what)
        model = read_model(text, file, name)
        inputs = _given(model, table, "inputs", fields.what)
        for id_, arithmetic in inputs.items():
            if model.variables[id_].expr is not None:
                hint = did_you_mean(id_, [v.name for v in model.inputs])
                raise PatchError(
                    f"{fields.what}: {quoted(id_)} is no input of {file}; {hint}", arithmetic.place
                )
        units = _given(model, table, "units", fields.what)
        book.models[name] = ModelUse(name, model, inputs, units, place)


def _given(model: Model, table: Table, key: str, what: str) -> dict[str, Text]:
    """Texts by the id of the variables that they are for."""
    tree: Tree | None = table.entries.get(key)
    found: dict[str, Text] = {}
    for word, item, place in table_of(tree, f"{key} of {what}", "variable: text") if tree else ():
        variable = model.find(word)
        if variable is None:
            _refuse_ambiguous(model, what, word, place)
            valid = model.inputs if key == "inputs" else model.variables.values()
            hint = did_you_mean(word, [name for v in valid for name in (v.name, v.id)])
            raise PatchError(f"{what}: the model has no variable {quoted(word)}; {hint}", place)
        if not isinstance(item, Text) or not item.text:
            raise PatchError(f"{what}: {key} of {word!r} needs a text", place)
        if variable.id in found:
            raise PatchError(f"{what}: {word!r} is given twice", place)
        found[variable.id] = item
    return found


def model_names(book: Book) -> frozenset[str]:
    """Everything that the program may read of models."""
    return frozenset(
        f"{name}.{word}"
        for name, use in book.models.items()
        for variable in use.model.variables.values()
        for word in (variable.name, variable.id)
        if use.model.find(word)
    )


def refuse_model_name(book: Book, what: str, name: str, place: Place) -> None:
    """Raise PatchError where a name that cannot be read is meant to be one of a model."""
    if name in book.models:
        output = next(iter(book.models[name].model.outputs), "output")
        raise PatchError(
            f"{what}: {name!r} is a model; read one of its outputs, such as {name}.{output}", place
        )
    model, _, word = name.rpartition(".")
    if model not in book.models:
        return
    _refuse_ambiguous(book.models[model].model, what, word, place)
    hint = did_you_mean(word, book.models[model].model.outputs)
    raise PatchError(f"{what}: the model {model} has no variable {quoted(word)}; {hint}", place)


def _refuse_ambiguous(model: Model, what: str, word: str, place: Place) -> None:
    """Raise PatchError for a name that several variables have."""
    ids = [variable.id for variable in model.variables.values() if variable.name == word]
    if len(ids) > 1:
        raise PatchError(
            f"{what}: {len(ids)} variables of the model are named {quoted(word)}; say which by its "
            f"varID, {' or '.join(ids)}",
            place,
        )


def model_words(book: Book, read: Iterable[str], readable: frozenset[str]) -> dict[str, Assignment]:
    """The words that compute what the program reads of models, and what these read in turn."""
    found: dict[str, Assignment] = {}
    taken: dict[str, set[str]] = {name: set() for name in book.models}  # ids
    left = sorted(name for name in read if name.rpartition(".")[0] in book.models)
    while left:
        name = left.pop()
        if name in found:
            continue
        model, _, word = name.rpartition(".")
        use = book.models[model]
        wanted = use.model.find(word)
        assert wanted is not None  # it is readable
        factor, dimension, _ = use.scale(wanted)
        inside = Name(use.model.inside(wanted.id))
        expr: Node = Binary("*", inside, Number(factor, dimension))
        found[name] = Assignment(name, expr, wanted.place, hidden=True)
        for id_ in needed(use.model, [wanted.id], taken[model]):
            taken[model].add(id_)
            variable, at = use.model.variables[id_], use.model.inside(id_)
            place = variable.place
            if variable.expr is None:
                expr, place = _connected(book, use, variable, readable)
                left += [n for n in sorted(names(expr)) if n.rpartition(".")[0] in book.models]
            else:
                expr = variable.expr
            found[at] = Assignment(at, expr, place, hidden=True)
    return found


def _connected(
    book: Book, use: ModelUse, variable: Variable, readable: frozenset[str]
) -> tuple[Node, Place]:
    """What an input is connected to, in the units of the file, and where that is said.

    One that is not connected has its initial value, if the file gives one.
    """
    name = f"{use.name}:{variable.name}"
    if variable.id not in use.inputs and variable.initial is not None:
        within = limits(name, variable.name, variable.limits)
        return limited(Number(variable.initial), within), variable.place
    if variable.id not in use.inputs:
        raise PatchError(
            f"model {use.name!r} needs its input {variable.name!r}; connect it: "
            f"inputs: {{{variable.name}: a word of the program}}",
            use.place,
        )
    given = use.inputs[variable.id]
    what = f"input {variable.name!r} of model {use.name!r}"
    try:
        expr = parse(given.text, readable, tables=book.tables)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", given.place) from None
    for read in sorted((names(expr) | previous_names(expr)) - readable):
        refuse_model_name(book, what, read, given.place)
        if read in book.roles:
            raise PatchError(f"{what} reads {read!r}, which the program cannot read", given.place)
        hint = did_you_mean(read, book.named(Role.PARAMETER, Role.ADC, Role.WORD))
        raise PatchError(f"{what} reads unknown {quoted(read)}; {hint}", given.place)
    factor, dimension, unit = use.scale(variable)
    if isinstance(expr, Number) and expr.dimension.is_pure:  # a bare number is in SI units
        expr = Number(expr.value, dimension)
    between = (variable.limits[0] * factor, variable.limits[1] * factor)
    within = limits(name, variable.name, between, dimension, (unit, factor))
    return Binary("/", limited(expr, within), Number(factor, dimension)), given.place


def check_input(book: Book, word: str, found: Dimension | None) -> None:
    """Refuse an input of a model that is connected to what is in other units."""
    name, _, inside = word.partition(":")
    if found is None or found.is_pure or not inside:
        return
    use = book.models[name]
    variable = use.model.variables[use.model.ids[inside]]
    if variable.expr is None:
        _, due, unit = use.scale(variable)
        raise PatchError(
            f"input {variable.name!r} of model {name!r} is connected to what is "
            f"{in_words(found * due)}; it must be {in_words(due, unit)}",
            use.inputs[variable.id].place,
        )
