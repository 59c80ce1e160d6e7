"""What is said before the engines are compiled: how much is done already, and why it takes long."""

import pytest

import hybrid
from hybrid import compilation
from hybrid.arguments import machine_of
from hybrid.engine import kernel

FUNCTIONS = ["nodes.law_weights", "relaxation.advance", "interplay.play_circuits"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of kept functions, none of which is the one that is asked for."""
    monkeypatch.setattr(kernel.play._cache, "_cache_path", str(tmp_path))
    monkeypatch.setattr(kernel, "is_compiled", lambda function, *_: function is kernel.play)
    return tmp_path


def said(capsys, machine):
    compilation.say_if_compiling(machine_of("van_der_pol", None, machine, None), "nonlinear")
    return capsys.readouterr().err


def test_the_first_time_nothing_is_kept(folder, capsys):
    told = said(capsys, "lags")
    assert told.startswith("hybrid: compiling the nonlinear engine, once after installation: ")
    assert len(told.splitlines()) == 1 and "more where the machine is busy" in told


def test_after_an_interrupted_run_it_is_told_how_much_is_kept(folder, capsys):
    _, of_all = compilation.functions_kept()
    assert of_all > 30
    for name in FUNCTIONS:
        (folder / f"{name}-12.py311.nbi").touch()
    (folder / "kernel.play-12.py311.nbi").touch()  # of no circuit alone
    (folder / "noise.show-12.py311.nbi").touch()
    assert f"the rest of the nonlinear engine, 3 of its {of_all} functions" in said(capsys, "lags")


def test_noise_needs_a_compilation_of_its_own(folder, capsys, monkeypatch):
    monkeypatch.setattr(compilation, "functions_kept", lambda: (44, 44))
    assert "compiling the nonlinear engine for noise, once" in said(capsys, "nominal")


def test_the_kernel_for_word_lengths_is_no_second_installation(capsys, monkeypatch):
    """The first line is for all, the second for programs whose words are limited."""
    text = "title: a\ndigital: {period: 1 s, word: float32, program: {x: 0.5}}\nrun: {until: 2 s}\n"
    machine = machine_of(hybrid.parse_patch(text), None, None, None)
    for kept, what in (([], "kernel"), ([kernel.play], "kernel for programs with word lengths")):
        monkeypatch.setattr(kernel, "is_compiled", lambda function, *_, kept=kept: function in kept)
        compilation.say_if_compiling(machine, "exact")
        assert (
            capsys.readouterr().err
            == f"hybrid: compiling the {what}, once after installation ...\n"
        )


def test_a_circuit_that_was_played_has_kept_all_that_are_counted():
    """So that the rest that is told of is one that comes to be compiled."""
    hybrid.run("van_der_pol", machine="lags")
    kept, of_all = compilation.functions_kept()
    assert kept == of_all
