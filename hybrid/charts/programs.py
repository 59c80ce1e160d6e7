"""The digital machine on the patch diagram: a box for its program, or one for each of its tasks.

A box tells its clock, or the comparator that starts it, and its words with their arithmetic, of states
the rate, over several lines where it is long, and what resets them. Cords come from the ADCs and the
words of other tasks that it reads, at its left, each by its name in a column of their own, and leave
from the words that go to DACs and to other tasks, at their line. What starts a task comes in at its
head.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import escape

from hybrid.charts import style
from hybrid.charts.layered import Box, Cord
from hybrid.charts.symbols import TINT, line, printable, tag, text_width, words
from hybrid.errors import counted
from hybrid.expressions import Name, Number, to_text
from hybrid.patch import Assignment, Dac, Patch, Program, State, Task
from hybrid.tasks import ranks_of, read_by, task_of_adc, task_of_dac
from hybrid.wordlength import Kind

PROGRAM = "digital program"  # no signal can have a blank in its name
NAME_SIZE, SMALL_SIZE, SHOWN_SIZE = 11.0, 9.0, 10.0
ROW = 17.0
HEAD = 44.0
LEFT = 22.0  # from the box's edge to its text
INDENT = 14.0  # of a further line of the same word
MOST_WORDS = 40  # of a box; those at which a cord begins are always shown
LONGEST_EXPRESSION = 44
MOST_LINES = 4  # of the rate of a state
CUT = 8.0  # what it costs the layout to run a word back to the left


@dataclass(frozen=True)
class Row:
    """One line of a word as it is written: what does not fit is cut off. A further line of the same word
    has no `word`."""

    word: str
    shown: str
    whole: str


@dataclass(frozen=True)
class ProgramBox:
    """One program with its text; the first of its cords is what starts it, where `started`."""

    box: Box
    title: str
    told: str
    rows: tuple[Row, ...]
    more: str
    cords: tuple[Cord, ...]
    started: bool = False
    labels_width: float = 0.0  # room for the names of what comes in; 0: nothing does


def program_boxes(patch: Patch, scope: Mapping[str, float]) -> tuple[ProgramBox, ...]:
    """The box of the one program, or of every task by name; none without a digital machine."""
    program = patch.program
    if program is None:
        return ()
    if not program.tasks:
        cords = [Cord(adc.name, adc.name, PROGRAM, i) for i, adc in enumerate(patch.adcs)]
        driving = {dac.word for dac in patch.dacs}
        return (_program_box(PROGRAM, program, _clock_text(program, scope), cords, driving),)
    read = [read_by(single) for single in program.programs]
    served = adcs_served(patch, scope)
    boxes = []
    for number, (task, single) in enumerate(zip(program.tasks, program.programs, strict=True)):
        others = frozenset().union(*read[:number], *read[number + 1 :])
        sent = {dac.word for dac in patch.dacs} | others
        sampled = [name for name, task_ in served.items() if task_ == task.name]
        # One that nobody reads belongs to the task that samples it.
        idle = set(sampled) - frozenset().union(*read)
        taken = [adc.name for adc in patch.adcs if adc.name in read[number] | idle]
        ends = (
            [(task.when[0], task.when[0])] if task.when else []
        )  # box and port that each begins at
        ends += [(name, name) for name in taken]
        ends += [
            (box_name(other), word)
            for other, its in zip(program.tasks, program.programs, strict=True)
            if other is not task
            for word in its.words
            if word in read[number]
        ]
        name = box_name(task)
        placed = [Cord(source, port, name, place) for place, (source, port) in enumerate(ends)]
        told = _task_text(task, single, scope)
        boxes.append(_program_box(name, single, told, placed, sent, task))
    return tuple(boxes)


def box_name(task: Task) -> str:
    """What the box of a task is called on the sheet."""
    return f"task {task.name}"


def adcs_served(patch: Patch, scope: Mapping[str, float]) -> dict[str, str]:
    """ADC -> the task whose clock samples it; empty without tasks."""
    program = patch.program
    if program is None or not program.tasks:
        return {}
    ranks = ranks_of(program, scope)
    return {a.name: program.tasks[task_of_adc(a, program, ranks)].name for a in patch.adcs}


def sender_of(dac: Dac, program: Program | None) -> str:
    """The task at whose end a DAC shows its word; '' without tasks."""
    if program is None or not program.tasks:
        return ""
    return program.tasks[task_of_dac(dac, program)].name


# -- what is written in a box ----------------------------------------------------------------------


def _program_box(
    name: str,
    program: Program,
    told: str,
    cords: list[Cord],
    sent: Collection[str],
    task: Task | None = None,
) -> ProgramBox:
    rows = _rows(program, sent)
    left_out = len(program.words) - sum(bool(row.word) for row in rows)
    more = f"and {counted(left_out, 'more word')}" if left_out else ""
    title = task.name if task else "DIGITAL PROGRAM"
    started = bool(task and task.when)
    taken = cords[started:]
    labels = [text_width(cord.port, SMALL_SIZE) for cord in taken]
    labels_width = max(labels, default=0.0) + 16 if labels else 0.0
    widths = [labels_width + _row_width(row) for row in rows]
    widths += [labels_width + text_width(more, SMALL_SIZE), text_width(told, SMALL_SIZE)]
    widths.append(text_width(title, SHOWN_SIZE, bold=True))
    lines = max(len(rows) + bool(more), len(taken))

    def middle(place: int) -> float:
        return float(round(HEAD + ROW * (place + 0.5)))

    box = Box(
        name,
        float(round(max(widths) + 2 * LEFT)),
        HEAD + ROW * lines + 10,
        (*([15.0] if started else []), *map(middle, range(len(taken)))),
        {row.word: middle(place) for place, row in enumerate(rows) if row.word in sent},
        any_order=True,
        cut=CUT,
        fixed_ins=int(started),
    )
    return ProgramBox(box, title, told, rows, more, tuple(cords), started, labels_width)


def _rows(program: Program, sent: Collection[str]) -> tuple[Row, ...]:
    """The words that are shown, in the order in which they are computed."""
    telling = sorted(program.written, key=lambda entry: _weight(entry, sent))  # keeps order
    telling = telling[: max(MOST_WORDS, sum(entry.word in sent for entry in telling))]
    # Hidden words are left out, but for those that a cord begins at.
    kept = {entry.word for entry in telling if not entry.hidden or entry.word in sent}
    return tuple(row for entry in program.written if entry.word in kept for row in _rows_of(entry))


def _rows_of(entry: Assignment | State) -> list[Row]:
    """The lines of a word: one, and of a state as many as its rate takes, and what resets it."""
    whole = to_text(entry.expr)
    if not isinstance(entry, State):
        return [Row(entry.word, f"= {_cut(_for_the_eye(whole))}", f"{entry.word} = {whole}")]
    whole = f"∫ {whole}" if isinstance(entry.expr, Name) else f"∫ ({whole})"
    told = f"{entry.word} = {whole}"
    lines = textwrap.wrap(_for_the_eye(whole), LONGEST_EXPRESSION, break_on_hyphens=False)
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 1], _cut(" ".join(lines[MOST_LINES - 1 :]))]
    first, *further = map(_cut, lines)
    if entry.reset_when and entry.reset_to:
        value, when = to_text(entry.reset_to), to_text(entry.reset_when)
        told += f", reset to {value} when {when}"
        further += [_cut(_for_the_eye(f"→ {value} when {when}"))]
    return [Row(entry.word, f"= {first}", told), *(Row("", line_, told) for line_ in further)]


def _for_the_eye(text: str) -> str:
    return text.replace("**", "^").replace("*", "·").replace("-", "−")


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST_EXPRESSION else text[: LONGEST_EXPRESSION - 1] + "…"


def _row_width(row: Row) -> float:
    if not row.word:
        return INDENT + text_width(row.shown, SHOWN_SIZE)
    return text_width(row.word, NAME_SIZE, bold=True) + text_width(f" {row.shown}", SHOWN_SIZE)


def _weight(entry: Assignment | State, sent: Collection[str]) -> int:
    """How little a word tells: least those of a model's file, then copies and numbers."""
    if entry.word in sent:
        return 0
    if isinstance(entry, State):
        return 1
    return 4 if entry.hidden else 3 if isinstance(entry.expr, Name | Number) else 2


def _clock_text(program: Program, scope: Mapping[str, float]) -> str:
    """The clock of the one program."""
    if program.period is None:
        return "no clock"
    told = [f"T = {style.duration(program.period.number(scope))}"]
    if program.counted:
        told.append("compute counted")
    elif program.compute_time is not None:
        told.append(f"compute {style.duration(program.compute_time.number(scope))}")
    return ",  ".join([*told, *_word_text(program, scope)])


def _task_text(task: Task, program: Program, scope: Mapping[str, float]) -> str:
    """What starts a task, how long it computes, and in which word length."""
    if task.when:
        told = [" ".join(("when", *task.when))]
    else:
        assert task.period is not None
        told = [f"every {style.duration(task.period.number(scope))}"]
    for what, value in (("phase", task.phase), ("jitter", task.jitter)):
        if value is not None and value.number(scope):
            told.append(f"{what} {style.duration(value.number(scope))}")
    spent = "counted"
    if task.compute_time is not None:
        spent = style.duration(task.compute_time.number(scope))
    return ",  ".join([*told, f"compute {spent}", *_word_text(program, scope)])


def _word_text(program: Program, scope: Mapping[str, float]) -> list[str]:
    """The word length, where all words have the same and it is not that of a double."""
    found = {program.lengths.get(word, program.word).bound(scope) for word in program.words}
    return [one.text for one in found if len(found) == 1 and one.kind is not Kind.DOUBLE]


# -- drawing ---------------------------------------------------------------------------------------


def drawn(program: ProgramBox, came: Mapping[int, str]) -> str:
    """The box as SVG, its top left corner at the origin.

    came: which word came to which of its ins.
    """
    width, height = program.box.width, program.box.height
    inner = [
        tag(
            "rect",
            x=0,
            y=0,
            width=width,
            height=height,
            rx=3,
            fill=TINT,
            stroke=style.INK,
            stroke_width=1.6,
        ),
        words(LEFT, 15, program.title, SHOWN_SIZE, anchor="start", bold=True, color=style.PENS[3]),
        _small(LEFT, 30, program.told),
        line((0, 40), (width, 40), stroke=style.FRAME, stroke_width=1.0),
    ]
    x = LEFT + program.labels_width
    if program.labels_width:
        inner.append(line((x - 8, 40), (x - 8, height), stroke=style.FRAME, stroke_width=1.0))
    for place, row in enumerate(program.rows):
        inner.append(_written(row, x, HEAD + ROW * (place + 0.5)))
    if program.more:
        inner.append(_small(x, HEAD + ROW * (len(program.rows) + 0.5), program.more))
    for place, y in enumerate(program.box.ins):
        starts = program.started and place == 0
        inner.append(line((2, y - 4), (8, y), (2, y + 4), stroke_width=2.0 if starts else 1.2))
        if program.labels_width and not starts:
            inner.append(_small(LEFT - 10, y, came[place]))
    for y in program.box.outs.values():
        inner.append(line((width - 8, y - 4), (width - 2, y), (width - 8, y + 4)))
    return "".join(inner)


def _small(x: float, y: float, text: str) -> str:
    return words(x, y, text, SMALL_SIZE, anchor="start", color=style.MUTED)


def _written(row: Row, x: float, y: float) -> str:
    if row.word:
        text = tag("tspan", row.word, font_weight="bold", data_signal=row.word)
        text += tag("tspan", escape(printable(f" {row.shown}")), font_size=SHOWN_SIZE)
    else:
        text, x = tag("tspan", escape(printable(row.shown)), font_size=SHOWN_SIZE), x + INDENT
    tip = tag("title", escape(printable(row.whole)))
    return tag("text", tip + text, x=x, y=y + 4, font_size=NAME_SIZE, fill=style.INK)
