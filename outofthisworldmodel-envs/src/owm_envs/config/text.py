"""A configuration as text: TOML with units and bounds, the JSON schema, and what is wrong with one in words."""

import functools
import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from owm_envs import words
from owm_envs.config.parts import NOISE_PRESETS, REWARD_PRESETS


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a file of a docking configuration; each number has its `unit` beside its bounds."""
    schema = model.model_json_schema()
    for name, presets in (("noise", NOISE_PRESETS), ("reward", REWARD_PRESETS)):
        field = schema["properties"][name]
        field["anyOf"] = [{"$ref": field.pop("$ref")}, {"enum": list(presets)}]
    schema["properties"]["hull"]["anyOf"][0] = {"type": "string"}
    return schema


@functools.cache
def fields(model: type[BaseModel]) -> dict[tuple[str, ...], dict[str, Any]]:
    """The JSON schema of every single value of a configuration, by its path."""
    schema = model.model_json_schema()

    def walk(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
        for name, field in table["properties"].items():
            if "$ref" in field:
                yield from walk(schema["$defs"][field["$ref"].rpartition("/")[2]], (*path, name))
            else:
                yield (*path, name), field

    return dict(walk(schema, ()))


def note(model: type[BaseModel], path: tuple[str, ...]) -> str:
    """Unit and bounds of a field, as "kg, > 0"; empty where there are none."""
    field = fields(model).get(path, {})
    unit, value = field.get("unit"), field
    # Into tuples and lists, whose items are alike, and to the last of alternatives.
    while inner := (*value.get("anyOf", [])[-1:], *value.get("prefixItems", []), *filter(None, [value.get("items")])):
        value = inner[0]
        unit = unit or value.get("unit")
    words = [{"1": "dimensionless"}.get(unit, unit)] if unit else []
    bounds = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    words += [f"{sign} {value[bound]:.12g}" for bound, sign in bounds.items() if bound in value]
    if "enum" in value:
        words.append("one of " + ", ".join(map(str, value["enum"])))
    return ", ".join(words)


def toml(config: BaseModel, *, notes: bool = False) -> str:
    """The configuration as TOML text; with `notes`, each value's unit and bounds in a comment behind it."""

    def lines(values: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
        if path:
            yield f"\n[{'.'.join(path)}]"
        tables = {name: value for name, value in values.items() if isinstance(value, dict)}
        for name, value in values.items():
            if name not in tables and value is not None:
                remark = note(type(config), (*path, name)) if notes else ""
                yield f"{name} = {_literal(value)}" + (f"  # {remark}" if remark else "")
        for name, table in tables.items():
            yield from lines(table, (*path, name))

    return "\n".join(lines(config.model_dump(mode="json"), ())) + "\n"


def _literal(value: Any) -> str:
    if isinstance(value, list):
        items = [_literal(item) for item in value]
        nested = any(isinstance(item, list) for inner in value if isinstance(inner, list) for item in inner)
        return "[\n  " + ",\n  ".join(items) + ",\n]" if nested else "[" + ", ".join(items) + "]"
    # JSON writes strings, booleans and integers as TOML does; Python writes floats so.
    return repr(value) if isinstance(value, float) else json.dumps(value)


def changes(config: BaseModel, base: BaseModel) -> list[str]:
    """Each value of a configuration that differs from the base's, with its unit and bounds."""

    def value(of: BaseModel, path: tuple[str, ...]) -> Any:
        return functools.reduce(getattr, path, of)

    lines = []
    for path in fields(type(config)):
        mine, theirs = value(config, path), value(base, path)
        if mine != theirs:
            remark = f" ({note(type(config), path)})" if note(type(config), path) else ""
            lines.append(f"{'.'.join(path)} = {mine!r}, not {theirs!r}{remark}")
    return lines


def mistakes(error: ValidationError, model: type[BaseModel]) -> str:
    """What is wrong with a configuration: each field with what is allowed and what came, with its unit."""
    units = fields(model)
    return words.mistakes(error, model, lambda path: units.get(path, {}).get("unit", "").removeprefix("1"))
