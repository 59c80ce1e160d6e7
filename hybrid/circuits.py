"""Layout of an analog side that is not linear: its elements in machine units.

Stage 3, beside `layout`, which makes matrices of a linear one. A component becomes one element or more:
a source that swings or jumps, a wanted lag with a lag of its own, or a circuit of several parts has
hidden ones in front, named `component:what`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TypedDict

import numpy as np

from hybrid.components import CATALOG, Block, Core, Given
from hybrid.components.linear import Integrate
from hybrid.elements import (
    INPUT,
    INTEGRATE,
    MODE,
    NUMBER,
    PIECES,
    SINE,
    SUM,
    TRACK,
    Element,
    limit_pieces,
)
from hybrid.expressions import names
from hybrid.graph import find_loop
from hybrid.guards import in_machine_units
from hybrid.layout import AnalogLayout, block_states
from hybrid.machine import Analog, OutputStage, StepEvent
from hybrid.memo import KeptLast
from hybrid.modes import HOLD, IC, LOGIC, MODE_ELEMENT, MODE_NAMES, OP, TIMED_MODE
from hybrid.patch import Component, Patch

# Ends the name of a source's hidden element that controls others.
GATE = ":gate"

Elements = tuple[tuple[str, Element], ...]


@functools.lru_cache(maxsize=64)
def is_linear(patch: Patch) -> bool:
    """Whether every component of the patch is linear, so that matrices describe it while in OP."""
    return all(CATALOG[c.kind].linear_with(c.values) for c in patch.components)


def build_circuit(
    patch: Patch, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
) -> tuple[Analog, tuple[StepEvent, ...], Elements]:
    """Lay out and scale the analog side as elements; `stages` gives each component's errors."""
    return _layout(patch, scope, stages).result


def elements_with(
    patch: Patch, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
) -> Callable[[str, OutputStage], Elements]:
    """What gives the elements of one component whose output stage has other errors than in `stages`."""
    return _layout(patch, scope, stages).elements_with


def _next_layout(
    last: _CircuitLayout | None,
    patch: Patch,
    scope: Mapping[str, float],
    stages: Mapping[str, OutputStage],
) -> _CircuitLayout:
    return last.with_figures(scope, stages) if last else _CircuitLayout(patch, scope, stages)


# The runs of a batch differ in few figures: what does not depend on those is laid out once.
_layout: KeptLast[Patch, _CircuitLayout] = KeptLast(_next_layout)


class _CircuitLayout(AnalogLayout):
    """Elements by name; an element of a linear kind comes from its core.

    A layout is never changed: one with other figures shares with it whatever they leave as it is.
    """

    analog: Analog
    events: tuple[StepEvent, ...]
    of_modes: Elements

    def __init__(
        self, patch: Patch, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
    ) -> None:
        self.given: dict[str, Given] = {}
        self.passing: dict[str, tuple[bool, bool]] = {}
        self.elements: dict[str, Elements] = {}
        super().__init__(patch, scope, stages)
        modes = patch.modes
        controls = {s for component in patch.components for s in component.controls}
        controls |= {s for s in (modes.reset_when, modes.hold_when) if s} if modes else set()
        self.controls = controls & self.cores.keys()
        self.followers = self._followers()
        self._lay_out(self.signals, scope, None)

    def _followers(self) -> dict[str, set[str]]:
        """By parameter the signals whose figures follow it."""
        found: dict[str, set[str]] = {name: set() for name in self.patch.analog_parameters}
        for name, part in self.parts.items():
            own = part.parameters if isinstance(part, Component) else names(part.initial.expr)
            scales = (
                names(self.parts[s].full_scale.expr) for s in (name, *self.sources.get(name, ()))
            )
            for parameter in frozenset().union(own, *scales):
                found[parameter].add(name)
        return found

    def with_figures(
        self, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
    ) -> _CircuitLayout:
        """The layout for these, this one itself where they change nothing."""
        moved = [p for p, value in self.used.items() if scope[p] != value]
        changed = set[str]().union(*(self.followers[p] for p in moved))
        other = set[str]()  # in its errors
        if stages is not self.stages:
            other = {s for s, stage in stages.items() if stage != self.stages[s]}
            changed |= {s for s in other if _dials(stages[s]) != _dials(self.stages[s])}
        if not moved and not other:
            return self
        layout = object.__new__(_CircuitLayout)
        layout.__dict__.update(self.__dict__)
        layout.given = dict(self.given)
        layout.work_out(sorted(changed), scope, stages)
        layout._lay_out(sorted(changed | other), scope, self)
        return layout

    def _lay_out(
        self, of: Sequence[str], scope: Mapping[str, float], last: _CircuitLayout | None
    ) -> None:
        """Everything the machine needs, with these signals made anew and the others from `last`."""
        self.used = {name: scope[name] for name in self.followers}
        passing = {
            s: (self.cores[s].dynamic, self.stages[s].tau == 0) for s in of if s in self.cores
        }
        self.passing = {**self.passing, **passing}
        if not last or self.passing != last.passing:
            self.reject_lagless_loops()
        held = not last or any(self._holds(name, last) for name in of)
        self.analog = self._analog() if held else self.analog
        # Sources that control something: it follows their edges at once, without their lag.
        self.gates = frozenset(name for name in self.controls if self.cores[name].steps)
        gated = not last or self.gates != last.gates
        made = {name: tuple(self._elements(name)) for name in (self.signals if gated else of)}
        self.elements = {**self.elements, **made}
        self.events = self.steps(self.analog.inputs) if held else self.events
        self.of_modes = tuple(self._mode_elements()) if gated else self.of_modes
        found = (*self.of_modes, *chain.from_iterable(self.elements.values()))
        self.result = self.analog, self.events, found

    def _holds(self, name: str, last: _CircuitLayout) -> bool:
        """Whether the held inputs or full scales may be others because of this signal."""
        if name in self.dacs or self.scale[name] != last.scale[name]:
            return True
        return bool(self.cores[name].steps or last.cores[name].steps)

    def given_to(self, component: Component, scope: Mapping[str, float]) -> Given:
        """The same, kept for the component's elements."""
        self.given[component.name] = given = super().given_to(component, scope)
        return given

    def _analog(self) -> Analog:
        """Signals and held inputs; what lies between them is in the elements."""
        sources = self.held_inputs()
        timed = (TIMED_MODE,) if self._is_timed else ()  # it begins at 0, which is IC
        inputs, first = (*sources, *timed), [*self.first_inputs(sources), *(0.0 for _ in timed)]
        none, count = np.zeros((0, 0)), len(self.signals)
        return Analog(
            self.signals,
            (),
            inputs,
            none,
            np.zeros((0, len(inputs))),
            none,
            np.zeros((count, len(inputs))),
            np.zeros(0),
            np.array(first),
            np.array([self.scale[s] for s in self.signals]),
            np.full(count, math.nan),
            (),
        )

    @property
    def _is_timed(self) -> bool:
        """Whether time sets the machine's mode."""
        return self.patch.modes is not None and self.patch.modes.operate is not None

    def _mode_elements(self) -> Iterator[tuple[str, Element]]:
        """The machine's mode as a number, and the logic signals of it that the patch uses."""
        if not self.patch.leaves_op:
            return
        if self._is_timed:
            yield TIMED_MODE, Element(INPUT)
        modes = self.patch.modes
        mode = Element(
            MODE,
            control=TIMED_MODE if self._is_timed else None,
            reset=self._gate(modes.reset_when) if modes else None,
            hold=self._gate(modes.hold_when) if modes else None,
            figures=(float(NUMBER),),
        )
        yield MODE_ELEMENT, mode
        for name in self._logic_signals:
            yield name, replace(mode, figures=(float(LOGIC[name]),))

    @property
    def _logic_signals(self) -> list[str]:
        used = {s for component in self.components.values() for s in component.controls}
        return sorted(used & LOGIC.keys() - self.scale.keys())

    def reject_lagless_loops(self) -> None:
        """In no mode; and in IC an integrator without lag passes on the signal that it follows."""
        everything = self.direct_inputs()
        for mode in (OP, HOLD, IC) if self.patch.leaves_op else (OP,):
            what = "algebraic loop through parts without lag"
            what += f" in {MODE_NAMES[mode]}" if self.patch.leaves_op else ""
            direct = {n: inputs for n, inputs in everything.items() if self._passes(n, mode)}
            remedy = "give one of them a tau above 0, or an integrator in between"
            stores = {n for n, component in self.components.items() if component.kind == "track"}
            if (stores - self._by_mode) & set(find_loop(direct) or ()):
                remedy += (
                    "; a track-store counts as passing its input on, as signals that control it are "
                    "not looked at: only operating, resetting and holding are"
                )
            self.reject_loop(direct, what, remedy)
            direct = {n: inputs for n, inputs in direct.items() if n not in stores - self._by_mode}
            direct |= self._initial_inputs(mode)
            self.reject_loop(
                direct, what, "put a track-store into it, or give one of them a tau above 0"
            )

    def _passes(self, name: str, mode: int) -> bool:
        """Whether a part passes its inputs on in this mode: a store that the mode controls may not."""
        return name not in self._by_mode or LOGIC[self.components[name].control or ""] == mode

    @property
    def _by_mode(self) -> set[str]:
        """Stores that the machine's mode controls."""
        return {
            name
            for name, component in self.components.items()
            if component.kind == "track" and component.control in LOGIC
        }

    def _initial_inputs(self, mode: int) -> dict[str, list[str]]:
        """The signals that integrators without lag may follow while the machine is in this mode."""
        return {
            name: [component.initial_signal]
            for name, component in self.components.items()
            if component.initial_signal
            and self.stages[name].tau == 0
            and (mode == IC or component.reset_when)
        }

    def direct_inputs(self) -> dict[str, list[str]]:
        """The machine's mode may depend on a comparator, and what switches on the mode."""
        modes, direct = self.patch.modes, super().direct_inputs()
        if modes:
            by = [s for s in (modes.reset_when, modes.hold_when) if s]
            direct |= dict.fromkeys(self._logic_signals, by)
        return direct

    def inputs_of(self, name: str) -> list[str]:
        """Signals that a component reads at the same instant."""
        component = self.components[name]
        return sorted({*component.sources, *component.controls})

    def elements_with(self, name: str, stage: OutputStage) -> Elements:
        """The elements of a signal with these errors of its output stage, not on the dials."""
        return tuple(self._elements(name, stage))

    def _elements(
        self, name: str, stage: OutputStage | None = None
    ) -> Iterator[tuple[str, Element]]:
        """The hidden element of a signal, if it has one, and its own."""
        stage = stage or self.stages[name]
        if name in self.dacs:
            yield name, Element(INPUT, gain=stage.gain, **_errors(stage))
        elif not CATALOG[self.components[name].kind].is_linear:
            yield from self._nonlinear(name, stage)
        elif self.components[name].kind == "noise_source":
            yield from self._noise(name, stage)
        elif self.cores[name].dynamic:
            yield from self._dynamic(name, stage)
        else:
            yield from self._static(name, stage)

    def _static(self, name: str, stage: OutputStage) -> Iterator[tuple[str, Element]]:
        core, full_scale = self.cores[name], self.scale[name]
        first, hidden = self._scaled(core.gains, name), f"{name}:source"
        if core.steps:
            yield hidden, Element(INPUT)
            if core.integrated:
                yield f"{name}:ramp", Element(INTEGRATE, {hidden: 1.0})
            elif name in self.gates:
                level = core.constant / full_scale
                yield name + GATE, Element(SUM, {hidden: 1.0}, level)
            first = {**first, f"{name}:ramp" if core.integrated else hidden: 1.0}
        if core.oscillation:
            wave = core.oscillation
            amplitude = self.checked(name, wave.amplitude / full_scale)
            yield hidden, Element(SINE, figures=(amplitude, wave.omega, wave.phase))
            first = {**first, hidden: 1.0}
        if core.block:
            yield from _block(name, core.block, first)
            outputs = zip(block_states(name, core.block), core.block.c, strict=True)
            first = {f"{name}:input": core.block.d, **dict(outputs)}
        constant = self.checked(name, core.constant / full_scale)
        yield name, Element(SUM, first, constant, gain=stage.gain, **_errors(stage))

    def _noise(self, name: str, stage: OutputStage) -> Elements:
        """White noise through a lag of the noise's bandwidth, from 0 on; no mode stops it."""
        core, generator = self.cores[name], f"{name}:core"
        made = Element(
            SUM,
            constant=stage.offset,
            initial_output=0.0,
            lag_s=-1.0 / core.feedback,
            noise=stage.gain * self.checked(name, core.noise / self.scale[name]),
            loud=True,
        )
        output = Element(
            SUM,
            {generator: 1.0},
            saturation=stage.saturation,
            lag_s=stage.tau,
            noise=stage.noise,
        )
        return (generator, made), (name, output)

    def _dynamic(self, name: str, stage: OutputStage) -> Iterator[tuple[str, Element]]:
        """An integrator, or a lag that the problem wants."""
        core, full_scale = self.cores[name], self.scale[name]
        first = self._scaled(core.gains, name)
        # What an integrator follows in IC and where it begins; a lag settles to its inputs.
        component, follows, initial = self.components[name], dict[str, float](), 0.0
        time_s = -1.0 / core.feedback if core.feedback else math.inf
        settled = {signal: gain * time_s for signal, gain in first.items() if core.initial is None}
        if core.initial is None and not self.patch.leaves_op:
            errors = _errors(replace(stage, tau=time_s, noise=0.0))
            lag = Element(SUM, settled, gain=stage.gain, **errors)
            if stage.tau == 0.0:
                yield name, lag
                return
            yield f"{name}:core", lag
            wanted = Element(SUM, {f"{name}:core": 1.0}, lag_s=stage.tau, noise=stage.noise)
            yield name, wanted
            return
        if core.initial is None:
            follows = {signal: gain * stage.gain for signal, gain in settled.items()}
            initial = stage.offset
        elif component.initial_signal:
            signal = component.initial_signal
            follows = {signal: self.checked(name, self.scale[signal] / full_scale)}
        else:
            initial = core.initial / full_scale
        limits = None
        kind = CATALOG[self.components[name].kind]
        if isinstance(kind, Integrate):
            found = kind.limits(self.given[name].values)
            limits = (found[0] / full_scale, found[1] / full_scale) if found else None
        integrator = Element(
            INTEGRATE,
            {signal: gain * stage.gain for signal, gain in first.items()},
            stage.offset * self.offset_rate(name),
            follows,
            initial,
            MODE_ELEMENT if self.patch.leaves_op else None,
            (core.feedback - stage.leak, float(component.kind == "lag")),
            limits=limits,
            initial=initial,
            saturation=stage.saturation,
            lag_s=stage.tau,
            noise=stage.noise,
            reset=self._gate(component.reset_when),
            hold=self._gate(component.hold_when),
        )
        yield from _in_loop(name, integrator, core) if core.loop_rate else ((name, integrator),)

    def _nonlinear(self, name: str, stage: OutputStage) -> Iterator[tuple[str, Element]]:
        """The kind's element, which is in SI units inside, with inputs, guards and output scaled."""
        kind, given = CATALOG[self.components[name].kind], self.given[name]
        full_scale = self.scale[name]
        if self.cores[name].steps:
            yield f"{name}:source", Element(INPUT)
        for hidden, element in kind.inner(given).items():
            yield name + hidden, self._reading(name, element)
        made = self._reading(name, kind.element(given))
        if made.kind == TRACK:
            made = replace(made, figures=(made.figures[0] + stage.leak,))
        initial, gain = made.initial / full_scale, self.checked(name, made.gain / full_scale)
        yield name, replace(made, initial=initial, gain=stage.gain * gain, **_errors(stage))

    def _reading(self, name: str, element: Element) -> Element:
        """The element with signals read in SI units and the component's hidden elements as they are."""

        def scaled(gains: Mapping[str, float]) -> dict[str, float]:
            hidden = {name + s: gain for s, gain in gains.items() if s.startswith(":")}
            open_ = {s: gain * self.scale[s] for s, gain in gains.items() if not s.startswith(":")}
            return {s: self.checked(name, gain) for s, gain in {**open_, **hidden}.items()}

        control = element.control
        control = name + control if control and control.startswith(":") else self._gate(control)
        first, second = scaled(element.first), scaled(element.second)
        return in_machine_units(replace(element, first=first, second=second, control=control))

    def _gate(self, control: str | None) -> str | None:
        """What switches at once where this signal is a control."""
        return f"{control}{GATE}" if control in self.gates else control

    def _scaled(self, gains: Mapping[str, float], name: str) -> dict[str, float]:
        """Gains in machine units."""
        own = self.scale[name]
        return {s: self.checked(name, gains[s] * self.scale[s] / own) for s in sorted(gains)}


def _dials(stage: OutputStage) -> tuple[float, ...]:
    """What of its output stage the figures of a component depend on, but for its elements."""
    return stage.pot_resolution, stage.saturation, stage.step_mu


def _in_loop(name: str, integrator: Element, core: Core) -> Elements:
    """An open amplifier as a lag of itself and its inputs: windows need not be as short as 1 / rate.

    In a loop whose gain elsewhere is near 1 the lag's law holds what would be the shortest time.
    """
    held, rate, level = f"{name}:core", core.loop_rate, integrator.saturation
    first = {signal: gain / rate for signal, gain in integrator.first.items()}
    lag = Element(
        PIECES if math.isfinite(level) else SUM,
        {**first, held: 1.0 + core.feedback / rate},
        integrator.constant / rate,
        pieces=limit_pieces(-level, level) if math.isfinite(level) else (),
        initial_piece=1,
        initial_output=integrator.initial,
        lag_s=1.0 / rate,
    )
    output = Element(SUM, {held: 1.0}, lag_s=integrator.lag_s, noise=integrator.noise)
    return (held, lag), (name, output)


def _block(name: str, block: Block, first: Mapping[str, float]) -> Elements:
    """The sum of the inputs and the states of a block; what is not 0 at rest is a lag, which settles."""
    states = block_states(name, block)
    made = [(f"{name}:input", Element(SUM, first))]
    for i, (state, row, drive) in enumerate(zip(states, block.a, block.b, strict=True)):
        others = {s: gain for s, gain in zip(states, row, strict=True) if gain and s != state}
        gains = {**others, f"{name}:input": drive} if drive else others
        if block.rest[i]:
            time_s = -1.0 / row[i]
            settled = {s: gain * time_s for s, gain in gains.items()}
            made.append((state, Element(SUM, settled, lag_s=time_s)))
        else:
            made.append((state, Element(INTEGRATE, gains, figures=(row[i],))))
    return tuple(made)


class _Errors(TypedDict):
    """What an element has of its output stage, but for the gain."""

    offset: float
    saturation: float
    lag_s: float
    noise: float


def _errors(stage: OutputStage) -> _Errors:
    return {
        "offset": stage.offset,
        "saturation": stage.saturation,
        "lag_s": stage.tau,
        "noise": stage.noise,
    }
