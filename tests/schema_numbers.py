"""The numbers of a configuration, found in its JSON schema, and values that none of them should take unseen."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel

WILD = [
    1e300,
    -1e300,
    1e39,
    5e-324,
    -5e-324,
    -0.0,
    2**64,
    -(2**64),
    10**400,
    10**5000,
    math.nan,
    math.inf,
    -math.inf,
    True,
]
"""Values at which programs run over, divide by zero, or take truth for a number."""


class Number(NamedTuple):
    """One number of a configuration."""

    path: tuple[str, ...]
    """Of its field."""
    place: tuple[int, ...]
    """In the lists of the field."""
    schema: dict[str, Any]

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """The least and the most that it may be; beyond an open end the nearest that is inside."""
        if "enum" in self.schema:
            return min(self.schema["enum"]), max(self.schema["enum"])
        least, most = self.schema.get("minimum"), self.schema.get("maximum")
        if "exclusiveMinimum" in self.schema:
            low = self.schema["exclusiveMinimum"]
            least = low + 1 if self.schema["type"] == "integer" else math.nextafter(low, math.inf)
        if "exclusiveMaximum" in self.schema:
            most = math.nextafter(self.schema["exclusiveMaximum"], -math.inf)
        return least, most

    def put(self, value: Any, field: Any) -> dict[str, Any]:
        """Nested tables that set it; the rest of its field stays as it is."""
        return nested(self.path, replaced(field, self.place, value))


def nested(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Tables in tables, a value in the innermost."""
    for name in reversed(path):
        value = {name: value}
    return value


def replaced(whole: Any, place: tuple[int, ...], value: Any) -> Any:
    """Lists in lists with a value at a place, or the value alone where there is no place."""
    if not place:
        return value
    inner = list(whole)
    inner[place[0]] = replaced(inner[place[0]], place[1:], value)
    return inner


def numbers_of(model: type[BaseModel]) -> Iterator[Number]:
    """Every number of a model and of its tables."""
    whole = model.model_json_schema()

    def inside(schema: dict[str, Any]) -> Iterator[tuple[tuple[int, ...], dict[str, Any]]]:
        if schema.get("type") in ("number", "integer"):
            yield (), schema
        for option in schema.get("anyOf", ()):
            yield from inside(option)
        for position, item in enumerate(schema.get("prefixItems") or filter(None, [schema.get("items")])):
            for place, number in inside(item):
                yield (position, *place), number

    def walk(table: dict[str, Any], path: tuple[str, ...]) -> Iterator[Number]:
        for name, field in table["properties"].items():
            if "$ref" in field:
                inner = whole["$defs"][field["$ref"].rpartition("/")[2]]
                if "properties" in inner:
                    yield from walk(inner, (*path, name))
            else:
                yield from (Number((*path, name), place, number) for place, number in inside(field))

    return walk(whole, ())
