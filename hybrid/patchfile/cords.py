"""What crosses the sections: units agree from end to end of every cord."""

from __future__ import annotations

from hybrid.components import CATALOG
from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, quoted
from hybrid.expressions import to_text
from hybrid.fields import in_words
from hybrid.patch import Component, Dac, Program, Value
from hybrid.patchfile.book import Book
from hybrid.units import PURE, TIME, Dimension


def check_cords(
    book: Book,
    components: tuple[Component, ...],
    dacs: tuple[Dac, ...],
    program: Program | None,
) -> None:
    """Raise PatchError for the first cord that cannot be."""
    if not components and not program:
        raise PatchError("the patch is empty; it needs analog: or digital:", book.root.place)
    for component in components:
        if component.kind == "compare":
            _check_compared(book, component)
        else:
            for signal, value in component.terms:
                _check_coefficient(book, component, signal, value)
        _check_points(book, component)
        _check_result(book, component)
        _check_initial(book, component)
    dimensions = {a.word: a.dimension for a in program.written} if program else {}
    for dac in dacs:
        dimension = dimensions[dac.word]
        if dimension not in (None, PURE, dac.dimension):
            raise PatchError(
                f"DAC {dac.name!r} converts {dac.word!r}, which is {in_words(dimension or PURE)}; "
                f"by its full_scale it must be {in_words(dac.dimension, dac.unit)}",
                dac.place,
            )


def _check_result(book: Book, component: Component) -> None:
    """What a component makes of the units that it reads, times its factor, is in its own unit.

    A factor that is written as a bare number is in SI units of whatever is due; one that is not written
    is a pure 1.
    """
    kind, what = CATALOG[component.kind], f"component {component.name!r}"
    read = [book.scales[signal] for signal in component.signals]
    inputs = tuple(scale.dimension for scale in read)
    if kind.takes_angle and not inputs[0].is_pure:
        raise PatchError(
            f"{what} is the {kind.key} of {component.signals[0]!r}, which is "
            f"{in_words(inputs[0], read[0].unit)}; it must be an angle",
            component.place,
        )
    if kind.takes_alike and inputs[0] != inputs[-1]:
        raise PatchError(
            f"{what} reads {component.signals[0]!r}, which is {in_words(inputs[0], read[0].unit)}, and "
            f"{component.signals[-1]!r}, which is {in_words(inputs[-1], read[-1].unit)}; these must "
            "have the same units",
            component.place,
        )
    plain, factor = kind.result(inputs), component.values.get(kind.factor)
    if plain is None:
        return
    wanted = component.dimension / plain
    found = dimension_of(factor.expr, book.scope) if factor else PURE
    if found in (None, wanted) or (factor and found == PURE):
        return
    result = f"the result is {in_words(plain)}, and full_scale is {in_words(component.dimension)}"
    if not kind.factor:
        raise PatchError(f"units of {what} do not fit: {result}", component.place)
    raise PatchError(
        f"{kind.factor} of {what} must be {in_words(wanted)}: without it {result}", component.place
    )


def _check_points(book: Book, component: Component) -> None:
    """Inputs of a function generator's points, and what rounds its corners, are in the unit it reads."""
    if not component.points:
        return
    read, rounding = book.scales[component.signals[0]], component.values.get("rounding")
    for value in [*(x for x, _ in component.points), *([rounding] if rounding else [])]:
        found = dimension_of(value.expr, book.scope)
        if found not in (None, PURE, read.dimension):
            raise PatchError(
                f"{value.what} is {quoted(to_text(value.expr))}; it reads "
                f"{component.signals[0]!r}, so it must be {in_words(read.dimension, read.unit)}",
                value.place,
            )


def _check_compared(book: Book, component: Component) -> None:
    """What a comparator adds up has one unit, which is that of its threshold and its hysteresis.

    A bare coefficient is in SI units of whatever is due, so that bare ones alone leave open which of
    the inputs gives the unit.
    """
    units: dict[Dimension, str] = {}
    due: set[Dimension] = set()
    for signal, value in component.terms:
        source, found = book.scales[signal], dimension_of(value.expr, book.scope)
        if found in (None, PURE):
            units[source.dimension] = source.unit
            continue
        assert found is not None
        made = found * source.dimension
        if due and made not in due:
            raise PatchError(
                f"{value.what} is {quoted(to_text(value.expr))}, which makes it {in_words(made)}; "
                f"what it is added to is {in_words(min(due, key=str))}",
                value.place,
            )
        due.add(made)
    due = due or set(units)
    for key in ("threshold", "hysteresis"):
        if key not in component.values:
            continue
        value = component.values[key]
        found = dimension_of(value.expr, book.scope)
        if found not in (None, PURE, *due):
            wanted = " or ".join(sorted(in_words(d, units.get(d, "")) for d in due))
            raise PatchError(
                f"{value.what} is {quoted(to_text(value.expr))}; by the inputs that are compared it "
                f"must be {wanted}",
                value.place,
            )
        due = due if found in (None, PURE) else {found}


def _check_initial(book: Book, component: Component) -> None:
    """The signal that an integrator follows in IC is in its unit."""
    signal = component.initial_signal
    if signal and book.scales[signal].dimension != component.dimension:
        raise PatchError(
            f"initial of component {component.name!r} is the signal {signal!r}, which is "
            f"{in_words(book.scales[signal].dimension, book.scales[signal].unit)}; "
            f"it must be {in_words(component.dimension, component.unit)}",
            component.place,
        )


def _check_coefficient(book: Book, component: Component, signal: str, value: Value) -> None:
    """A coefficient turns the unit of its input into that of the component."""
    source = book.scales[signal]
    wanted, rate = component.dimension / source.dimension, ""
    if CATALOG[component.kind].per_second:
        wanted, rate = wanted / TIME, " per second"
    found = dimension_of(value.expr, book.scope)
    if found not in (None, PURE, wanted):
        raise PatchError(
            f"{value.what} is {quoted(to_text(value.expr))}; it turns {source.unit or 'a number'} into "
            f"{component.unit or 'a number'}{rate}, so it must be {in_words(wanted)}",
            value.place,
        )
