"""How mistakes are put into words, everywhere alike."""

import difflib
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, get_args


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """An error message for an unknown name, suggesting the nearest known one."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ";"
    return f"unknown {kind} {name!r}{hint} known: {', '.join(known)}"


def short(value: object) -> str:
    """A value as Python writes it, no longer than a line has room for."""
    try:
        told = repr(value)
    except ValueError:  # of whole numbers with thousands of digits
        told = f"a {type(value).__name__} of thousands of digits"
    return told if len(told) <= 60 else told[:57] + "..."


def is_number(value: object) -> bool:
    """Whether a value that came from a file is a finite number: truth is none, nor what is beyond every float."""
    return type(value) in (int, float) and abs(value) < 1e300


def require_parts(kind: str, protocol: str, candidate: object, names: Iterable[str]) -> None:
    """Refuse what cannot be a static part of an environment.

    Args:
        kind: the argument, as the user knows it.
        protocol: what it must be, and where that is told.
        candidate: what came.
        names: what it must have.

    Raises:
        TypeError: it is a class, lacks a part, or cannot be hashed.
    """
    missing = [name for name in names if not hasattr(candidate, name)]
    if missing or isinstance(candidate, type):
        lacks = f"lacks {', '.join(missing)}" if missing else "is a class, not an instance of it"
        raise TypeError(f"{kind} must be {protocol}, but {candidate!r} {lacks}")
    try:
        hash(candidate)
    except TypeError:
        raise TypeError(
            f"{kind} must be hashable, to share compiled programs, but {type(candidate).__name__} is not: "
            "make it a frozen dataclass without arrays"
        ) from None


def checked_seed(seed: Any, bits: int | None = None) -> int:
    """A seed as Python's integer.

    Args:
        bits: most that it may have; any number when None.

    Raises:
        TypeError: it is no integer; NumPy's are.
        ValueError: it is negative, or too large.
    """
    number = _whole(seed)
    if number is None:
        raise TypeError(f"seed must be an integer of at least 0, got {short(seed)}")
    if number < 0:
        raise ValueError(f"seed must be an integer of at least 0, got {short(number)}")
    if bits is not None and number >> bits:
        raise ValueError(f"seed must be below 2**{bits}, got {number}")
    return number


_EXTRAS = {
    "hub": ("huggingface-hub>=0.34",),
    "mesh": ("trimesh>=4.5", "scipy>=1.13"),
    "pettingzoo": ("pettingzoo>=1.24",),
    "plot": ("matplotlib>=3.8",),
    "rerun": ("rerun-sdk>=0.41", "trimesh>=4.5"),
    "sb3": ("stable-baselines3>=2.6",),
    "video": ("av>=12",),
    "wandb": ("wandb>=0.19",),
}
"""What `pyproject.toml` says of the extras, here so that messages need not name ours: on an index they are not ours."""


def install(extra: str) -> str:
    """The command that installs what an extra brings."""
    return "pip install " + " ".join(f'"{package}"' for package in _EXTRAS[extra])


def checked_count(name: str, value: Any, most: int = 2**31 - 1) -> int:
    """A count of at least 1 as Python's integer.

    Args:
        name: what is counted.
        most: that it may be.

    Raises:
        ValueError: it is no whole number, less than 1, or too large.
    """
    number = _whole(value)
    if number is None or number < 1:
        raise ValueError(f"{name} must be at least 1 and a whole number, got {short(value)}")
    if number > most:
        raise ValueError(f"{name} must be at most {most}, got {short(value)}")
    return number


def _whole(value: Any) -> int | None:
    """A whole number, NumPy's too, as Python's; None of anything else: truth values are none."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def plain(error: Exception) -> str:
    """What an error says, on one line; of a pydantic validation as `mistakes` does."""
    return mistakes(error) if hasattr(error, "errors") else " ".join(str(error).split())


def inert(text: str) -> str:
    """Markdown that opens no HTML tag and no block of code, such as others' names: some viewers run a script in it."""
    return re.sub(r"<(?=[A-Za-z/!?])|`(?=``)|~(?=~~)", lambda found: f"&#{ord(found[0])};", text)


_OURS = {
    "missing": "is missing",
    "greater_than_equal": "must be at least {ge}",
    "less_than_equal": "must be at most {le}",
    "too_short": "must hold at least {min_length}",
    "too_long": "must hold at most {max_length}",
    "finite_number": "must be a finite number",
    "int_from_float": "must be a whole number",
    **dict.fromkeys(("int_type", "int_parsing"), "must be a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "must be a table"),
    "string_type": "must be text",
}
"""For pydantic's kinds of mistakes; the others' own words follow "must be" well enough."""
_OPTION = re.compile(r"str|int|float|bool|(tuple|list|dict|literal|constrained-\w+|function-\w+|nullable)\b.*")
"""What pydantic adds to a place to say which of several types it tried."""


def mistakes(error: Any, model: Any = None, unit: Callable[[tuple[str, ...]], str] = lambda path: "") -> str:
    """What is wrong with a table of settings, on one line: each place with what is allowed and what came.

    Args:
        error: pydantic's.
        model: the class that was validated, to suggest names for unknown ones.
        unit: of the value at a path of names.
    """
    told: dict[str, list[str]] = {}
    came = {}
    for mistake in error.errors():
        # Names as they were written: an option of a type follows its place, and is no part of it.
        parts = [str(part) for i, part in enumerate(mistake["loc"]) if not (i and _OPTION.fullmatch(str(part)))]
        place = ".".join(parts)
        kind, said = mistake["type"], mistake["msg"].removeprefix("Value error, ")
        if kind == "extra_forbidden":
            where, text = ".".join(parts[:-1]), unknown("key", parts[-1], _names(model, parts[:-1]))
            where += ": " if where else ""
        elif kind in ("value_error", "assertion_error"):
            text = said.removeprefix(f"{parts[-1]} ") if parts else said
            where = place and f"{place}{' ' if text != said else ': '}"
        else:
            said = re.sub(r"^(Input|\w+) should (?:be )?(?:a valid )?", "must be ", said)
            where = f"{place}: " if place else ""
            text = _OURS[kind].format(**mistake.get("ctx", {})) if kind in _OURS else said
            if kind != "missing":
                of = unit(tuple(part for part in mistake["loc"] if isinstance(part, str)))
                came[where] = f", got {short(mistake['input'])}" + (f" {of}" if of else "")
        if text not in told.setdefault(where, []):
            told[where].append(text)
    return "; ".join(
        where + " or ".join([texts[0], *(text.removeprefix("must be ") for text in texts[1:])]) + came.get(where, "")
        for where, texts in told.items()
    )


def _names(model: Any, place: Sequence[str]) -> list[str]:
    """The fields of the model at a place inside another."""
    for part in place:
        field = getattr(model, "model_fields", {}).get(part)
        inner = [field.annotation] if field else [model] if part.isdigit() else []
        while inner and not hasattr(inner[0], "model_fields"):
            inner = [each for kind in inner for each in get_args(kind) if each is not type(None) and each is not ...]
        model = inner[0] if inner else None
    return list(getattr(model, "model_fields", {}))
