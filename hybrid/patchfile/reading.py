"""A whole patch: the file, then its sections in the order in which each needs the ones before."""

from __future__ import annotations

import os

from hybrid.errors import PatchError, Place, shown
from hybrid.fields import Fields
from hybrid.language import TOP_KEYS
from hybrid.patch import Component, Dac, Patch, Value
from hybrid.patchfile.analog import read_components, read_machine, read_time_scale
from hybrid.patchfile.book import Book
from hybrid.patchfile.connections import WordInputs, check_inputs, check_signals
from hybrid.patchfile.cords import check_cords
from hybrid.patchfile.interface import read_adcs, read_dacs
from hybrid.patchfile.leads import with_leads
from hybrid.patchfile.models import read_models
from hybrid.patchfile.outcome import read_modes, read_readouts, read_record, read_run
from hybrid.patchfile.parameters import read_parameters
from hybrid.patchfile.parts import expand
from hybrid.patchfile.placing import Placement, told_from
from hybrid.patchfile.program import read_full_scales, read_program, usual_habits
from hybrid.patchfile.shownunits import with_units_of_dacs
from hybrid.patchfile.source import name_of, read_text, short
from hybrid.patchfile.tables import read_tables
from hybrid.patchfile.tasktimes import with_task_times
from hybrid.patchfile.transfer import Orders, transferred
from hybrid.shipped import find_patch
from hybrid.yamltree import read_yaml


def read_patch(source: str | os.PathLike[str], on: Placement = None) -> Patch:
    """Read and validate the patch file at `source`, or the shipped patch of that name.

    on: the machine that all of it is to run on, "analog" or "digital", or what is to run where, by
    the names of parts, signals and words: {"body": "digital"}.
    Raises PatchError for a file that cannot be read or a patch that is wrong in any way.
    """
    if not isinstance(source, str | os.PathLike) or isinstance(os.fspath(source), bytes):
        raise PatchError(
            f"{shown(source)} is no patch; give a patch file or the name of a patch that ships"
        )
    if not os.fspath(source).strip():
        raise PatchError(
            "the name of the patch is empty; give a patch file or the name of a patch that ships"
        )
    path = find_patch(os.fspath(source))
    name = name_of(path)
    return parse_patch(read_text(path, Place(short(name))), name, on)


def parse_patch(text: str, file: str = "<text>", on: Placement = None) -> Patch:
    """Validate a patch given as YAML text; `file` is the name used in messages, `on` as above."""
    outside = told_from(on)
    whole = read_yaml(text, file)
    top = Fields(whole, "the patch", TOP_KEYS, {})
    title, description = top.line("title"), top.text("description", "")
    flat = expand(whole, file)
    book = Book(flat.root, may_lack_words=bool(flat.told or outside))
    check_inputs(book, flat.connections)
    parameters = read_parameters(book, flat.settings)
    book.tables.update(read_tables(book))
    read_models(book)
    machine = read_machine(book)
    components = read_components(book)
    dacs = read_dacs(book)
    adcs = read_adcs(book)
    program = read_program(book, WordInputs(book, flat.connections))
    parameters, program = with_task_times(book, parameters, program)
    check_signals(book, flat.connections)
    check_cords(book, components, dacs, program)
    full_scales = read_full_scales(book, program)
    patch = Patch(
        title,
        description,
        file,
        "".join((text, *flat.texts)),
        machine,
        parameters,
        components,
        adcs,
        dacs,
        program,
        read_run(book),
        read_record(book),
        read_readouts(book),
        read_modes(book),
        read_time_scale(book),
        book.files.hashes,
        models=tuple(use.model for use in book.models.values()),
    )
    _try_numbers(patch, [scale.value for scale in full_scales.values()])
    habits = usual_habits(book)
    orders = Orders(flat.told, outside, flat.parts, habits, flat.homes, full_scales)
    return with_leads(transferred(with_units_of_dacs(patch), orders))


def _try_numbers(patch: Patch, others: list[Value]) -> None:
    """Evaluate every number once with the default parameters, so that mistakes show at once."""
    scope = patch.bind()
    for value in _numbers(patch) + others:
        value.number(scope)
    for readout in patch.readouts:
        start, end = readout.start, readout.end
        if start and end and start.number(scope) >= end.number(scope):
            raise PatchError(f"{start.what} must be before its until", start.place)


def _numbers(patch: Patch) -> list[Value]:
    found = [*patch.machine.errors.values()]
    parts: list[Component | Dac] = [*patch.components, *patch.dacs]
    for part in parts:
        found += [part.full_scale, *part.errors.values()]
    for component in patch.components:
        found += [*component.values.values(), *(value for _, value in component.terms)]
        found += [value for point in component.points for value in point]
    optional = [patch.run.until, patch.run.every, *(dac.initial for dac in patch.dacs)]
    optional += [dac.lead for dac in patch.dacs]
    optional += [patch.time_scale, patch.machine.pot_resolution]
    for adc in patch.adcs:
        optional += [adc.range, adc.conversion_time]
    if patch.program:
        program = patch.program
        optional += [program.period, program.compute_time, program.skew, *program.remember.values()]
        optional += [state.initial for state in program.states]
        optional += [length.full_scale for length in (program.word, *program.lengths.values())]
        optional += program.processor.times.values() if program.processor else ()
        for task in program.tasks:
            optional += [task.period, task.phase, task.compute_time, task.jitter]
    for readout in patch.readouts:
        optional += [readout.start, readout.end]
    if patch.modes:
        optional += [patch.modes.reset, patch.modes.operate, patch.modes.hold]
    return found + [value for value in optional if value]
