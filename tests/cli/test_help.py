"""Help pages: scenes in two steps, no markup, and no sentence that is cut off."""

import re

import pytest
from click.testing import CliRunner

from warpcrete.cli import theory
from warpcrete.cli.help_pages import plain
from warpcrete.cli.main import cli
from warpcrete.core.inputs.parameters import Declared, declared_fields
from warpcrete.scenes import modules


def options(*words: str, command: str = "run") -> set[str]:
    """Return the options that a help page lists."""
    done = CliRunner().invoke(cli, [command, *words])
    assert done.exit_code == 0, done.output
    return set(re.findall(r"^  (--[\w-]+)", done.output, re.M))


@pytest.mark.parametrize("name", modules())
def test_help_shows_common_options_and_help_all_the_others(name):
    page = CliRunner().invoke(cli, ["run", name, "--help"]).output
    short, full = options(name, "--help"), options(name, "--help-all")
    fields = declared_fields(modules()[name].scene.parameters)
    flags = {field.name: "--" + field.name.replace("_", "-") for field in fields.values()}
    assert set(flags.values()) <= full
    assert {flags[field.name] for field in fields.values() if field.common} == short & set(flags.values())
    assert short < full and len(short) <= 32
    assert page.splitlines()[-1] == f"{len(full - short)} further options: cli run {name} --help-all"
    assert "further options" not in CliRunner().invoke(cli, ["run", name, "--help-all"]).output
    assert {"--out", "--device", "--resume", "--help", "--help-all"} <= short and {"--frames", "--usd"} <= full - short


def test_help_of_theory_has_two_steps():
    short, full = options("--help", command="theory"), options("--help-all", command="theory")
    flags = {"--" + name.replace("_", "-"): field for name, field in theory.fields().items()}
    own = {"--flow", "--pressure", "--fit", "--rest", "--rise", "--help", "--help-all"}
    assert short == own | {flag for flag, field in flags.items() if field.common}
    assert full == short | set(flags) | {"--thixotropy", "--segregation", "--aggregate"}
    page = CliRunner().invoke(cli, ["theory", "--help"]).output
    assert page.splitlines()[-1] == f"{len(full - short)} further options: cli theory --help-all"
    assert "\nPipe:\n" in page and page.index("--flow") < page.index("--concrete")


def test_a_laws_options_are_common():
    assert "--contact-unloading" in options("pipe", "--contact", "hertz-mindlin", "--help")
    assert "--contact-unloading" not in options("pipe", "--help-all")


def parameter_classes() -> set[type]:
    return {base for module in modules().values() for base in module.scene.parameters.__mro__} - {object, Declared}


def test_common_parameters_exist():
    chosen = [each for each in parameter_classes() if "common" in each.__dict__]
    assert len(chosen) > 10
    for each in chosen:
        assert set(each.common) <= set(each.__annotations__), each


@pytest.mark.parametrize("words", [(), *((name,) for name in cli.commands), *(("run", name) for name in modules())])
def test_help_pages_have_no_markup_and_no_cut_sentences(words):
    for flag in ("--help", "--help-all"):
        done = CliRunner().invoke(cli, [*words, flag])
        if flag == "--help-all" and done.exit_code == 2:
            continue
        assert done.exit_code == 0, done.output
        assert "`" not in done.output and not re.search(r":\w+:|\*\*|\w\.\.\.$", done.output, re.M), done.output
        assert "Traceback" not in done.output and "SceneError" not in done.output


def test_a_list_of_commands_holds_whole_sentences_and_the_titles_of_scenes():
    def squeezed(*words: str) -> str:
        return re.sub(r"\s+", " ", CliRunner().invoke(cli, words).output)

    assert "calibrate Find a concrete's parameters from measured results explain" in squeezed("--help")
    assert "of each SCENE, by default of all scenes, so that its first run starts at once" in squeezed("--help")
    page = squeezed("run", "--help")
    for name, module in modules().items():
        assert f" {name} {module.__doc__.splitlines()[0]}" in page


def test_names_of_parameters_become_options():
    text = 'Set `mould_grip`, or `shapes="reference"`. See `slump-dem` and :func:`~warpcrete.core.units.shown`.'
    shown = plain(text, {"mould_grip", "shapes"})
    assert shown == "Set --mould-grip, or --shapes reference. See 'slump-dem' and shown."


def test_help_of_words_lists_options_with_their_defaults_below_each_other():
    page = CliRunner().invoke(cli, ["calibrate", "--help"]).output
    assert page.startswith("Usage: cli calibrate TARGETS.yaml [OPTIONS]\n")
    assert max(map(len, page.partition("Options:")[2].splitlines())) <= 80
    squeezed = re.sub(r"\s+", " ", page)
    assert "verify the answer do not count [default: 10 + 10 per parameter] --batch N Number of trials" in squeezed
    assert squeezed == re.sub(r"\s+", " ", CliRunner().invoke(cli, ["calibrate"]).output)
