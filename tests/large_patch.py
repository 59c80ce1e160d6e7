"""A generated patch of many components of every kind, for tests of size and of drawing."""

import random

PAIRS = ("multiply", "divide", "atan2")
SINGLES = ("square_root", "sin", "cos", "function", "absolute", "limit", "dead_zone", "track")
EXTRA = {
    "function": "points: {-1: -1, -0.2: 0, 0.3: 0.6, 1: 0.4}",
    "limit": "low: -0.5, high: 0.5",
    "dead_zone": "low: -0.1, high: 0.1",
    "track": "control: cmp_0",
    "compare": "high: 1, low: -1, hysteresis: 0.1",
    "integrate": "initial: 0.25",
    "lag": "time_constant: 1 ms",
}


def large_patch(components=60, seed=1, shuffled=None):
    """Text of a patch with two converters each way; `shuffled` gives another order of its entries."""
    rng = random.Random(seed)
    names = ["ref_0", "step_0", "sine_0", "square_0", "cmp_0", "relay_0"]
    names += [f"x_{place}" for place in range(components - len(names))]
    lines = {
        "ref_0": "{constant: 0.5, full_scale: 1}",
        "step_0": "{step: 1, at: 0.1 s, full_scale: 1}",
        "sine_0": "{sine: 1, frequency: 10 Hz, full_scale: 1}",
        "square_0": "{square: 1, period: 0.1 s, full_scale: 1}",
        "cmp_0": "{compare: {x_0: 1, ref_0: -1}, high: 1, low: -1, full_scale: 1}",
        "relay_0": "{switch: [x_1, sine_0], control: cmp_0, full_scale: 1}",
    }
    for place in range(components - len(lines)):
        near = [f"x_{i}" for i in range(max(0, place - 8), place)] or ["ref_0"]
        pool = [*near, rng.choice(names[:6])]
        kind = (
            "integrate"
            if place % 4 == 0
            else rng.choice(
                ("sum", "sum", "coefficient", "invert", "lag", "compare", *PAIRS, *SINGLES)
            )
        )
        if kind in PAIRS:
            main = f"[{rng.choice(pool)}, {rng.choice(pool)}]"
        elif kind in SINGLES or kind == "invert":
            main = rng.choice(pool)
        else:
            count = 1 if kind == "coefficient" else rng.randint(1, 3)
            chosen = rng.sample(sorted(set(pool)), min(count, len(set(pool))))
            if kind == "integrate":
                later = names[6 + place :][: rng.randint(1, 12)]
                chosen = sorted({*chosen, rng.choice([*later, "command"])})
            rate = " 1/s" if kind == "integrate" else ""
            factors = [rng.choice((1, 1, -1, 0.5, 12.5)) for _ in chosen]
            main = ", ".join(f"{n}: {f}{rate}" for n, f in zip(chosen, factors, strict=True))
            main = f"{{{main}}}"
        extra = f", {EXTRA[kind]}" if kind in EXTRA else ""
        lines[f"x_{place}"] = f"{{{kind}: {main}{extra}, full_scale: 2}}"
    interface = {
        "sample_a": "{adc: x_4, bits: 14}",
        "sample_b": "{adc: x_11, bits: 14}",
        "command": "{dac: word_a, bits: 14, full_scale: 1, initial: 0}",
        "guide": "{dac: word_b, bits: 14, full_scale: 1, initial: 0}",
    }
    program = {
        "word_a": "0.5 * sample_a - sample_b",
        "word_b": "previous(word_a) + sample_b",
        "word_c": "max(word_a, word_b)",
    }
    lines["x_guided"] = "{sum: {guide: 1, x_2: 2}, full_scale: 4}"
    sections = []
    for section in (lines, interface, program):
        entries = [f"  {name}: {text}" for name, text in section.items()]
        if shuffled is not None:
            random.Random(shuffled).shuffle(entries)
        sections.append("\n".join(entries))
    return (
        f"title: Sixty <components> & more\nanalog:\n{sections[0]}\ninterface:\n{sections[1]}\n"
        f"digital:\n  period: 1 ms\n  remember: {{word_a: 0}}\n  program:\n"
        + "\n".join(f"  {line}" for line in sections[2].split("\n"))
        + "\nrun: {until: 1 s}\n"
    )
