"""Numbers of things in sentences: `1 sensor`, `2 sensors`."""

from __future__ import annotations


def counted(count: int, noun: str, spec: str = "") -> str:
    """Return a number with its noun, which has a plural in s or, from y after a consonant, in ies.

    Args:
        count: how many; 0 has the plural.
        noun: in the singular, such as `air loop`.
        spec: format of the number, such as `,`.
    """
    plural = f"{noun[:-1]}ies" if noun.endswith("y") and noun[-2] not in "aeiou" else f"{noun}s"
    return f"{count:{spec}} {noun if count == 1 else plural}"
