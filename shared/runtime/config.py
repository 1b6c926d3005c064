"""Configuration from TOML, checked as a whole; what is wrong is one sentence that names the key and what it may be."""

import hashlib
import json
import tomllib
from pathlib import Path
from typing import TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

M = TypeVar("M", bound=BaseModel)
LONGEST_VALUE = 60


class ConfigError(ValueError):
    """A configuration that cannot be used; the text names the file, the key, and what is allowed there."""


class Settings(BaseModel):
    """A section of a configuration: frozen, and without room for keys that nobody reads."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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


def parse_config(text: str, model: type[M], name: str) -> M:
    """The same from text; `name` is what messages call it, and its ending tells JSON from TOML."""
    try:
        return model.model_validate(json.loads(text) if name.endswith(".json") else tomllib.loads(text))
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        form = "JSON" if name.endswith(".json") else "TOML"
        raise ConfigError(f"the configuration {name} is no {form}: {error}") from None
    except RecursionError:
        raise ConfigError(f"the configuration {name} is nested too deeply to be one") from None
    except ValidationError as error:
        faults = "; ".join(_fault(e, model) for e in error.errors())
        raise ConfigError(f"the configuration {name}: {faults}") from None


def config_hash(config: BaseModel) -> str:
    """A short name of a configuration that changes with any of its values."""
    return hashlib.sha256(config.model_dump_json().encode()).hexdigest()[:12]


def _fault(error: ErrorDetails, model: type[BaseModel]) -> str:
    """One fault that pydantic found, as a clause."""
    where = [str(part) for part in error["loc"] if part != "[key]"]
    key = ".".join(where) or "the whole"
    match error["type"]:
        case "extra_forbidden":
            return f"{key} is unknown; {_known_keys(model, where[:-1])}"
        case "missing":
            return f"{key} is missing"
        case "model_type" | "dict_type":
            return f"{key} must be a section with keys of its own, not {_shown(error['input'])}"
        case "value_error":
            return f"{key}: {str(error['msg']).removeprefix('Value error, ')}"
        case _:
            said = str(error["msg"])
            return f"{key} = {_shown(error['input'])}: {said[:1].lower()}{said[1:]}"


def _shown(value: object) -> str:
    """A value as people wrote it, shortened where it is long."""
    shown = repr(value)
    return shown if len(shown) <= LONGEST_VALUE else f"{shown[:LONGEST_VALUE]}..."


def _known_keys(model: type[BaseModel], section: list[str]) -> str:
    """The keys that the section of an unknown key may have."""
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
    return f"allowed here: {', '.join(current.model_fields)}" if current is not None else "see docs/configuration.md"


def _section(annotation: object) -> type[BaseModel] | None:
    """The model that a key's type is, or holds as an option or as the value of a mapping."""
    candidates = [annotation, *get_args(annotation)]
    return next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
