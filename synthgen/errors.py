"""`JobError`: the one line that a user gets for bad input, and how pydantic's errors become it."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from assets_procedural.conventions.errors import UserError


class JobError(UserError, ValueError):
    """Bad input, found before anything is rendered; `str()` is one line for the user.

    `file` is the job file, folder or command-line option, `field` the key in it, `value` what it
    says (already printable) and `remedy` what is wrong and what to do about it.
    """

    def __init__(self, file: str | Path, field: str, value: str, remedy: str) -> None:
        self.file, self.field, self.value, self.remedy = str(file), field, value, remedy
        where = f"{field} = {value}" if field and value else field or value
        super().__init__(": ".join(part for part in (self.file, where, remedy) if part))


_REMEDIES = {
    "missing": "is missing; add it",
    "int_type": "give a whole number",
    "int_from_float": "give a whole number",
    "int_parsing_size": "the number is too large",
    "float_type": "give a number",
    "finite_number": "give a finite number",
    "bool_type": "give true or false",
    "string_type": 'give a text in "quotes"',
    "tuple_type": "give a list, such as [a, b]",
    "model_type": "give a table of settings",
    "model_attributes_type": "give a table of settings",
    "dict_type": "give a table of settings",
    "greater_than_equal": "give at least {ge:g}",
    "greater_than": "give more than {gt:g}",
    "less_than_equal": "give at most {le:g}",
    "less_than": "give less than {lt:g}",
    "literal_error": "choose {expected}",
    "string_pattern_mismatch": "use letters, digits, - and _, 64 at most",
}


def explain(
    error: ValidationError,
    data: dict[str, Any],
    file: str | Path,
    model: type[BaseModel],
    overridden: Sequence[str] = (),
) -> JobError:
    """One line for what is worst in pydantic's list of errors.

    `data` is what was validated against `model`; keys in `overridden` came from `--set`.
    """
    found = [(_resolve(data, e["loc"]), e) for e in error.errors(include_url=False)]
    # A union reports every branch: the branch that got deepest into the value speaks. An unknown
    # key comes first, since it is often the reason why another one is missing.
    (keys, value), first = max(
        found, key=lambda f: (f[1]["type"] == "extra_forbidden", len(f[0][0]), _fits(*f))
    )
    field = _join(keys)
    kind, context = first["type"], first.get("ctx", {})
    if kind == "extra_forbidden":
        remedy = _unknown_key(model, keys)
    elif isinstance(value, float) and not math.isfinite(value):
        remedy = "give a finite number"
    elif kind == "value_error":
        remedy = str(context["error"])
    elif kind == "missing" and isinstance(keys[-1], int):
        field, value = _join(keys[:-1]), _at(data, keys[:-1])
        remedy = "give two numbers, [low, high]"
    elif kind == "too_long" or (kind == "tuple_type" and len(found) == 1):
        remedy = "give two numbers, [low, high]"
    elif kind == "literal_error" and context["expected"] == "'all'":
        remedy = 'choose "all" or a list of names'
    elif kind == "too_short" and field == "subsets":
        remedy = "a job needs at least one subset, such as [subsets.multiview]"
    elif kind in _REMEDIES:
        remedy = _REMEDIES[kind].format(**context)
    else:
        remedy = first["msg"]
    if kind == "literal_error" and isinstance(value, str):
        remedy = _suggest(value, re.findall(r"'([^']*)'", context["expected"])) + remedy
    if any(field == key or field.startswith(key + ".") for key in overridden):
        file = "--set"
    # A table would fill the line, and what is wrong is in it or missing from it.
    hidden = value is None or (isinstance(value, dict) and value)
    shown = "" if hidden else _show(value)
    return JobError(file, field or "the job", shown, remedy)


def _resolve(data: Any, loc: tuple[int | str, ...]) -> tuple[tuple[int | str, ...], Any]:
    """The keys of `loc` that exist in `data` (pydantic adds names of union branches) and value."""
    keys: list[int | str] = []
    for i, key in enumerate(loc):
        if isinstance(data, dict) and key in data:
            data = data[str(key)]
        elif isinstance(data, list) and isinstance(key, int) and key < len(data):
            data = data[key]
        elif i == len(loc) - 1 and isinstance(data, dict | list) and not _is_branch(key):
            data = None  # a missing key
        else:
            continue
        keys.append(key)
    return tuple(keys), data


def _is_branch(key: int | str) -> bool:
    return isinstance(key, str) and bool(re.search(r"[\[\]()'-]|^(str|int|float|bool)$", key))


def _fits(resolved: tuple[tuple[int | str, ...], Any], error: Any) -> bool:
    """Whether an error is about the value's content, not just about it being of another type."""
    wants_list = error["type"] in ("tuple_type", "list_type")
    is_list = isinstance(resolved[1], list)
    return not (wants_list or (error["type"] == "literal_error" and is_list))


def _join(keys: Sequence[int | str]) -> str:
    return ".".join(str(k) for k in keys)


def _at(data: Any, keys: Sequence[int | str]) -> Any:
    for key in keys:
        data = data[key]
    return data


def _unknown_key(model: Any, keys: Sequence[int | str]) -> str:
    for key in keys[:-1]:
        model = _below(model, str(key))
    known = list(model.model_fields)
    suggestion = _suggest(str(keys[-1]), known).strip()
    return "unknown key; " + (suggestion or "known are " + ", ".join(known))


def _below(model: Any, key: str) -> Any:
    """The model that validates `key` of a model, or of a dict[str, model]."""
    if isinstance(model, type) and issubclass(model, BaseModel):
        return model.model_fields[key].annotation
    return get_args(model)[1]


def _suggest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f'did you mean "{near[0]}"? ' if near else ""


def _show(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
