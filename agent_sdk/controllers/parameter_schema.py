"""Parameters of a controller's class as a model of their names, types and defaults, and so as a JSON schema."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, PydanticUserError, TypeAdapter, create_model

from zenostat.topics.codec import validated

_TYPES_OF_DEFAULTS: Mapping[type, Any] = {bool: bool, int: int | float, float: float, str: str}
"""Types of parameters without annotations, by those of their defaults."""

_ENTRY = re.compile(r"^(\w+): (.+)$")


class _Parameters(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _OpenParameters(_Parameters):
    """Parameters of a controller that takes further ones by the names of actions or actuators."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float] = Field(init=False)


@cache
def parameters_model(factory: Callable[..., Any]) -> type[BaseModel]:
    """Return a model whose fields are the parameters of a controller, with their types, defaults and meanings.

    The meanings are those of the docstring. The first parameter, the node's manifest, is left out, and so are optional
    ones of other types than JSON has.
    """
    parameters = [*inspect.signature(factory).parameters.values()][1:]
    hints = _type_hints(factory)
    meanings = _meanings(factory)
    fields: dict[str, Any] = {}
    for each in parameters:
        if each.kind in (each.KEYWORD_ONLY, each.POSITIONAL_OR_KEYWORD) and (hint := _type(each, hints)) is not None:
            default = ... if each.default is each.empty else each.default
            fields[each.name] = (hint, Field(default, description=meanings.get(each.name)))
    is_open = any(each.kind is each.VAR_KEYWORD for each in parameters)
    name = getattr(factory, "__name__", "Parameters")
    return create_model(name, __base__=_OpenParameters if is_open else _Parameters, **fields)


def check_values(factory: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Check names and types of parameters, and return those that are set.

    Raises:
        InvalidConfig: an unknown name, a value of another type or not finite, or a required parameter is missing.
    """
    return validated(parameters_model(factory), values).model_dump(exclude_unset=True)


def _type_hints(factory: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of parameters; none if the class names one that cannot be resolved."""
    plain = factory.func if isinstance(factory, partial) else factory
    try:
        return get_type_hints(plain.__init__ if isinstance(plain, type) else plain)  # type: ignore[misc]
    except (NameError, TypeError):  # a name for type checkers alone
        return {}


def _type(parameter: inspect.Parameter, hints: Mapping[str, Any]) -> Any:
    """Return the type of a parameter's values; None if it is optional and not of a type that JSON has."""
    hint = hints.get(parameter.name, _TYPES_OF_DEFAULTS.get(type(parameter.default)))
    try:
        if hint is not None:
            TypeAdapter(hint).json_schema()
            return hint
    except PydanticUserError:  # it has no schema
        pass
    return Any if parameter.default is parameter.empty else None


def _meanings(factory: Callable[..., Any]) -> dict[str, str]:
    """Return the entries of a docstring's section `Args`."""
    _, _, section = (inspect.getdoc(factory) or "").partition("\nArgs:\n")
    meanings: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        if line and not line.startswith(" "):
            break
        indent = len(line) - len(line.lstrip())
        if indent == 4 and (entry := _ENTRY.match(line.strip())):
            name, meanings[entry[1]] = entry[1], entry[2]
        elif name and line.strip():
            meanings[name] += f" {line.strip()}"
    return meanings
