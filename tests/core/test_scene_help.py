"""Tests of `help`, signatures and tab completion of scenes: names, parameters, units, defaults."""

import inspect
import pydoc
import re

import pytest
from IPython.core.completer import provisionalcompleter
from IPython.core.interactiveshell import InteractiveShell

from warpcrete import SceneError, scenes
from warpcrete.core.inputs.parameters import declared_fields
from warpcrete.core.inputs.scene_titles import scene_titles

ALL_SCENES = tuple(name.replace("-", "_") for name in scenes.modules())


def test_a_listing_of_scenes_holds_scenes_alone():
    assert dir(scenes) == sorted(ALL_SCENES)
    assert all(repr(getattr(scenes, name)).startswith("<scene function ") for name in dir(scenes))


def test_help_of_the_package_lists_the_scenes():
    text = pydoc.render_doc(scenes, renderer=pydoc.plaintext)
    for name, module in scenes.modules().items():
        assert re.search(rf"^ *{name.replace('-', '_')} +{re.escape(module.__doc__.splitlines()[0])}$", text, re.M)


def test_messages_lead_to_the_scene_that_was_meant():
    with pytest.raises(AttributeError, match=r"^there is no scene 'pipes'; did you mean 'pipe'\?$"):
        _ = scenes.pipes
    assert not hasattr(scenes, "__wrapped__")
    for word in ("method", "contact"):
        with pytest.raises(SceneError, match=rf"^parameter = '{word}': .* scene slump; use warpcrete.scenes.slump_dem"):
            scenes.slump(**{word: "dem"})
    with pytest.raises(SceneError, match=r"such as unit=\.\.\.; help\(warpcrete\.scenes\.pipe\) lists them$"):
        scenes.pipe("vertical")


@pytest.mark.parametrize("name", ALL_SCENES)
def test_help_shows_signature_and_every_parameter(name):
    function = getattr(scenes, name)
    fields = declared_fields(function.parameters)
    text = pydoc.render_doc(function, renderer=pydoc.plaintext)
    head = "".join(text.splitlines()[2:]).partition(")")[0]
    assert f"in module {function.module.__name__.removesuffix('_dem')}" in text.splitlines()[0] or "_dem" in name
    assert head.replace(" ", "").startswith(f"{name}(*,{next(iter(fields))}:")
    assert list(inspect.signature(function).parameters) == list(fields)
    squeezed = re.sub(r"\s+", " ", text)
    assert not re.search(r":(class|func|meth|mod):`", text)
    for field in fields.values():
        kind = re.search(rf" {field.name}: (a number|a whole number|text|True or False|a name or an object)", squeezed)
        assert kind, field.name
        assert re.sub(r"\s+", " ", field.help) in squeezed
    assert inspect.signature(function).parameters[field.name].default == field.default


def test_help_states_units_defaults_choices_and_other_names():
    text = re.sub(r"\s+", " ", scenes.pipe.__doc__)
    assert "diameter: a number, default 0.15 m Inner diameter of the pipe [m]" in text
    assert "time_step: a number, optional Fixed time step [s]; default: automatic" in text
    assert "safety: a number, default 0.8 Automatic time step, divided by" in text
    assert re.search(
        r"unit: text, default 'bend-to-horizontal' .*?; one of vertical, [^;]*, mesh ",
        re.sub(r"\s+", " ", scenes.part.__doc__),
    )


@pytest.mark.parametrize("jedi", [False, True])
def test_tab_completes_scenes_and_parameters(jedi):
    if jedi:
        pytest.importorskip("jedi", reason="IPython completes by jedi only where it is installed")
    shell = InteractiveShell()
    shell.user_ns["scenes"], shell.Completer.use_jedi = scenes, jedi

    def completed(text):
        with provisionalcompleter():
            return [each.text.lstrip(".") for each in shell.Completer.completions(text, len(text))]

    assert completed("scenes.pipe(vel") == ["velocity="]
    assert completed("scenes.") == sorted(ALL_SCENES)


def test_titles_of_scenes_are_those_of_their_files(tmp_path):
    """A file may hold the scenes of both methods; private files and files without scenes have no title."""
    files = {
        "heap": '"""Heap of concrete, as a flow.\n\nMore words."""\ndef scene(): ...\ndef scene_dem(): ...\n',
        "two_words": '"""Box."""\ndef scene_dem(): ...\n',
        "bare": "def scene(): ...\n",
        "helper": '"""No scene."""\ndef other(): ...\n',
        "_private": '"""Hidden."""\ndef scene(): ...\n',
    }
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    assert list(scene_titles(tmp_path).items()) == [
        ("bare", ""),
        ("heap", "Heap of concrete, as a flow."),
        ("heap-dem", "Heap of concrete, by discrete elements."),
        ("two-words-dem", "Box, by discrete elements."),
    ]


@pytest.mark.parametrize("name", scenes.modules())
def test_scenes_from_the_same_parameters_are_equal(name):
    """A scene may contain arrays, such as those of a mesh, which Python itself cannot compare."""
    make = scenes.modules()[name].scene
    first, second = make(), make()
    assert first == second and first != make(seed=7)
    assert len({*getattr(first, "walls", ()), *getattr(second, "walls", ())}) == len(getattr(first, "walls", ()))
