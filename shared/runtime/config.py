"""Configuration from TOML, checked as a whole; what is wrong is one sentence that names the key and what it may be."""

import difflib
import hashlib
import json
import re
import tomllib
from pathlib import Path
from typing import TypeVar, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails

M = TypeVar("M", bound=BaseModel)
LONGEST_VALUE = 60


class ConfigError(ValueError):
    """A configuration that cannot be used; the text names the file, the key, and what is allowed there."""


class Settings(BaseModel):
    """A section of a configuration: frozen, and without room for keys that nobody reads."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_no_truths(cls, told: object) -> object:
        """True would pass for 1."""
        given: dict[str, object] = told if isinstance(told, dict) else {}
        for name, value in given.items():
            allowed = _types(cls.model_fields[name].annotation) if name in cls.model_fields else set[object]()
            if isinstance(value, bool) and allowed & {int, float} and bool not in allowed:
                raise ValueError(f"{name} must be a number, not {str(value).lower()}")
        return told


def load_config(path: Path, model: type[M]) -> M:
    """Read a configuration file: TOML, or JSON as sessions keep it.

    Raises:
        ConfigError: where it cannot be read, is no TOML, or does not fit.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise ConfigError(f"the configuration {path} cannot be read: {reason}") from None
    return parse_config(text, model, str(path))


def parse_config(text: str, model: type[M], name: str, is_json: bool = False) -> M:
    """The same from text; `name` is what messages call it, and its ending tells JSON from TOML unless that is told."""
    try:
        return model.model_validate(json.loads(text) if is_json or name.endswith(".json") else tomllib.loads(text))
    except json.JSONDecodeError as error:
        raise ConfigError(f"the configuration {name} is no JSON: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"the configuration {name} is no TOML: {_no_toml(str(error), text)}") from None
    except RecursionError:
        raise ConfigError(f"the configuration {name} is nested too deeply to be one") from None
    except ValidationError as error:
        faults = "; ".join(_fault(e, model) for e in error.errors())
        raise ConfigError(f"the configuration {name}: {faults}") from None


def spelled(pattern: str, words: str) -> AfterValidator:
    """That a text is of a form, which is told in words where it is not."""

    def check(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise ValueError(f"{_shown(text)} cannot be used; write {words}")
        return text

    return AfterValidator(check)


def config_hash(config: BaseModel) -> str:
    """A short name of a configuration that changes with any of its values."""
    return hashlib.sha256(config.model_dump_json().encode()).hexdigest()[:12]


def _no_toml(said: str, text: str) -> str:
    """What TOML's reader says, with the line in question and what to do."""
    remedy = "write texts in straight quotes, lists in brackets, and true or false in small letters"
    if "twice" in said or "overwrite" in said:
        remedy = "what is there twice needs a name of its own, or has to go"
    place = re.search(r" \(at line (\d+), column \d+\)$", said)
    lines = text.splitlines()
    if place is None or int(place[1]) > len(lines):
        return f"{said}; {remedy}"
    line = _shown(lines[int(place[1]) - 1].strip())
    return f"{said[: place.start()]} in line {place[1]}, {line}; {remedy}"


def _fault(error: ErrorDetails, model: type[BaseModel]) -> str:
    """One fault that pydantic found, as a clause."""
    where = [str(part) for part in error["loc"] if part != "[key]"]
    key = ".".join(where)
    match error["type"]:
        case "extra_forbidden":
            return f"{key} is unknown; {_meant(where[-1], _known_keys(model, where[:-1]), model)}"
        case "missing":
            return f"{key} is missing"
        case "model_type" | "dict_type":
            return f"{key or 'it'} must be a section with keys of its own{_named(where)}, not {_shown(error['input'])}"
        case "tuple_type":
            return f"{key} must be a list in brackets, such as [{_shown(error['input'])}], not {_shown(error['input'])}"
        case "value_error":
            said = str(error["msg"]).removeprefix("Value error, ")
            return f"{key}: {said}" if key else said
        case _:
            said = str(error["msg"]).replace("Input should", "it must")
            return f"{key} = {_shown(error['input'])}: {said[:1].lower()}{said[1:]}"


def _named(where: list[str]) -> str:
    """How a section is written that is one of several."""
    return f" and a name before them, [{where[0]}.NAME]" if len(where) == 2 else ""


def _meant(key: str, known: list[str], model: type[BaseModel]) -> str:
    """What may have been meant by an unknown key: one like it, or the same in another section; else what could have."""
    if not known:
        return "see docs/configuration.md"
    elsewhere = [f"{section}.{key}" for section in model.model_fields if key in _known_keys(model, [section])]
    near = elsewhere or difflib.get_close_matches(key, known, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed here: {', '.join(known)}"


def _shown(value: object) -> str:
    """A value as people wrote it, shortened where it is long."""
    shown = repr(value)
    return shown if len(shown) <= LONGEST_VALUE else f"{shown[:LONGEST_VALUE]}..."


def _known_keys(model: type[BaseModel], section: list[str]) -> list[str]:
    """The keys that the section of an unknown key may have; none where nobody knows."""
    current: type[BaseModel] | None = model
    named_by_users = False
    for part in section:
        # the key of a mapping is a name that was given to a section, such as the arm's
        if named_by_users:
            named_by_users = False
            continue
        field = current.model_fields.get(part) if current is not None else None
        current = _section(field.annotation) if field is not None else None
        named_by_users = field is not None and get_origin(field.annotation) is dict
    return list(current.model_fields) if current is not None else []


def _types(annotation: object) -> set[object]:
    """What a key may be, options taken apart."""
    return {annotation, *(inner for one in get_args(annotation) for inner in _types(one))}


def _section(annotation: object) -> type[BaseModel] | None:
    """The model that a key's type is, or holds as an option or as the value of a mapping."""
    candidates = [annotation, *get_args(annotation)]
    return next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
