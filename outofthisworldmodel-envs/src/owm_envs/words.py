"""How mistakes are put into words, everywhere alike."""

import difflib
from collections.abc import Iterable


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """An error message for an unknown name, suggesting the nearest known one."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}{hint} Known: {', '.join(known)}."


def plain(error: Exception) -> str:
    """What an error says, on one line; of a validation, each field with what is wrong, in our words."""
    if not hasattr(error, "errors"):
        return " ".join(str(error).split())
    told = []
    for mistake in error.errors():
        where = ".".join(map(str, mistake["loc"]))
        what = mistake["msg"].removeprefix("Value error, ")
        came = "" if mistake["type"] in ("value_error", "missing") else f", got {mistake['input']!r}"
        told.append((f"{where}: " if where else "") + what + came)
    return "; ".join(told)
