"""DAVE-ML files (AIAA S-119): the variables of a model with their arithmetic and tables.

Stage 2. Inside a model numbers are in the units of the file; `Variable.factor` is for the door. Read are
variableDef with MathML, limits and initial values, breakpointDef, griddedTableDef, ungriddedTableDef and
function, all linear; what else a function may be is refused. Everything else tells readers something.
http://daveml.org/DTDs/2p0/Ref (DAVE-ML 2.0 reference).
"""

from __future__ import annotations

import functools
import math
import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hybrid.errors import PatchError, Place, counted, did_you_mean, quoted
from hybrid.expressions import LookUp, Name, Node, Number, names
from hybrid.graph import find_loop
from hybrid.mathml import read_math
from hybrid.meshes import check_spread, scattered_table, twice
from hybrid.tables import (
    CLAMPS,
    CONTINUES,
    Axis,
    Table,
    TableError,
    check_points,
    check_size,
    limits,
)
from hybrid.xmltree import Element, read_xml

_Found = TypeVar("_Found")
_SEPARATORS = re.compile(r"[\s,;]+")
# Nothing between two separators, or before the first.
_EMPTY = re.compile(r"(?:^|[,;])\s*[,;]")
# What says that a variable is given from outside: an input, one of the pilot's or one that disturbs, or
# a state, which is integrated outside. Its initial value stands in where nothing is.
_GIVEN = ("isInput", "isControl", "isDisturbance", "isState")
# Which sides a table goes on beyond its range, by the attribute extrapolate.
_SIDES = {
    "neither": (False, False),
    "min": (True, False),
    "max": (False, True),
    "both": (True, True),
}


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable: `expr` is over the others, by `inside`; None for an input."""

    id: str
    name: str
    units: str  # as the file says
    expr: Node | None
    is_output: bool
    place: Place
    limits: tuple[float, float] = (-math.inf, math.inf)
    initial: float | None = None  # what an input is where nothing is given


@dataclass(frozen=True)
class Model:
    """The variables of a file, by their id; `inside(id)` is how arithmetic names them."""

    variables: Mapping[str, Variable]
    prefix: str
    file: str = ""
    shots: tuple[Element, ...] = ()  # to check it by, read when that is done

    def inside(self, id_: str) -> str:
        """The name of a variable, in the units of the file, in arithmetic; see `errors.known_as`."""
        return f"{self.prefix}:{self.words[id_]}"

    @functools.cached_property
    def words(self) -> Mapping[str, str]:
        """How each variable is read, by its id: by its name, where that is the only one and a word."""
        return _words({id_: variable.name for id_, variable in self.variables.items()})

    @functools.cached_property
    def ids(self) -> Mapping[str, str]:
        """The id of each variable by how it is read."""
        return {word: id_ for id_, word in self.words.items()}

    def find(self, word: str) -> Variable | None:
        """A variable by its name, where it is the only one of that name, or its id."""
        named = self.named.get(word, [])
        return named[0] if len(named) == 1 else self.variables.get(word)

    @functools.cached_property
    def named(self) -> Mapping[str, list[Variable]]:
        """The variables by their names, which need not be different."""
        found: dict[str, list[Variable]] = {}
        for variable in self.variables.values():
            found.setdefault(variable.name, []).append(variable)
        return found

    @property
    def inputs(self) -> tuple[Variable, ...]:
        """What must be given."""
        return tuple(v for v in self.variables.values() if v.expr is None)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of what the file declares as its results."""
        return tuple(v.name for v in self.variables.values() if v.is_output)


def read_model(text: str, file: str, prefix: str) -> Model:
    """The model in a DAVE-ML text; raises PatchError with the line of whatever is wrong."""
    root = read_xml(text, file)
    if root.tag != "DAVEfunc":
        raise PatchError(f"<{root.tag}> is no DAVE-ML; the first element is <DAVEfunc>", root.place)
    reader = _Reader(root, prefix)
    variables = {id_: reader.variable(e) for id_, e in reader.defined.items()}
    shots = [shot for data in root.all("checkData") for shot in data.all("staticShot")]
    model = Model(variables, prefix, file, tuple(shots))
    needs = {id_: _needs(v, model) for id_, v in model.variables.items()}
    loop = find_loop(needs)
    if loop:
        path = " -> ".join((*loop, loop[0]))
        raise PatchError(f"variables depend on each other: {path}", model.variables[loop[0]].place)
    return model


def _needs(variable: Variable, model: Model) -> list[str]:
    """Ids of the variables that a variable is computed from."""
    read = names(variable.expr) if variable.expr is not None else frozenset()
    return sorted(model.ids[name.partition(":")[2]] for name in read)


def _words(names_of: Mapping[str, str]) -> dict[str, str]:
    """A word for each id, no two alike: the name, if that is one and no other variable's too."""
    count = Counter(names_of.values())
    taken = {n for n in count if count[n] == 1 and n.isidentifier()}
    words = {id_: n for id_, n in names_of.items() if n in taken}
    for id_ in names_of:
        if id_ not in words:  # no name of another may stand for it
            words[id_] = id_ if id_ not in taken else f"{id_}'"
    return words


def needed(model: Model, wanted: Iterable[str], known: Container[str] = ()) -> list[str]:
    """Ids of variables and of all that they are computed from, each once; without those that are known
    and what these are computed from."""
    found = dict[str, None]()
    for one in wanted:
        left = [one]
        while left:
            id_ = left.pop()
            if id_ not in found and id_ not in known:
                found[id_] = None
                left += _needs(model.variables[id_], model)
    return list(found)


class _Reader:
    """Finds what elements refer to."""

    def __init__(self, root: Element, prefix: str) -> None:
        self.prefix = prefix
        self.defined = _by_id(root, "variableDef", "varID")
        if not self.defined:
            raise PatchError("no <variableDef>; a model needs variables", root.place)
        self.breakpoints = _by_id(root, "breakpointDef", "bpID")
        self.tables = _by_id(root, "griddedTableDef", "gtID")
        self.loose = _by_id(root, "ungriddedTableDef", "utID")
        self.words = _words({id_: _name(e, id_) for id_, e in self.defined.items()})
        self.functions: dict[str, Element] = {}
        for function in root.all("function"):
            dependent = _only(function, "dependentVarRef", "dependentVarPts")
            id_ = self.known(dependent.required("varID"), dependent)
            if id_ in self.functions:
                raise PatchError(f"a second function gives {quoted(id_)}", dependent.place)
            self.functions[id_] = function

    def known(self, id_: str, element: Element) -> str:
        """The id of a variable that is defined."""
        if id_ not in self.defined:
            hint = did_you_mean(id_, self.defined)
            raise PatchError(f"no variable has the varID {quoted(id_)}; {hint}", element.place)
        return id_

    def inside(self, id_: str, element: Element) -> str:
        return f"{self.prefix}:{self.words[self.known(id_, element)]}"

    def variable(self, element: Element) -> Variable:
        id_ = element.required("varID")
        calculation = element.first("calculation")
        between = tuple(
            _number(element, key, default)
            for key, default in (("minValue", -math.inf), ("maxValue", math.inf))
        )
        if not between[0] <= between[1]:
            raise PatchError("minValue is above maxValue", element.place)
        expr: Node | None = None
        if calculation is not None:
            if id_ in self.functions:
                raise PatchError(
                    f"{quoted(id_)} has both a calculation and a function", element.place
                )
            expr = read_math(_only(calculation, "math"), self.inside)
        elif id_ in self.functions:
            expr = self.function(self.functions[id_], id_)
        elif element.first(*_GIVEN) is None and "initialValue" in element.attributes:
            expr = Number(_number(element, "initialValue", 0.0))
        return Variable(
            id_,
            _name(element, id_),
            element.attributes.get("units", "nd").strip(),
            self.kept_within(expr, id_, element, (between[0], between[1]))
            if expr is not None
            else None,
            element.first("isOutput") is not None,
            element.place,
            (between[0], between[1]),
            _number(element, "initialValue", 0.0) if "initialValue" in element.attributes else None,
        )

    def kept_within(
        self, expr: Node, id_: str, element: Element, between: tuple[float, float]
    ) -> Node:
        """What a variable is within its limits; a constant that is within them is itself."""
        if isinstance(expr, Number) and between[0] <= expr.value <= between[1]:
            return expr
        name = f"{self.prefix}:{self.words[id_]}"
        return limited(expr, limits(name, _name(element, id_), between))

    def function(self, function: Element, id_: str) -> Node:
        """A table at its variables."""
        refs = list(function.all("independentVarRef"))
        if refs:
            table = self.defined_table(function, refs, id_)
        else:
            refs = list(function.all("independentVarPts"))
            table = self.listed(function, refs, id_)
        return LookUp(table, tuple(Name(self.inside(r.required("varID"), r)) for r in refs))

    def defined_table(self, function: Element, refs: list[Element], id_: str) -> Table:
        """What the definition of a function holds or refers to."""
        definition = _only(function, "functionDefn")
        found = definition.first("griddedTableDef", "griddedTable", "griddedTableRef")
        if found is not None:
            return self.gridded(function, found, refs, id_)
        loose = definition.first("ungriddedTableDef", "ungriddedTable", "ungriddedTableRef")
        if loose is None:
            raise PatchError(
                "<functionDefn> has no table, gridded or ungridded; other ones are not read",
                definition.place,
            )
        return self.ungridded(loose, refs, id_)

    def ungridded(self, found: Element, refs: list[Element], id_: str) -> Table:
        """Points that lie anywhere: beyond them it goes on only where every variable may, both ways."""
        if found.tag == "ungriddedTableRef":
            found = _referred(found, "utID", self.loose)
        elements = list(found.all("dataPoint"))
        rows = [_numbers(element) for element in elements]
        _checked(lambda: check_size([2] * len(refs)), found)
        for row, element in zip(rows, elements, strict=True):
            if len(row) != len(refs) + 1:
                raise PatchError(
                    f"<dataPoint> has {counted(len(row), 'number')}; a function of "
                    f"{counted(len(refs), 'variable')} needs {len(refs) + 1}, the value last",
                    element.place,
                )
        data = np.array(rows).reshape(-1, len(refs) + 1)
        points, values = data[:, :-1], data[:, -1]
        if (same := twice(points)) is not None:
            raise PatchError("a point stands at the place of an earlier one", elements[same].place)
        _checked(lambda: check_spread(points), found)
        pairs = zip(refs, points.T, strict=True)
        axes = tuple(_axis(ref, [float(p.min()), float(p.max())]) for ref, p in pairs)
        goes_on = all(axis.below == axis.above == CONTINUES for axis in axes)
        table = Table(f"{self.prefix}:{self.words[id_]}", axes, values)
        action = CONTINUES if goes_on else CLAMPS
        return _checked(lambda: scattered_table(table, points, values, action), found)

    def gridded(self, function: Element, found: Element, refs: list[Element], id_: str) -> Table:
        if found.tag == "griddedTableRef":
            found = _referred(found, "gtID", self.tables)
        points = [
            _numbers(_only(_referred(ref, "bpID", self.breakpoints), "bpVals"))
            for ref in _only(found, "breakpointRefs").all("bpRef")
        ]
        if len(points) != len(refs):
            raise PatchError(
                f"a table of {counted(len(points), 'variable')}, but a function of {len(refs)}",
                function.place,
            )
        data = _only(found, "dataTable")
        return self.table(id_, refs, points, _numbers(data), data)

    def listed(self, function: Element, refs: list[Element], id_: str) -> Table:
        """The short form: pairs of points in the function itself."""
        if len(refs) != 1:
            raise PatchError(
                "<function> needs an independentVarRef or one independentVarPts", function.place
            )
        data = _only(function, "dependentVarPts")
        return self.table(id_, refs, [_numbers(refs[0])], _numbers(data), data)

    def table(
        self,
        id_: str,
        refs: list[Element],
        points: list[list[float]],
        values: list[float],
        data: Element,
    ) -> Table:
        axes = tuple(_axis(ref, p) for ref, p in zip(refs, points, strict=True))
        shape = [len(p) for p in points]
        _checked(lambda: check_size(shape), data)
        if len(values) != math.prod(shape):
            due = " x ".join(map(str, shape))
            raise PatchError(
                f"the table has {len(values)} values; its breakpoints ask for {due}", data.place
            )
        name = f"{self.prefix}:{self.words[id_]}"
        return Table(name, axes, np.array(values).reshape(shape))


def _name(element: Element, id_: str) -> str:
    return element.attributes.get("name", id_).strip()


def limited(expr: Node, table: Table | None) -> Node:
    """An expression within limits, so that a run tells where they act; itself where there are none."""
    return expr if table is None else LookUp(table, (expr,))


def _axis(ref: Element, points: list[float]) -> Axis:
    """A variable of a table: held at the nearer limit beyond its range, or continued where declared."""
    name = ref.required("varID")
    _checked(lambda: check_points(name, points), ref)
    how = ref.attributes.get("interpolate", "linear")
    if how != "linear":
        raise PatchError(f"interpolate is {quoted(how)}; only 'linear' is read", ref.place)
    sides = ref.attributes.get("extrapolate", "neither")
    if sides not in _SIDES:
        raise PatchError(
            f"extrapolate is {quoted(sides)}; {did_you_mean(sides, _SIDES)}", ref.place
        )
    low = max(_number(ref, "min", -math.inf), points[0])
    high = min(_number(ref, "max", math.inf), points[-1])
    if not low < high:
        raise PatchError("min and max leave no range between the breakpoints", ref.place)
    below, above = (CONTINUES if goes_on else CLAMPS for goes_on in _SIDES[sides])
    return Axis(name, np.array(points), (low, high), below, above)


def _by_id(root: Element, tag: str, key: str) -> dict[str, Element]:
    """The children of a tag by their id, which each has alone."""
    found: dict[str, Element] = {}
    for element in root.all(tag):
        id_ = element.required(key)
        if id_ in found:
            raise PatchError(f"the {key} {quoted(id_)} comes twice", element.place)
        found[id_] = element
    return found


def _referred(ref: Element, key: str, known: Mapping[str, Element]) -> Element:
    id_ = ref.required(key)
    if id_ not in known:
        raise PatchError(
            f"nothing has the {key} {quoted(id_)}; {did_you_mean(id_, known)}", ref.place
        )
    return known[id_]


def _only(element: Element, *tags: str) -> Element:
    found = element.first(*tags)
    if found is None:
        raise PatchError(f"<{element.tag}> has no <{tags[0]}>; add one", element.place)
    return found


def _number(element: Element, key: str, default: float) -> float:
    """A number in an attribute."""
    text = element.attributes.get(key)
    return default if text is None else _float(text.strip(), element, key)


def number_in(element: Element) -> float:
    """The number that an element holds."""
    return _float(element.text.strip(), element, f"<{element.tag}>")


def _numbers(element: Element) -> list[float]:
    """Numbers between commas, semicolons and spaces; one of these may end them, but none is left out."""
    if empty := _EMPTY.search(element.text):
        before = _SEPARATORS.split(element.text[: empty.start()].strip())
        where = f"after {quoted(before[-1])}" if before[-1] else "at the beginning"
        raise PatchError(
            f"<{element.tag}> has an empty cell {where}; write its number", element.place
        )
    words = [word for word in _SEPARATORS.split(element.text) if word]
    return [_float(word, element, f"<{element.tag}>") for word in words]


def _float(text: str, element: Element, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise PatchError(f"{what} holds {quoted(text)}, which is no number", element.place)
    return value


def _checked(check: Callable[[], _Found], element: Element) -> _Found:
    try:
        return check()
    except TableError as error:
        raise PatchError(str(error), element.place) from None
