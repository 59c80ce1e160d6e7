"""Patch diagrams: all is drawn once, nothing lies over anything else, the same bytes each time."""

import itertools
import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import pytest
from large_patch import large_patch

from hybrid.charts.diagram import draw
from hybrid.charts.drawing import svg
from hybrid.charts.layered import Box, Cord, lay_out
from hybrid.charts.modebox import MODES
from hybrid.charts.programs import MOST_WORDS, PROGRAM, box_name
from hybrid.charts.sheet import Sheet
from hybrid.charts.symbols import SYMBOLS, Field, text_width
from hybrid.cli import main
from hybrid.components import CATALOG
from hybrid.errors import PatchError
from hybrid.expressions import names
from hybrid.patchfile import parse_patch, read_patch
from hybrid.shipped import shipped_patches

SVG = "{http://www.w3.org/2000/svg}"
VAN_DER_POL = """
title: Van der Pol
parameters: {mu: 1, rate: 1000 1/s}
analog:
  x: {integrate: {y: rate}, initial: 0.1, full_scale: 2.5}
  y: {integrate: {x: -rate, damp: rate*mu, y: rate*mu}, initial: 0, full_scale: 5}
  square: {multiply: [x, x], full_scale: 6.25}
  damp: {multiply: [square, y], gain: -1, full_scale: 31.25}
run: {until: 100 ms, every: 1 ms}
"""
LONE = "title: Alone\nanalog: {a: {constant: 1, full_scale: 1}}\nrun: {until: 1 s, every: 1 ms}\n"
CAUGHT = """
title: Caught
machine: ideal
parameters: {edge: 0.5}
analog:
  x: {integrate: {v: 1}, initial: 0, full_scale: 1}
  v: {integrate: {push: 1}, initial: 0.2, full_scale: 1}
  line: {constant: edge, full_scale: 1}
  beyond: {compare: {x: 1, line: -1}, low: 0, high: 1, full_scale: 1}
interface:
  x_sample: {adc: x, bits: 14}
  v_sample: {adc: v, bits: 14, task: keeper}
  idle: {adc: v, bits: 14}
  push: {dac: thrust, bits: 14, full_scale: 1, initial: 0, transfer: watch}
  lamp: {dac: lit, bits: 8, full_scale: 1, initial: 0}
digital:
  tasks:
    catch:
      when: beyond rises
      compute_time: 0.2 ms
      program: {thrust: -2*x_sample*count, lit: 1 - previous(lit), count: previous(count) + 1}
    watch:
      period: 10 ms
      phase: 1 ms
      compute_time: 1 ms
      program: {seen: count + x_sample, speed: v_sample*0.5}
    keeper:
      period: 20 ms
      jitter: 50 us
      compute_time: 2 ms
      word: float32
      program: {kept: seen + speed + count, further: kept*2 + x_sample}
  remember: {count: 0, lit: 0}
run: {until: 4 s, every: 10 ms}
"""


MODES_BY_ALL = """
title: Modes
machine: ideal
parameters: {rest: 5 ms}
analog:
  t: {ramp: 10 K/s, before: 273 K, full_scale: 400 K}
  s: {ramp: 2 m/s^2, full_scale: 1 m/s}
  x: {integrate: {t: 1}, initial: 0 K*s, full_scale: 100 K*s}
  half: {coefficient: {x: 0.5}, full_scale: 100 K*s}
  far: {compare: {x: 1}, threshold: 1 K*s, high: 1, full_scale: 1}
  late: {compare: {t: 1}, threshold: 290 K, high: 1, full_scale: 1}
  one: {track: x, control: operating, full_scale: 100 K*s}
  other: {track: one, control: holding, full_scale: 100 K*s}
modes: {reset: 1 ms, operate: 20 ms, hold: rest, operations: 4, reset_when: far, hold_when: late}
run: {until: 60 ms, every: 0.1 ms, on_overload: hold}
"""


def _many_words(count):
    """Three tasks of many words with long names, each of which reads some of the others'."""
    tasks, names_of = [], ("guidance", "attitude_and_rate", "display_of_everything")
    for place, task in enumerate(names_of):
        other = names_of[place - 1]
        lines = [f"        {task}_word_{i}: {0.5 + i} * sample + {i}" for i in range(count)]
        lines += [
            f"        {task}_taken_{i}: {task}_word_{i} + {other}_word_{3 * i}"
            for i in range(count // 5)
        ]
        period = f"      period: {2 + place} ms\n      compute_time: 0.1 ms\n      program:\n"
        tasks.append(f"    {task}:\n{period}" + "\n".join(lines))
    return (
        "title: Many words\nanalog:\n  x: {integrate: {out: 1}, initial: 0, full_scale: 1}\n"
        "interface:\n  sample: {adc: x}\n"
        "  out: {dac: guidance_word_0, full_scale: 1, initial: 0}\n"
        "digital:\n  tasks:\n" + "\n".join(tasks) + "\nrun: {until: 1 s}\n"
    )


TEXTS = {
    **{name: path.read_text(encoding="utf-8") for name, path in shipped_patches().items()},
    "van der pol": VAN_DER_POL,
    "lone": LONE,
    "caught": CAUGHT,
    "modes": MODES_BY_ALL,
    "many words": _many_words(60),
    **{f"large {n}, {seed}": large_patch(n, seed) for n, seed in ((60, 1), (60, 2), (25, 3))},
}


@pytest.fixture(scope="module", params=list(TEXTS))
def drawn(request):
    """Sheet, plan and parsed SVG of a patch."""
    patch = parse_patch(TEXTS[request.param])
    sheet = Sheet(patch, patch.bind())
    plan = lay_out(sheet.boxes, sheet.cords)
    return sheet, plan, ET.fromstring(svg(sheet, plan))


def _meet(one, other, slack=0.0):
    return (
        one[0] < other[2] - slack
        and other[0] < one[2] - slack
        and one[1] < other[3] - slack
        and other[1] < one[3] - slack
    )


def _pieces(plan):
    """Every straight piece of every cord, with its net."""
    for route in plan.routes:
        for (ax, ay), (bx, by) in itertools.pairwise(route.points):
            box = (min(ax, bx), min(ay, by), max(ax, bx), max(ay, by))
            yield route.cord, box


def _cords_to_programs(patch):
    """What a program takes: all that is sampled; a task what it reads and what starts it."""
    program = patch.program
    if program is None or not program.tasks:
        return [f"{adc.name}>{PROGRAM}" for adc in patch.adcs]
    due = []
    for task, single in zip(program.tasks, program.programs, strict=True):
        read = frozenset().union(*(names(expr) for e in single.written for expr in e.reads))
        others = set(program.words) - set(single.words)
        taken = read & (others | {adc.name for adc in patch.adcs})
        taken |= {adc.name for adc in patch.adcs if adc.name == "idle" and task.name == "watch"}
        due += [f"{name}>{box_name(task)}" for name in taken]
        due += [f"{task.when[0]}>{box_name(task)}"] if task.when else []
    return due


class TestWhatIsDrawn:
    def test_every_kind_has_a_symbol_of_its_own(self):
        assert set(CATALOG) | {"adc", "dac"} <= set(SYMBOLS)
        looks = [s.draw(Field(46.0, 46.0, (10.0, 36.0))) for s in SYMBOLS.values()]
        for look in looks:
            ET.fromstring(f"<g>{look}</g>")
        assert len(set(looks)) == len(looks)

    def test_every_signal_stands_once(self, drawn):
        sheet, _, root = drawn
        found = Counter(e.get("data-signal") for e in root.iter() if e.get("data-signal"))
        # What a DAC shows ahead of its word is no signal, but drives the DAC.
        due = Counter({*sheet.patch.signals, *(dac.word for dac in sheet.patch.dacs)})
        if sheet.patch.program and len(sheet.patch.program.words) > MOST_WORDS:
            left_out = due - found
            assert len(found) >= MOST_WORDS and set(left_out) <= set(sheet.patch.program.words)
            assert not set(left_out) & {dac.word for dac in sheet.patch.dacs}
            due -= left_out
        assert found == due

    def test_the_name_is_written_beside_its_symbol(self, drawn):
        _, _, root = drawn
        for element in root.iter(f"{SVG}text"):
            if element.get("data-signal"):
                assert "".join(element.itertext()) == element.get("data-signal")

    def test_every_cord_is_drawn_once(self, drawn):
        sheet, _, root = drawn
        patch = sheet.patch
        due = Counter()
        for component in patch.components:
            # What is taken zero times needs no cord.
            terms = [s for s, gain in component.terms if gain.number(sheet.scope)]
            reads = terms + list(component.signals)
            reads += {component.initial_signal, *component.controls} & set(patch.signals)
            due.update(f"{source}>{component.name}" for source in reads)
        due.update(f"{adc.source}>{adc.name}" for adc in patch.adcs)
        due.update(_cords_to_programs(patch))
        due.update(f"{dac.word}>{dac.name}" for dac in patch.dacs)
        if patch.modes:
            setting = filter(None, (patch.modes.reset_when, patch.modes.hold_when))
            due.update(f"{source}>{MODES}" for source in setting)
        assert Counter(e.get("data-cord") for e in root.iter() if e.get("data-cord")) == due

    def test_coefficients_other_than_1_are_on_the_cords(self):
        texts = _texts(draw(parse_patch(VAN_DER_POL)))
        assert texts.count("1000") == 3 and texts.count("−1000") == 1 and "1" not in texts

    def test_parameters_change_the_figures(self):
        patch = parse_patch(VAN_DER_POL)
        assert "2000" in _texts(draw(patch, {"rate": 2000.0}))
        with pytest.raises(PatchError, match="did you mean 'rate'"):
            draw(patch, {"rat": 1.0})

    def test_figures_are_in_the_units_shown(self):
        patch = parse_patch(
            "title: Degrees\nanalog:\n"
            "  a: {constant: 90 deg, full_scale: 180 deg}\n"
            "  b: {sum: {a: 2}, full_scale: 4 rad}\nrun: {until: 1 s, every: 1 ms}\n"
        )
        texts = _texts(draw(patch))
        assert "= 90 deg" in texts and "±180 deg" in texts and "0.03491" in texts

    def test_initial_value_full_scale_and_clock_are_told(self, pitch_loop):
        texts = " | ".join(_texts(draw(pitch_loop)))
        assert "0.1 rad" in texts and "±10 rad/s" in texts and "T = 1 ms" in texts

    def test_a_title_in_any_letters_is_well_formed(self):
        patch = parse_patch(LONE.replace("Alone", "\"<a> & 'b' ]]> 運\""))
        assert "<a> & 'b' ]]> 運" in _texts(draw(patch))

    def test_a_notebook_shows_it(self, pitch_loop):
        assert draw(pitch_loop)._repr_svg_().startswith("<svg ")


def _texts(svg):
    return ["".join(e.itertext()) for e in ET.fromstring(svg).iter(f"{SVG}text")]


class TestTasks:
    def test_a_box_for_each_with_its_clock_or_what_starts_it(self):
        texts = _texts(draw(parse_patch(CAUGHT), {"edge": 0.25}))
        assert {"catch", "watch", "keeper"} <= set(texts) and "DIGITAL PROGRAM" not in texts
        assert "when beyond rises,  compute 200 µs" in texts
        assert "every 10 ms,  phase 1 ms,  compute 1 ms" in texts
        assert "every 20 ms,  jitter 50 µs,  compute 2 ms,  float32" in texts

    def test_who_samples_and_who_sends(self):
        """An ADC goes to who names it, to the first that has a clock, or to the first of all; a DAC to
        its word's task or the one it waits for."""
        sheet = Sheet(patch := parse_patch(CAUGHT), patch.bind())
        told = {name: sheet.parts[name].below[-1] for name in ("x_sample", "v_sample", "idle")}
        assert told == {
            "x_sample": "sampled by watch",
            "v_sample": "sampled by keeper",
            "idle": "sampled by watch",
        }
        assert [sheet.parts[n].below[-1] for n in ("push", "lamp")] == [
            "sent by watch",
            "sent by catch",
        ]

    def test_what_starts_a_task_comes_in_at_its_head(self, drawn):
        sheet, plan, _ = drawn
        starts = {
            box_name(task): task.when[0]
            for task in (sheet.patch.program.tasks if sheet.patch.program else ())
            if task.when
        }
        found = {}
        for route in plan.routes:
            if route.cord.target in sheet.programs and route.points[-1][1] == (
                plan.places[route.cord.target][1] + 15
            ):
                found[route.cord.target] = route.cord.port
        assert found == starts

    def test_each_in_is_named_after_what_comes_to_it(self, drawn):
        sheet, plan, root = drawn
        written = {(round(x, 1), round(y, 1)): text for text, x, y, *_ in _written(root)}
        left = _moved(root.find(f"{SVG}g"))[0]
        for route in plan.routes:
            box = sheet.programs.get(route.cord.target)
            if box is None or not box.labels_width or (box.started and route.place == 0):
                continue
            x, y = plan.places[route.cord.target]
            at = x + left + 12, y + 78 + box.box.ins[route.place] + 0.36 * 9
            assert written[round(at[0], 1), round(at[1], 1)] == route.cord.port


def _moved(element):
    found = re.fullmatch(r"translate\((\S+) (\S+)\)", element.get("transform", ""))
    return (float(found[1]), float(found[2])) if found else (0.0, 0.0)


def _written(root):
    """Every line of text: itself, the x and y it is at, its left, top, right and bottom."""

    def walk(element, x, y):
        dx, dy = _moved(element)
        x, y = x + dx, y + dy
        if element.tag == f"{SVG}text":
            yield from lines(element, x, y)
        for child in element:
            yield from walk(child, x, y)

    def lines(element, x, y):
        size, at = float(element.get("font-size")), float(element.get("x"))
        bold, base = element.get("font-weight") == "bold", float(element.get("y"))
        pieces = [[(element.text or "", size, bold)]]
        for span in element.findall(f"{SVG}tspan"):
            if span.get("x"):  # a new line
                pieces.append([])
            its = float(span.get("font-size", size)), span.get("font-weight") == "bold" or bold
            pieces[-1].append((span.text, *its))
        for place, line in enumerate(filter(any, [[p for p in its if p[0]] for its in pieces])):
            width = sum(text_width(*piece) for piece in line)
            left = x + at - width * {"middle": 0.5, "end": 1.0}.get(element.get("text-anchor"), 0.0)
            lower = y + base + 12.0 * place
            # Letters without tails and accents, whose rows may touch.
            box = left, lower - 0.72 * size, left + width, lower
            yield ("".join(piece[0] for piece in line), x + at, y + base, *box)

    yield from walk(root, 0.0, 0.0)


class TestRoom:
    def test_no_two_texts_lie_upon_each_other(self, drawn):
        *_, root = drawn
        found = list(_written(root))
        for one, other in itertools.combinations(found, 2):
            assert not _meet(one[3:], other[3:], 0.01), f"{one[0]} lies upon {other[0]}"

    def test_what_a_program_says_stays_within_its_box(self, drawn):
        sheet, plan, root = drawn
        left = _moved(root.find(f"{SVG}g"))[0]
        for name, program in sheet.programs.items():
            x, y = plan.places[name][0] + left, plan.places[name][1] + 78
            within = (x, y, x + program.box.width, y + program.box.height)
            texts = [text for text in _written(root) if _meet(text[3:], within)]
            assert len(texts) >= 2 + len(program.rows)
            for text in texts:
                assert text[3] > within[0] and text[5] < within[2] and text[6] < within[3], text

    def test_nothing_lies_over_anything_else(self, drawn):
        sheet, plan, _ = drawn
        for one, other in itertools.combinations(list(sheet.outlines(plan)), 2):
            assert not _meet(one[2], other[2], 0.01), f"{one} lies over {other}"

    def test_no_cord_passes_under_a_symbol_or_a_text(self, drawn):
        sheet, plan, _ = drawn
        outlines = list(sheet.outlines(plan))
        for cord, piece in _pieces(plan):
            for name, what, outline in outlines:
                if what == "coefficient":  # where its own cord ends
                    assert cord.target == name or not _meet(piece, outline), (cord, name)
                else:
                    assert not _meet(piece, outline), f"{cord} passes under the {what} of {name}"

    def test_no_two_nets_run_along_one_line(self, drawn):
        _, plan, _ = drawn
        pieces = [(cord.net, piece) for cord, piece in _pieces(plan)]
        for (net, a), (other, b) in itertools.combinations(pieces, 2):
            if net == other:
                continue
            level = a[1] == a[3] and b[1] == b[3] and abs(a[1] - b[1]) < 3
            upright = a[0] == a[2] and b[0] == b[2] and abs(a[0] - b[0]) < 3
            beside = a[0] < b[2] and b[0] < a[2] if level else a[1] < b[3] and b[1] < a[3]
            assert not ((level or upright) and beside), f"{net} runs along {other}"

    def test_cords_end_at_their_boxes_and_turn_squarely(self, drawn):
        sheet, plan, _ = drawn
        for route in plan.routes:
            source, target = sheet.parts[route.cord.source], sheet.parts[route.cord.target]
            x, y = plan.places[source.box.name]
            assert route.points[0] == (x + source.box.width, y + source.box.outs[route.cord.port])
            x, y = plan.places[target.box.name]
            assert route.points[-1] == (x, y + target.box.ins[route.place])
            for (ax, ay), (bx, by) in itertools.pairwise(route.points):
                assert (ax == bx) != (ay == by)

    def test_everything_is_on_the_sheet(self, drawn):
        _, plan, root = drawn
        assert plan.width < float(root.get("width")) and plan.height < float(root.get("height"))
        for _, (left, top, right, bottom) in _pieces(plan):
            assert left >= 0 and top >= -0.01
            assert right <= plan.width and bottom <= plan.height + 0.01

    def test_inputs_that_are_not_alike_keep_their_places(self, drawn):
        sheet, plan, _ = drawn
        for route in plan.routes:
            if not sheet.parts[route.cord.target].box.any_order:
                assert route.place == route.cord.place
        taken = Counter((route.cord.target, route.place) for route in plan.routes)
        assert set(taken.values()) <= {1}


class TestSame:
    def test_the_same_patch_gives_the_same_bytes(self):
        text = large_patch(60)
        assert draw(parse_patch(text)) == draw(parse_patch(text))

    def test_the_order_of_entries_changes_nothing(self):
        assert draw(parse_patch(large_patch(60))) == draw(parse_patch(large_patch(60, shuffled=5)))


class TestLayout:
    def test_a_chain_is_straight_and_runs_to_the_right(self):
        boxes = [Box(n, 40.0, 40.0, (20.0,), {n: 20.0}) for n in "abcd"]
        plan = lay_out(boxes, [Cord(a, a, b, 0) for a, b in itertools.pairwise("abcd")])
        assert [len(route.points) for route in plan.routes] == [2, 2, 2]
        assert plan.places["a"][0] < plan.places["b"][0] < plan.places["d"][0]

    def test_a_box_fed_by_itself(self):
        plan = lay_out([Box("a", 40.0, 40.0, (20.0,), {"a": 20.0})], [Cord("a", "a", "a", 0)])
        (route,) = plan.routes
        assert route.points[0] == (plan.places["a"][0] + 40, plan.places["a"][1] + 20)
        assert route.points[-1] == (plan.places["a"][0], plan.places["a"][1] + 20)

    def test_a_loop_is_cut_where_it_costs_least(self):
        cheap = {"b": 0.5}
        boxes = [Box(n, 40.0, 40.0, (20.0,), {n: 20.0}, cut=cheap.get(n, 8.0)) for n in "abc"]
        plan = lay_out(
            boxes, [Cord("a", "a", "b", 0), Cord("b", "b", "c", 0), Cord("c", "c", "a", 0)]
        )
        assert plan.places["c"][0] < plan.places["a"][0] < plan.places["b"][0]

    def test_nothing_at_all(self):
        plan = lay_out([], [])
        assert (plan.width, plan.height, plan.routes) == (0.0, 0.0, ())

    def test_widths_of_text(self):
        assert (
            text_width("iii", 10.0) < text_width("www", 10.0) < text_width("www", 10.0, bold=True)
        )


RESET = """
title: Reset
analog:
  x: {integrate: {v: 2, kept: 1}, initial: kept, reset_when: far, hold_when: late, full_scale: 1}
  v: {constant: 0.1, full_scale: 1}
  kept: {constant: 0.2, full_scale: 1}
  far: {compare: {x: 1}, threshold: 0.5, hysteresis: 0.1, low: 0, high: 1, full_scale: 1}
  late: {compare: {v: 1}, threshold: 0.3, low: 0, high: 1, full_scale: 1}
  side: {compare: {x: 1}, low: -1, high: 1, full_scale: 1}
run: {until: 1 s, every: 1 ms}
"""


class TestModes:
    def test_the_box_says_what_sets_them(self):
        texts = _texts(draw(parse_patch(MODES_BY_ALL), {"rest": 2e-3}))
        assert texts[texts.index("MODES") :][:6] == [
            "MODES",
            "IC while far is high",
            "HOLD while late is high",
            "IC 1 ms → OP 20 ms → HOLD 2 ms",
            "4 times, then HOLD for good",
            "HOLD for good from the first overload on",
        ]
        endless = MODES_BY_ALL.replace(" operations: 4,", "")
        texts = _texts(draw(parse_patch(endless), {"rest": 0.0}))
        assert "IC 1 ms → OP 20 ms" in texts and "again and again" in texts
        by_signals = MODES_BY_ALL.replace(
            "reset: 1 ms, operate: 20 ms, hold: rest, operations: 4,", ""
        )
        assert "else OP, from t = 0 on" in _texts(draw(parse_patch(by_signals)))

    def test_each_signal_comes_in_at_its_line(self):
        sheet = Sheet(patch := parse_patch(MODES_BY_ALL), patch.bind())
        ends = [(c.source, c.place) for c in sheet.cords if c.target == MODES]
        assert ends == [("far", 0), ("late", 1)]
        plan = lay_out(sheet.boxes, sheet.cords)
        assert all(r.place == r.cord.place for r in plan.routes if r.cord.target == MODES)

    def test_a_machine_that_is_always_in_op_has_none(self):
        assert "MODES" not in _texts(draw(parse_patch(LONE)))

    def test_units_and_names_of_what_is_there(self):
        texts = _texts(draw(parse_patch(MODES_BY_ALL)))
        assert "10 K/s from 0 s" in texts and "2 (m/s)/s from 0 s" in texts
        (facts,) = [text for text in texts if text.startswith("1 integrator")]
        assert "1 coefficient," in facts and "2 track-stores" in facts and "potent" not in facts


class TestTerminals:
    def test_cords_that_add_nothing_end_at_letters(self):
        """Of x: its sum takes v (with its coefficient) and kept, its terminals kept, far and late."""
        patch = parse_patch(RESET)
        sheet = Sheet(patch, patch.bind(None))
        assert {(c.source, m) for c, m in sheet.marks.items()} == {
            ("kept", "I"),
            ("far", "R"),
            ("late", "H"),
        }
        assert {c.source for c in sheet.pills if c.target == "x"} == {"v"}
        plan = lay_out(sheet.boxes, sheet.cords)
        root = ET.fromstring(svg(sheet, plan))
        letters = {
            e.get("data-terminal"): e for e in root.iter(f"{SVG}text") if e.get("data-terminal")
        }
        assert {mark: e.text for mark, e in letters.items()} == {"I": "I", "R": "R", "H": "H"}
        for route in plan.routes:
            if route.cord in sheet.marks:  # at the height at which its cord arrives
                at = float(letters[sheet.marks[route.cord]].get("y"))
                assert at == pytest.approx(route.points[-1][1] + 0.36 * 8.0, abs=0.01)

    def test_a_comparator_shows_where_it_switches(self):
        """0.5 +- 0.1/2; without hysteresis at the threshold, which is 0 where none is given."""
        shown = draw(parse_patch(RESET))
        for told in (
            "rises at 0.55,",
            "falls at 0.45",
            "switches at 0",
            "R resets it",
            "H holds it",
        ):
            assert told in shown
        assert "in rounded boxes" in shown and "levels of its sum" in shown
        assert "Terminals" not in draw(parse_patch(LONE)) and "comparator" not in draw(
            parse_patch(LONE)
        )


class TestCommand:
    def test_writes_a_file(self, tmp_path, capsys):
        out = tmp_path / "made" / "loop.svg"  # with the folder, as of a run
        assert main(["draw", "pitch_loop", "--set", "cycle=2 ms", "--out", str(out)]) == 0
        assert str(out) in capsys.readouterr().out
        assert "T = 2 ms" in out.read_text(encoding="utf-8")

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["--out", "loop.png"], "ending in .svg"),
            (["--out", " "], "--out is empty"),
            (["--set", "cycl=1 ms"], "did you mean 'cycle'"),
            (["--set", "cycle=0 s"], "must be greater than 0"),
        ],
    )
    def test_mistakes_are_one_line_and_leave_no_file(
        self, arguments, said, tmp_path, monkeypatch, capsys
    ):
        monkeypatch.chdir(tmp_path)
        assert main(["draw", "pitch_loop", *arguments]) == 2
        told = capsys.readouterr().err
        assert said in told and told.count("\n") == 1
        assert not list(Path().iterdir())

    def test_no_path_of_the_machine_is_in_the_picture(self, tmp_path):
        path = tmp_path / "some.yaml"
        path.write_text(LONE, encoding="utf-8")
        assert not re.search(re.escape(str(tmp_path)), draw(read_patch(path)))


STATES = """
title: States
parameters: {k: 2 1/s, push_of_the_motor: 3 1/s, drag_of_the_axle: 4 1/s, slip_of_the_wheel: 5 1/s}
analog:
  x: {integrate: {y: 1}, initial: 0, full_scale: 1}
  v: {integrate: {x: 1 1/s}, initial: 0, full_scale: 1}
interface:
  v_sample: {adc: v}
  x_sample: {adc: x}
  y: {dac: w, full_scale: 1 1/s, initial: 0 1/s}
digital:
  period: 10 ms
  states:
    short: {integrate: k*x_sample, initial: 0, reset_when: short > 1, reset_to: short - 1}
    long:
      integrate: push_of_the_motor*x_sample - drag_of_the_axle*v_sample - slip_of_the_wheel*long
      initial: 0
  program: {w: k*short}
run: {until: 1 s}
"""


class TestOneProgram:
    def test_what_comes_in_is_named_in_a_column_of_its_own(self):
        patch = parse_patch(STATES)
        sheet = Sheet(patch, patch.bind())
        plan = lay_out(sheet.boxes, sheet.cords)
        root = ET.fromstring(svg(sheet, plan))
        left = _moved(root.find(f"{SVG}g"))[0]
        (box,) = sheet.programs.values()
        written = {(round(x, 1), round(y, 1)): text for text, x, y, *_ in _written(root)}
        x, y = plan.places[box.box.name]
        came = [route for route in plan.routes if route.cord.target == box.box.name]
        assert {route.cord.port for route in came} == {"v_sample", "x_sample"}
        for route in came:
            at = x + left + 12, y + 78 + box.box.ins[route.place] + 0.36 * 9
            assert written[round(at[0], 1), round(at[1], 1)] == route.cord.port

    def test_resets_are_told_and_long_rates_are_not_cut_off(self):
        texts = _texts(draw(parse_patch(STATES)))
        assert any("→ short − 1 when short > 1" in text for text in texts)
        assert not any("…" in text for text in texts)
        together = " ".join(texts)
        assert "slip_of_the_wheel·long" in together


class TestComparators:
    def test_only_hysteresis_is_drawn_as_a_loop(self):
        patch = parse_patch(RESET)
        sheet = Sheet(patch, patch.bind())
        keys = {name: sheet.parts[name].key for name in ("far", "late", "side")}
        assert keys["far"] == "compare"
        assert keys["late"] == keys["side"] != "compare"
        shapes = {key: SYMBOLS[key].draw(Field(54.0, 50.0)).count("<path") for key in keys.values()}
        assert shapes["compare"] == shapes[keys["late"]] + 1
