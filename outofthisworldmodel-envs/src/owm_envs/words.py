"""How mistakes are put into words, everywhere alike."""

import difflib


def unknown(kind: str, name: object, known) -> str:
    """An error message for an unknown name, suggesting the nearest known one."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}{hint} Known: {', '.join(known)}."
