"""Eight nodes side by side as one vector of the processor, where loops over them would not become one.

Stage 4. A *lane* is a node's place in a row of eight, as `State.nodes` and `State.row` have them; rows
are C-contiguous arrays of eight float64. Each operation here takes whole rows of arrays by number, with
no check of bounds, and writes one row. LLVM is told of vectors directly: left to find them in scalar
code, it mostly does, but not after every change of what stands around it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending, types

LANES = 8

# To the type checker these take what the compiled code gives them, without the context of typing.
intrinsic: Callable[..., Any] = extending.intrinsic

_ROW = ir.VectorType(ir.DoubleType(), LANES)
# A product may be fused with the sum it goes into, as everywhere in the kernels.
_FUSED = ("contract",)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, row: Any) -> Any:
    """Address of row number `row`, the array taken for rows one after the other."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [builder.mul(row, row.type(LANES))])


def _load(builder: Any, pointer: Any) -> Any:
    return builder.load(builder.bitcast(pointer, _ROW.as_pointer()), align=8)


def _store(builder: Any, value: Any, pointer: Any) -> None:
    builder.store(value, builder.bitcast(pointer, _ROW.as_pointer()), align=8)


def _spread(builder: Any, value: Any) -> Any:
    """The same figure in every lane."""
    index = ir.IntType(32)
    one = builder.insert_element(ir.Constant(_ROW, ir.Undefined), value, index(0))
    every = ir.Constant(ir.VectorType(index, LANES), [index(0)] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_ROW, ir.Undefined), every)


def _add_product(builder: Any, total: Any, a: Any, b: Any) -> Any:
    return builder.fadd(total, builder.fmul(a, b, flags=_FUSED), flags=_FUSED)


def _add_up(builder: Any, value: Any) -> Any:
    """The sum of all lanes: halves, quarters, ..."""
    lanes = LANES
    while lanes > 1:
        lanes //= 2
        value = builder.fadd(*_halves(builder, value, lanes))
    return builder.extract_element(value, ir.IntType(32)(0))


def _halves(builder: Any, value: Any, lanes: int) -> list[Any]:
    """The lower and the upper half, of so many lanes each."""
    number = ir.IntType(32)
    return [
        builder.shuffle_vector(
            value,
            ir.Constant(value.type, ir.Undefined),
            ir.Constant(ir.VectorType(number, lanes), [number(start + k) for k in range(lanes)]),
        )
        for start in (0, lanes)
    ]


def _all_between(builder: Any, value: Any, low: Any, high: Any) -> Any:
    """Whether every lane is between these bounds; not where one is no number."""
    over = builder.fcmp_unordered(">", value, _spread(builder, high))
    under = builder.fcmp_unordered("<", value, _spread(builder, low))
    mask = builder.bitcast(builder.or_(over, under), ir.IntType(LANES))
    return builder.icmp_unsigned("==", mask, ir.IntType(LANES)(0))


def _rows(signature: Any, generate: Callable[..., None]) -> Any:
    """Signature and code generator of an operation that returns nothing."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        generate(context, builder, signature.args, arguments)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def fill(typing: Any, out: Any, row: Any, value: Any) -> Any:
    """out[row] = value in every lane."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        _store(
            builder, _spread(builder, given[2]), _pointer(context, builder, kinds[0], *given[:2])
        )

    return _rows(types.void(out, types.intp, types.float64), generate)


@intrinsic
def copy(typing: Any, out: Any, row: Any, source: Any, source_row: Any) -> Any:
    """out[row] = source[source_row]."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        value = _load(builder, _pointer(context, builder, kinds[2], *given[2:4]))
        _store(builder, value, _pointer(context, builder, kinds[0], *given[:2]))

    return _rows(types.void(out, types.intp, source, types.intp), generate)


@intrinsic
def add_scaled(typing: Any, out: Any, row: Any, factor: Any, source: Any, source_row: Any) -> Any:
    """out[row] += factor * source[source_row]."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        target = _pointer(context, builder, kinds[0], *given[:2])
        value = _load(builder, _pointer(context, builder, kinds[3], *given[3:5]))
        factor = _spread(builder, given[2])
        _store(builder, _add_product(builder, _load(builder, target), factor, value), target)

    return _rows(types.void(out, types.intp, types.float64, source, types.intp), generate)


@intrinsic
def multiply(typing: Any, out: Any, row: Any, source: Any, source_row: Any) -> Any:
    """out[row] *= source[source_row]."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        target = _pointer(context, builder, kinds[0], *given[:2])
        value = _load(builder, _pointer(context, builder, kinds[2], *given[2:4]))
        _store(builder, builder.fmul(_load(builder, target), value), target)

    return _rows(types.void(out, types.intp, source, types.intp), generate)


@intrinsic
def scale(typing: Any, out: Any, row: Any, factor: Any, offset: Any) -> Any:
    """out[row] = factor * out[row] + offset."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        target = _pointer(context, builder, kinds[0], *given[:2])
        factor, offset = (_spread(builder, figure) for figure in given[2:4])
        _store(builder, _add_product(builder, offset, factor, _load(builder, target)), target)

    return _rows(types.void(out, types.intp, types.float64, types.float64), generate)


@intrinsic
def combine(
    typing: Any,
    out: Any,
    row: Any,
    first: Any,
    first_row: Any,
    first_factor: Any,
    matrix: Any,
    matrix_row: Any,
    lead: Any,
    source: Any,
    source_row: Any,
) -> Any:
    """out[row] = first_factor * first[first_row] + lead * matrix[matrix_row]
    + the sum over lanes k of source[source_row, k] * matrix[matrix_row + 1 + k].

    `out` may be the source. In two sums, of even lanes and of odd ones: neither waits for the other.
    """

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        def row_at(k: int, beyond: int = 0) -> Any:
            at = builder.add(given[k + 1], given[k + 1].type(beyond))
            return _pointer(context, builder, kinds[k], given[k], at)

        even = builder.fmul(_spread(builder, given[4]), _load(builder, row_at(2)), flags=_FUSED)
        odd = builder.fmul(_spread(builder, given[7]), _load(builder, row_at(5)), flags=_FUSED)
        source = row_at(8)
        for k in range(LANES):
            x = builder.load(builder.gep(source, [ir.IntType(64)(k)]))
            weights = _load(builder, row_at(5, 1 + k))
            if k % 2 == 0:
                even = _add_product(builder, even, _spread(builder, x), weights)
            else:
                odd = _add_product(builder, odd, _spread(builder, x), weights)
        _store(builder, builder.fadd(even, odd, flags=_FUSED), row_at(0))

    place, figure = types.intp, types.float64
    return _rows(
        types.void(out, place, first, place, figure, matrix, place, figure, source, place), generate
    )


@intrinsic
def gather(
    typing: Any,
    out: Any,
    row: Any,
    constant: Any,
    gains: Any,
    source: Any,
    source_rows: Any,
    first: Any,
    end: Any,
) -> Any:
    """out[row] = constant + the sum over t from `first` to before `end` of gains[t] *
    source[source_rows[t]].
    """

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        total = _gathered(context, builder, kinds[3:6], given[3:6], given[2], *given[6:])
        _store(builder, total, _pointer(context, builder, kinds[0], *given[:2]))

    place, figure = types.intp, types.float64
    return _rows(types.void(out, place, figure, gains, source, source_rows, place, place), generate)


@intrinsic
def gather_product(
    typing: Any,
    out: Any,
    row: Any,
    offset: Any,
    constant: Any,
    other_constant: Any,
    gains: Any,
    source: Any,
    source_rows: Any,
    first: Any,
    middle: Any,
    end: Any,
) -> Any:
    """out[row] = offset + the product of two such sums, of terms up to before `middle` and `end`."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        arrays, (first, middle, end) = (kinds[5:8], given[5:8]), given[8:]
        one = _gathered(context, builder, *arrays, given[3], first, middle)
        other = _gathered(context, builder, *arrays, given[4], middle, end)
        total = _add_product(builder, _spread(builder, given[2]), one, other)
        _store(builder, total, _pointer(context, builder, kinds[0], *given[:2]))

    place, figure = types.intp, types.float64
    kinds = (figure, figure, figure, gains, source, source_rows, place, place, place)
    return _rows(types.void(out, place, *kinds), generate)


def _gathered(
    context: Any, builder: Any, kinds: Any, arrays: Any, constant: Any, first: Any, end: Any
) -> Any:
    """The sum of terms that `gather` stores; the first one stands by itself, as most are alone."""
    gains, rows = (context.make_array(kinds[k])(context, builder, arrays[k]).data for k in (0, 2))
    place = first.type

    def with_term(total: Any, term: Any) -> Any:
        gain = _spread(builder, builder.load(builder.gep(gains, [term])))
        row = builder.load(builder.gep(rows, [term]))
        value = _load(builder, _pointer(context, builder, kinds[1], arrays[1], row))
        return _add_product(builder, total, gain, value)

    start, before = _spread(builder, constant), builder.block
    single, loop, done = (builder.append_basic_block(name) for name in ("term", "terms", "done"))
    builder.cbranch(builder.icmp_signed("<", first, end), single, done)

    builder.position_at_end(single)
    one, second = with_term(start, first), builder.add(first, place(1))
    builder.cbranch(builder.icmp_signed("<", second, end), loop, done)

    builder.position_at_end(loop)
    term, total = builder.phi(place), builder.phi(_ROW)
    more, following = with_term(total, term), builder.add(term, place(1))
    for phi, begin, onward in ((term, second, following), (total, one, more)):
        phi.add_incoming(begin, single)
        phi.add_incoming(onward, loop)
    builder.cbranch(builder.icmp_signed("<", following, end), loop, done)

    builder.position_at_end(done)
    whole = builder.phi(_ROW)
    for value, block in ((start, before), (one, single), (more, loop)):
        whole.add_incoming(value, block)
    return whole


@intrinsic
def farther(
    typing: Any, out: Any, row: Any, factor: Any, a: Any, a_row: Any, b: Any, b_row: Any
) -> Any:
    """out[row] = the larger of itself and factor * |a[a_row] - b[b_row]|, lane by lane."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        target = _pointer(context, builder, kinds[0], *given[:2])
        left = _load(builder, _pointer(context, builder, kinds[3], *given[3:5]))
        right = _load(builder, _pointer(context, builder, kinds[5], *given[5:7]))
        apart, most = builder.fsub(left, right), _load(builder, target)
        below = builder.fcmp_ordered("<", apart, ir.Constant(_ROW, [0.0] * LANES))
        size = builder.select(below, builder.fneg(apart), apart)
        size = builder.fmul(size, _spread(builder, given[2]))
        more = builder.fcmp_unordered(">", size, most)  # also where it is no number
        _store(builder, builder.select(more, size, most), target)

    place = types.intp
    return _rows(types.void(out, place, types.float64, a, place, b, place), generate)


@intrinsic
def largest(typing: Any, a: Any, row: Any) -> Any:
    """Largest of a[row] over the lanes; no number where any of them is none."""

    def codegen(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        size = _load(builder, _pointer(context, builder, signature.args[0], *given))
        none = builder.bitcast(builder.fcmp_unordered("uno", size, size), ir.IntType(LANES))
        lanes = LANES
        while lanes > 1:  # the upper half against the lower one
            lanes //= 2
            halves = _halves(builder, size, lanes)
            size = builder.select(builder.fcmp_ordered(">", *halves), *halves)
        most = builder.extract_element(size, ir.IntType(32)(0))
        lost = builder.icmp_unsigned("!=", none, ir.IntType(LANES)(0))
        return builder.select(lost, ir.DoubleType()(float("nan")), most)

    return types.float64(a, types.intp), codegen


@intrinsic
def dot(typing: Any, a: Any, a_row: Any, b: Any, b_row: Any) -> Any:
    """The sum of a[a_row] * b[b_row] over the lanes."""

    def codegen(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kinds = signature.args
        left = _load(builder, _pointer(context, builder, kinds[0], *given[:2]))
        right = _load(builder, _pointer(context, builder, kinds[2], *given[2:4]))
        return _add_up(builder, builder.fmul(left, right))

    return types.float64(a, types.intp, b, types.intp), codegen


@intrinsic
def between(typing: Any, source: Any, row: Any, low: Any, high: Any) -> Any:
    """Whether every lane of source[row] is between these bounds; not where one is no number."""

    def codegen(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = _load(builder, _pointer(context, builder, signature.args[0], *given[:2]))
        return _all_between(builder, value, given[2], given[3])

    return types.boolean(source, types.intp, types.float64, types.float64), codegen


@intrinsic
def weigh(
    typing: Any,
    out: Any,
    row: Any,
    matrix: Any,
    matrix_row: Any,
    source: Any,
    first: Any,
    count: Any,
) -> Any:
    """out[row] = the sum over j < count of source[first + j] * matrix[matrix_row + j].

    `source` is taken as one line of figures. In two sums, of which neither waits for the other.
    """

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        weights = _pointer(context, builder, kinds[2], *given[2:4])
        line = context.make_array(kinds[4])(context, builder, given[4]).data
        line = builder.gep(line, [given[5]])
        count = given[6]
        place = count.type
        pairs = builder.lshr(count, place(1))

        def product(j: Any) -> tuple[Any, Any]:
            x = _spread(builder, builder.load(builder.gep(line, [j])))
            return x, _load(builder, builder.gep(weights, [builder.mul(j, place(LANES))]))

        zero = ir.Constant(_ROW, [0.0] * LANES)
        before, loop = builder.block, builder.append_basic_block("pairs")
        rest, odd_one, done = (builder.append_basic_block(name) for name in ("rest", "odd", "done"))
        builder.cbranch(builder.icmp_signed(">", pairs, place(0)), loop, rest)

        builder.position_at_end(loop)
        pair, even, odd = builder.phi(place), builder.phi(_ROW), builder.phi(_ROW)
        j = builder.shl(pair, place(1))
        more_even = _add_product(builder, even, *product(j))
        more_odd = _add_product(builder, odd, *product(builder.add(j, place(1))))
        following = builder.add(pair, place(1))
        for phi, start, onward in (
            (pair, place(0), following),
            (even, zero, more_even),
            (odd, zero, more_odd),
        ):
            phi.add_incoming(start, before)
            phi.add_incoming(onward, loop)
        builder.cbranch(builder.icmp_signed("<", following, pairs), loop, rest)

        builder.position_at_end(rest)
        total_even, total_odd = builder.phi(_ROW), builder.phi(_ROW)
        for phi, onward in ((total_even, more_even), (total_odd, more_odd)):
            phi.add_incoming(zero, before)
            phi.add_incoming(onward, loop)
        total = builder.fadd(total_even, total_odd)
        left = builder.and_(count, place(1))
        builder.cbranch(builder.icmp_signed("!=", left, place(0)), odd_one, done)

        builder.position_at_end(odd_one)
        last = _add_product(builder, total, *product(builder.sub(count, place(1))))
        builder.branch(done)

        builder.position_at_end(done)
        whole = builder.phi(_ROW)
        whole.add_incoming(total, rest)
        whole.add_incoming(last, odd_one)
        _store(builder, whole, _pointer(context, builder, kinds[0], *given[:2]))

    place = types.intp
    return _rows(types.void(out, place, matrix, place, source, place, place), generate)


@intrinsic
def change(typing: Any, out: Any, row: Any, kept: Any, by: Any) -> Any:
    """out[row] = kept[row] * out[row] + by[row]; whether every lane is then within +-1."""

    def codegen(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        out, row, kept, by = given
        kinds = signature.args
        target = _pointer(context, builder, kinds[0], out, row)
        factor = _load(builder, _pointer(context, builder, kinds[2], kept, row))
        step = _load(builder, _pointer(context, builder, kinds[3], by, row))
        value = _add_product(builder, step, factor, _load(builder, target))
        _store(builder, value, target)
        figure = ir.DoubleType()
        return _all_between(builder, value, figure(-1.0), figure(1.0))

    return types.boolean(out, types.intp, kept, by), codegen


@intrinsic
def larger(typing: Any, out: Any, row: Any, source: Any, source_row: Any) -> Any:
    """out[row] = the larger of itself and |source[source_row]|, lane by lane."""

    def generate(context: Any, builder: Any, kinds: Any, given: Any) -> None:
        target = _pointer(context, builder, kinds[0], *given[:2])
        value = _load(builder, _pointer(context, builder, kinds[2], *given[2:4]))
        below = builder.fcmp_ordered("<", value, ir.Constant(_ROW, [0.0] * LANES))
        size, most = builder.select(below, builder.fneg(value), value), _load(builder, target)
        more = builder.fcmp_ordered(">", size, most)
        _store(builder, builder.select(more, size, most), target)

    return _rows(types.void(out, types.intp, source, types.intp), generate)
