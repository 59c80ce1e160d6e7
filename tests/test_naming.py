"""What files are called and what is said of `--on`."""

from hybrid.naming import LONGEST, on_text, stem_of
from hybrid.patchfile import parse_patch

TEXT = """
title: T
analog: {a: {sine: 1, frequency: 1 Hz, full_scale: 1}%s}
run: {until: 1 s, every: 1 ms}
"""


def named(file, on=None, more=""):
    return stem_of(parse_patch(TEXT % more, file, on))


def test_files_are_called_after_the_patch_and_what_was_moved():
    assert named("some/where/loop.yaml") == "loop"
    assert named("loop.yaml", "analog") == "loop_on_analog"
    assert named("loop.yaml", {"a": "analog"}) == "loop_on_a_analog"


def test_names_that_would_grow_too_long_end_in_a_hash_of_their_own():
    names = [f"signal_{i}_with_a_long_name" for i in range(9)]
    more = "".join(f", {name}: {{coefficient: {{a: 1}}, full_scale: 1}}" for name in names)
    one = named("loop.yaml", dict.fromkeys(names, "analog"), more)
    other = named("loop.yaml", dict.fromkeys(names[:-1], "analog"), more)
    assert one != other and len(one) == len(other) == len("loop_on_") + LONGEST
    assert one == named("loop.yaml", dict.fromkeys(reversed(names), "analog"), more)


def test_files_tell_what_was_changed_in_letters_that_any_file_system_takes():
    patch = parse_patch(TEXT % "", "loop.yaml")
    assert stem_of(patch, ["cycle=5 ms", "omega_p=12 rad/s", "nominal", "seed7"]) == (
        "loop_cycle=5ms_omega_p=12rad-s_nominal_seed7"
    )
    moved = parse_patch(TEXT % "", "loop.yaml", "analog")
    assert stem_of(moved, ["seed7"]) == "loop_on_analog_seed7"
    odd = [stem_of(patch, [f"a={text}"]) for text in ("2*3", "2-3", "2/3", "2:3", "2\\3", "2.3")]
    assert len(set(odd)) == len(odd)
    assert all(not set(name) & set('<>:"/\\|?* ') for name in odd)
    long = [stem_of(patch, [f"a=0.{'1' * 90}{digit}"]) for digit in "12"]
    assert long[0] != long[1] and {len(name) for name in long} == {len("loop_") + LONGEST}


def test_three_are_named_and_more_are_counted():
    assert on_text({}) == "" and on_text({"all": "digital"}) == "all on digital"
    assert on_text({"b": "digital", "a": "analog"}) == "a on analog, b on digital"
    many = on_text(dict.fromkeys("abcd", "digital"))
    assert many == "a on digital, b on digital, 2 more elsewhere"
