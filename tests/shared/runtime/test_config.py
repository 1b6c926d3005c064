"""Configuration: what fits is read alike from TOML and JSON, and what does not is one sentence that helps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from shared.runtime.config import ConfigError, Settings, config_hash, load_config, parse_config


class Arm(Settings):
    speed: float = Field(default=1.0, gt=0)


class Rig(Settings):
    name: str = "lab"
    camera: Arm | None = None
    arms: dict[str, Arm] = Field(default_factory=dict)


def test_toml_and_json_say_the_same_and_a_section_that_is_empty_is_there(tmp_path):
    toml, saved = tmp_path / "rig.toml", tmp_path / "rig.json"
    toml.write_text('name = "x"\n[arms.left]\nspeed = 2.5\n[camera]')
    rig = load_config(toml, Rig)
    saved.write_text(rig.model_dump_json())
    assert rig == Rig(name="x", arms={"left": Arm(speed=2.5)}, camera=Arm()) == load_config(saved, Rig)
    assert parse_config("", Rig, "r.toml").camera is None
    assert config_hash(Rig(name="x")) == config_hash(Rig(name="x"))
    assert len({config_hash(Rig()), config_hash(Rig(name="x")), config_hash(Rig(camera=Arm()))}) == 3


MISTAKES = {
    "nme = 'x'": ("nme is unknown", "did you mean name?"),
    "[arms.left]\nspede = 1": ("arms.left.spede is unknown", "did you mean speed?"),
    "[arms.left]\nspeed = -1": ("arms.left.speed = -1", "greater than 0"),
    "[arms.left]\nspeed = nan": ("arms.left.speed = nan",),
    "name = 3": ("name = 3", "string"),
    "camera = 3": ("camera must be a section", "not 3"),
    "name = lab": ("is no TOML", "in line 1, 'name = lab'", "straight quotes"),
    "name = 'a'\nname = 'b'\n": ("in line 2", "what is there twice"),
    "[arms]\nspeed = 1.0": ("arms.speed must be a section", "[arms.NAME]"),
    "a = 1\nb = 2": ("a is unknown", "b is unknown"),
    f"name = {list(range(500))}": ("name = [0, 1, 2", "..."),
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_one_line_that_names_the_key_and_what_is_allowed(text):
    with pytest.raises(ConfigError) as caught:
        parse_config(text, Rig, "r.toml")
    said = str(caught.value)
    assert said.startswith("the configuration r.toml")
    assert "\n" not in said
    assert len(said) < 250
    for told in MISTAKES[text]:
        assert told in said


def test_a_file_that_cannot_be_used_is_named(tmp_path):
    path = tmp_path / "rig.toml"
    for content, told in ((None, "No such file"), (b"\xff\xfe", "no text in UTF-8"), (b"name = ", "is no TOML")):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(ConfigError, match=f"{path}.*{told}"):
            load_config(path, Rig)
    for text in ("[1, 2]", "{", "[" * 100_000):
        with pytest.raises(ConfigError, match=r"r\.json"):
            parse_config(text, Rig, "r.json")


@given(st.text(max_size=200))
def test_any_text_is_a_configuration_or_a_sentence(text):
    try:
        parse_config(text, Rig, "r.toml")
    except ConfigError as error:
        assert str(error).startswith("the configuration r.toml")
