"""What crosses the sections: units agree from end to end of every cord."""

from __future__ import annotations

from hybrid.components import CATALOG
from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, quoted
from hybrid.expressions import to_text
from hybrid.fields import in_words
from hybrid.patch import Component, Dac, Program, Value
from hybrid.patchfile.book import Book
from hybrid.units import PURE, TIME


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
        for signal, value in component.terms:
            _check_coefficient(book, component, signal, value)
        _check_gain(book, component)
        _check_initial(book, component)
    dimensions = {a.word: a.dimension for a in program.assignments} if program else {}
    for dac in dacs:
        dimension = dimensions[dac.word]
        if dimension not in (None, PURE, dac.dimension):
            raise PatchError(
                f"DAC {dac.name!r} converts {dac.word!r}, which is {in_words(dimension or PURE)}; "
                f"by its full_scale it must be {in_words(dac.dimension, dac.unit)}",
                dac.place,
            )


def _check_gain(book: Book, component: Component) -> None:
    """The gain of a product or a quotient turns its unit into that of the component."""
    inputs = tuple(book.scales[signal].dimension for signal in component.signals)
    plain, gain = CATALOG[component.kind].result(inputs), component.values.get("gain")
    if plain is None:
        return
    wanted = component.dimension / plain
    found = dimension_of(gain.expr, book.scope) if gain else PURE
    if found not in (None, PURE, wanted):
        raise PatchError(
            f"gain of component {component.name!r} must be {in_words(wanted)}: without it the result "
            f"is in {plain}, and full_scale is in {component.dimension}",
            component.place,
        )


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
