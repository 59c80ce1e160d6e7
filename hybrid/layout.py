"""Layout of the linear analog side: states, held inputs and matrices in machine units.

Stage 3. Everything is laid out in order of names, so the order of entries in a patch file changes
no result, not even in the last bit.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from hybrid.components import CATALOG, Block, Core, Given
from hybrid.errors import PatchError
from hybrid.graph import dependency_order, find_loop
from hybrid.machine import Analog, Floats, OutputStage, StepEvent
from hybrid.patch import Component, Patch, Value
from hybrid.potentiometers import dialled_core
from hybrid.scale import to_ticks

# The input that is always 1; no signal can have this name.
ONE = ":one"
# Ends of the names of states that belong to sources: they only drive.
SOURCE_STATES = (":sin", ":cos", ":ramp")
# Gains and rates in machine units: no machine has more, and sums of more would overflow. As a rate
# it is one full scale in a femtosecond, the resolution of time.
LARGEST_FIGURE = 1e15
LEAST_FULL_SCALE, LARGEST_FULL_SCALE = 1e-100, 1e100


def build_analog(
    patch: Patch, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
) -> tuple[Analog, tuple[StepEvent, ...]]:
    """Lay out and scale the analog side; `stages` gives each component's errors."""
    used = tuple((name, scope[name]) for name in patch.analog_parameters)
    return _laid_out(patch, used, tuple(sorted(stages.items(), key=lambda entry: entry[0])))


# A sweep of the cycle time meets the same analog side at every point.
@functools.lru_cache(maxsize=64)
def _laid_out(
    patch: Patch, scope: tuple[tuple[str, float], ...], stages: tuple[tuple[str, OutputStage], ...]
) -> tuple[Analog, tuple[StepEvent, ...]]:
    return AnalogLayout(patch, dict(scope), dict(stages)).build()


def block_states(name: str, block: Block) -> list[str]:
    """Names of the states of a component's block."""
    return [f"{name}:{i + 1}" for i in range(len(block.b))]


class AnalogLayout:
    """Rows of the linear analog side, collected by name and then made into matrices.

    A row is an array over z = [x; u]. Each dynamic core has a state `name:core` (or `name`, where the
    output has no lag), each lagged output a state `name`.
    """

    def __init__(
        self, patch: Patch, scope: Mapping[str, float], stages: Mapping[str, OutputStage]
    ) -> None:
        self.patch = patch
        self.components = {c.name: c for c in sorted(patch.components, key=lambda c: c.name)}
        self.dacs = {d.name: d for d in sorted(patch.dacs, key=lambda d: d.name)}
        self.signals = tuple(sorted([*self.components, *self.dacs]))
        self.parts = {part.name: part for part in patch.analog_parts}
        self.sources = {name: c.sources for name, c in self.components.items()}
        self.units = {s: self.parts[s].factor for s in self.signals}
        self.scale, self.cores, self.held_mu = (
            dict[str, float](),
            dict[str, Core](),
            dict[str, float](),
        )
        self.work_out(self.signals, scope, stages)

    def work_out(
        self, signals: Sequence[str], scope: Mapping[str, float], stages: Mapping[str, OutputStage]
    ) -> None:
        """The figures of these signals, sorted; those of all others stay."""
        self.stages, parts, dacs = stages, self.parts, [s for s in signals if s in self.dacs]
        scales = {s: self._full_scale(s, parts[s].full_scale, scope) for s in signals}
        self.scale = {**self.scale, **scales}
        of = [self.components[s] for s in signals if s in self.components]
        self.cores = {**self.cores, **{c.name: self._core(c, scope) for c in of}}
        initial_words = {name: self.dacs[name].initial.number(scope) for name in dacs}
        held_mu = {name: self._code(name, word) for name, word in initial_words.items()}
        self.held_mu = {**self.held_mu, **held_mu}
        for name, value in initial_words.items():
            self._check_initial(name, value, self.dacs[name].initial)

    def _code(self, name: str, word: float) -> float:
        """What a DAC holds for a word: even the initial output is a code."""
        held, step = word / self.scale[name], self.stages[name].step_mu
        return float(np.rint(held / step)) * step if step else held

    @staticmethod
    def _full_scale(name: str, value: Value, scope: Mapping[str, float]) -> float:
        scale = value.number(scope)
        if not LEAST_FULL_SCALE <= scale <= LARGEST_FULL_SCALE:
            raise PatchError(
                f"full_scale of {name!r} is {scale:g} in SI units; it must be from "
                f"{LEAST_FULL_SCALE:g} to {LARGEST_FULL_SCALE:g}",
                value.place,
            )
        return scale

    def _check_initial(self, name: str, initial: float, given: Value) -> None:
        if abs(initial) > self.scale[name]:
            raise PatchError(
                f"initial value of {name!r} is {abs(initial) / self.scale[name]:.3g} times its "
                "full_scale; it must lie within",
                given.place,
            )

    def checked(self, name: str, figure: float) -> float:
        """A gain or rate in machine units that a machine can have."""
        if not abs(figure) <= LARGEST_FIGURE:
            raise PatchError(
                f"{name!r} has a gain or rate of {abs(figure):.3g} in machine units; at most "
                f"{LARGEST_FIGURE:g} is possible, so check its figures and the full scales",
                self.components[name].place,
            )
        return figure

    def _core(self, component: Component, scope: Mapping[str, float]) -> Core:
        kind, given = CATALOG[component.kind], self.given_to(component, scope)
        complaint = kind.unsuitable(given)
        if complaint:
            raise PatchError(f"component {component.name!r} {complaint}", component.place)
        core = kind.core(given.values, given.gains)
        core = dialled_core(
            core, component.name, self.scale, self.stages[component.name].pot_resolution
        )
        if core.initial is not None and "initial" in component.values:
            self._check_initial(component.name, core.initial, component.values["initial"])
        self.checked(component.name, core.feedback)
        for rate in (core.block.b + sum(core.block.a, ())) if core.block else ():
            self.checked(component.name, rate)
        if core.oscillation:
            self.checked(component.name, core.oscillation.omega)
        return core

    def given_to(self, component: Component, scope: Mapping[str, float]) -> Given:
        """What the patch gives a component, as numbers."""
        points = sorted((x.number(scope), y.number(scope)) for x, y in component.points)
        return Given(
            {key: value.number(scope) for key, value in component.values.items()},
            {signal: value.number(scope) for signal, value in component.terms},
            component.signals,
            component.control,
            tuple(points),
            self.scale[component.name],
            {signal: self.scale[signal] for signal in self.sources[component.name]},
            self.stages[component.name].saturation,
        )

    def build(self) -> tuple[Analog, tuple[StepEvent, ...]]:
        """The matrices, and the steps of the sources."""
        self.reject_lagless_loops()
        states = self._name_states()
        inputs = self.held_inputs()
        self.n = len(states)
        self.column: dict[tuple[str, str], int] = {("x", s): i for i, s in enumerate(states)}
        self.column |= {("u", s): self.n + i for i, s in enumerate(inputs)}
        c = self._signal_rows()
        rates = np.zeros((self.n, self.n + len(inputs)))
        noise = np.zeros((self.n, self.n))
        for name in self.signals:
            self._add_rates(name, c, rates, noise)
        static = self._static_values()
        x0 = np.array([self._initial(s, static) for s in states])
        noisy, set_of_states = noise[:, np.any(noise != 0.0, axis=0)], frozenset(states)
        analog = Analog(
            self.signals,
            tuple(states),
            tuple(inputs),
            rates[:, : self.n].copy(),
            rates[:, self.n :].copy(),
            noisy,
            np.array([c[s] for s in self.signals]).reshape(len(self.signals), len(self.column)),
            x0,
            self.first_inputs(inputs),
            np.array([self.scale[s] for s in self.signals]),
            np.array([static[s] for s in self.signals]),
            tuple(i for i, s in enumerate(states) if self._only_drives(s, set_of_states)),
        )
        return analog, self.steps(inputs)

    def steps(self, inputs: Sequence[str]) -> tuple[StepEvent, ...]:
        """Whatever changes the held inputs of sources."""
        return tuple(
            StepEvent(
                name,
                index,
                self._level(name, step.value),
                to_ticks(step.at_s),
                to_ticks(step.every_s),
            )
            for index, name in enumerate(inputs)
            if name in self.cores
            for step in self.cores[name].steps
        )

    def reject_lagless_loops(self) -> None:
        """Static parts without lag must not feed each other in a circle."""
        self.reject_loop(
            self.direct_inputs(),
            "algebraic loop through parts without lag",
            "give one of them a tau above 0, or an integrator in between",
        )

    def direct_inputs(self) -> dict[str, list[str]]:
        """What each static part without lag reads at the same instant."""
        return {
            name: self.inputs_of(name)
            for name, core in self.cores.items()
            if not core.dynamic and self.stages[name].tau == 0
        }

    def reject_loop(self, direct: Mapping[str, list[str]], what: str, remedy: str) -> None:
        """Raise PatchError for a loop in `direct`, which points from a component to its inputs."""
        loop = find_loop(direct)
        if loop:
            # Signals run the other way.
            path = " -> ".join([loop[0], *reversed(loop)])
            place = next(self.components[name].place for name in loop if name in self.components)
            raise PatchError(f"{what}: {path}; {remedy}", place)

    def _level(self, name: str, value: float) -> float:
        """What a source holds; a kind that is not linear makes of it what it will."""
        scale = self.scale[name] if CATALOG[self.components[name].kind].is_linear else 1.0
        return self.checked(name, value / scale)

    def held_inputs(self) -> tuple[str, ...]:
        """Names of the held inputs: the constant 1, the DACs, the sources that step."""
        return (ONE, *self.dacs, *(name for name, core in self.cores.items() if core.steps))

    def first_inputs(self, inputs: Sequence[str]) -> Floats:
        """The held inputs at t = 0."""
        stepping = [name for name in inputs if name in self.cores]
        sources = {name: self._level(name, self.cores[name].held) for name in stepping}
        first = {ONE: 1.0, **self.held_mu, **sources}
        return np.array([first[name] for name in inputs])

    def inputs_of(self, name: str) -> list[str]:
        """Signals that a component reads at the same instant."""
        return sorted(self.cores[name].gains)

    def _name_states(self) -> list[str]:
        states = []
        for name in self.signals:
            core, lagged = self.cores.get(name), self.stages[name].tau > 0
            if core and core.dynamic and lagged:
                states.append(name + ":core")
            if lagged or (core and core.dynamic):
                states.append(name)
            if core and core.oscillation:
                states += [name + ":cos", name + ":sin"]
            if core and core.integrated:
                states.append(name + ":ramp")
            if core and core.block:
                states += block_states(name, core.block)
        return states

    def _unit_row(self, kind: str, name: str) -> Floats:
        row = np.zeros(len(self.column))
        row[self.column[kind, name]] = 1.0
        return row

    def _signal_rows(self) -> dict[str, Floats]:
        """Every signal as a row over z, parts without lag after those they depend on."""
        rows = {s: self._unit_row("x", s) for s in self.signals if ("x", s) in self.column}
        inputs = {name: list(core.gains) for name, core in self.cores.items()}
        lagless = {s: inputs.get(s, []) for s in self.signals if s not in rows}
        for name in dependency_order(lagless):
            rows[name] = self._core_row(name, rows)
        return rows

    def _core_row(self, name: str, rows: Mapping[str, Floats]) -> Floats:
        """Output of the core, or its rate where it is dynamic, before the output lag."""
        if name in self.dacs:
            stage = self.stages[name]
            row = stage.gain * self._unit_row("u", name)
            row[self.column["u", ONE]] += stage.offset
            return row
        core, stage = self.cores[name], self.stages[name]
        full_scale = self.scale[name]
        row = self._input_row(name, rows)
        if core.block:
            row *= core.block.d
            for state, gain in zip(block_states(name, core.block), core.block.c, strict=True):
                row += gain * self._unit_row("x", state)
        row[self.column["u", ONE]] += self.checked(name, core.constant / full_scale)
        if core.steps:
            row += self._unit_row(*(("x", name + ":ramp") if core.integrated else ("u", name)))
        if core.oscillation:
            amplitude = self.checked(name, core.oscillation.amplitude / full_scale)
            row += amplitude * self._unit_row("x", name + ":sin")
        self.checked(name, float(np.max(np.abs(row))))
        row *= stage.gain
        row[self.column["u", ONE]] += stage.offset * self.offset_rate(name)
        return row

    def _input_row(self, name: str, rows: Mapping[str, Floats]) -> Floats:
        """Sum of a component's inputs."""
        gains, row = self.cores[name].gains, np.zeros(len(self.column))
        for signal in sorted(gains):
            gain = gains[signal] * self.scale[signal] / self.scale[name]
            row += self.checked(name, gain) * rows[signal]
        return row

    def offset_rate(self, name: str) -> float:
        """What an offset adds to the core's rate: an integrator's is referred to its input and drifts
        by offset per second, with a leak or without, an open amplifier's to its input, too; all others'
        add to the output."""
        core = self.cores[name]
        if core.loop_rate:  # at the summing point of an amplifier
            return core.loop_rate
        if not core.dynamic or CATALOG[self.components[name].kind].per_second:
            return 1.0
        return -core.feedback

    def _add_rates(self, name: str, c: dict[str, Floats], rates: Floats, noise: Floats) -> None:
        core, stage = self.cores.get(name), self.stages[name]
        output = self.column.get(("x", name))
        held = self.column.get(("x", name + ":core"), output)
        if core and core.oscillation:
            sine, cosine = self.column["x", name + ":sin"], self.column["x", name + ":cos"]
            rates[sine, cosine] = core.oscillation.omega
            rates[cosine, sine] = -core.oscillation.omega
        if core and core.integrated:
            rates[self.column["x", name + ":ramp"], self.column["u", name]] = 1.0
        if core and core.block:
            drive, block = self._input_row(name, c), core.block
            places = [self.column["x", state] for state in block_states(name, block)]
            for place, among, gain in zip(places, block.a, block.b, strict=True):
                rates[place] += gain * drive
                rates[place, places] += among
        if output is None or held is None:
            return
        row = self._core_row(name, c)
        if core and core.dynamic:
            rates[held] += row
            rates[held, held] += core.feedback - stage.leak
            rms = stage.gain * self.checked(name, core.noise / self.scale[name])
            noise[held, held] = rms * math.sqrt(-2.0 * core.feedback) if rms else 0.0
            row = np.zeros(len(self.column))
            row[held] = 1.0
        if stage.tau > 0:
            row[output] -= 1.0
            rates[output] += row / stage.tau
            # White noise through the lag: a first-order Gauss process of rms `noise`.
            noise[output, output] = stage.noise * math.sqrt(2.0 / stage.tau)

    def _only_drives(self, state: str, states: frozenset[str]) -> bool:
        """Whether a state belongs to a source, so that it is no mode of the patch."""
        name = state.removesuffix(":core")
        if name not in self.components or (state == name and f"{name}:core" in states):
            return state.endswith(SOURCE_STATES)
        return self.cores[name].dynamic and CATALOG[self.components[name].kind].symbol == "source"

    def static_row(self, name: str, stage: OutputStage) -> tuple[dict[str, float], float]:
        """A signal at t = 0, lags settled, as gains of signals and a figure; `stage`: its errors."""
        if name in self.held_mu:
            return {}, stage.gain * self.held_mu[name] + stage.offset
        core, own = self.cores[name], self.scale[name]
        if core.dynamic and core.initial is not None:
            return {}, core.initial / own
        # A settled dynamic core balances its inputs: w = -(sum) / feedback.
        factor = -1.0 / core.feedback if core.dynamic else 1.0
        gains = {
            signal: factor * stage.gain * (gain * self.scale[signal] / own)
            for signal, gain in core.gains.items()
        }
        source = core.constant + (0.0 if core.integrated else core.held)
        if core.oscillation:
            source += core.oscillation.amplitude * math.sin(core.oscillation.phase)
        offset = stage.offset * self.offset_rate(name)
        return gains, factor * (stage.gain * source / own + offset)

    def rate_row(self, name: str, stage: OutputStage) -> tuple[dict[str, float], float]:
        """An integrator's rate at t = 0, in machine units a second, in the same way."""
        core, own = self.cores[name], self.scale[name]
        gains = {s: stage.gain * (gain * self.scale[s] / own) for s, gain in core.gains.items()}
        begins = (core.initial or 0.0) / own
        rate = stage.gain * core.constant / own + stage.offset * self.offset_rate(name)
        return gains, rate + (core.feedback - stage.leak) * begins

    def static_balance(self) -> tuple[Floats, Floats]:
        """All static rows as a matrix and figures: matrix @ signals = figures."""
        index = {s: i for i, s in enumerate(self.signals)}
        matrix, right = np.eye(len(index)), np.zeros(len(index))
        for name, i in index.items():
            gains, right[i] = self.static_row(name, self.stages[name])
            for signal, gain in gains.items():
                matrix[i, index[signal]] -= gain
        return matrix, right

    def _static_values(self) -> dict[str, float]:
        """Every signal at t = 0 with all lags settled: the operator's static check."""
        matrix, right = self.static_balance()
        try:
            settled = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            settled = np.full(len(right), math.nan)
        if not np.all(np.isfinite(settled)):
            raise PatchError(
                "the machine cannot settle before the run: a loop of parts with lag but no "
                "integrator has a gain of exactly 1",
                self.patch.components[0].place,
            )
        return dict(zip(self.signals, settled.tolist(), strict=True))

    def _initial(self, state: str, static: Mapping[str, float]) -> float:
        name, _, part = state.partition(":")
        if part == "ramp":
            return 0.0
        block = self.cores[name].block if part.isdigit() else None
        if block:
            gains = self.cores[name].gains
            u = (
                sum(gain * self.scale[s] * static[s] for s, gain in gains.items())
                / self.scale[name]
            )
            return block.rest[int(part) - 1] * u
        if part in ("sin", "cos"):
            oscillation = self.cores[name].oscillation
            assert oscillation is not None
            return math.sin(oscillation.phase) if part == "sin" else math.cos(oscillation.phase)
        return static[name]
