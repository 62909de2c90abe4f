"""Words, numbers and tables of a page: everything escaped, every number with its sign and unit."""

from collections.abc import Sequence
from html import escape

import numpy as np

NOT_KNOWN = '<span class="none" title="not known">–<span class="hidden"> not known</span></span>'


def text(words: str) -> str:
    """Words of any origin as HTML."""
    return escape(words, quote=True)


def number(value: float, decimals: int) -> str:
    """A number with a true minus and no minus before zero; a dash where it is not known."""
    if not np.isfinite(value):
        return NOT_KNOWN
    rounded = round(float(value), decimals) + 0.0
    return f"{rounded:,.{decimals}f}".replace("-", "−").replace(",", "\u202f")


def length(value_mm: float) -> str:
    """Millimetres to the digits that matter at their size."""
    if not np.isfinite(value_mm):
        return NOT_KNOWN
    return number(value_mm, 3 if abs(value_mm) < 1 else 2 if abs(value_mm) < 100 else 1)


def percent(share: float) -> str:
    """A share in percent, with a decimal where it is small."""
    if not np.isfinite(share):
        return NOT_KNOWN
    return f"{number(100 * share, 1 if 0 < share < 0.1 else 0)} %"


def sentence(words: str) -> str:
    """The same with a capital letter at its beginning."""
    return words[:1].upper() + words[1:]


def table(
    caption: str, head: Sequence[str], rows: Sequence[Sequence[str]], *, words: Sequence[int] = (0,), note: str = ""
) -> str:
    """A table of HTML cells.

    Parameters
    ----------
    words
        Columns that hold words; all others hold numbers and are set to the right.
    """
    columns = "".join(f'<th scope="col"{"" if i in words else _NUMBERS}>{cell}</th>' for i, cell in enumerate(head))
    body = "".join(f"<tr>{_row(row, words)}</tr>" for row in rows)
    below = f'<p class="note">{note}</p>' if note else ""
    return (
        f'<div class="table"><table><caption>{caption}</caption><thead><tr>{columns}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>{below}"
    )


_NUMBERS = ' class="n"'


def _row(cells: Sequence[str], words: Sequence[int]) -> str:
    parts = [f'<th scope="row">{cells[0]}</th>']
    parts += [f"<td{'' if i in words else _NUMBERS}>{cell}</td>" for i, cell in enumerate(cells) if i > 0]
    return "".join(parts)


def section(anchor: str, title: str, lead: str, *parts: str) -> str:
    """A section with its heading and a sentence that says how to read it."""
    content = "".join(parts)
    intro = f'<p class="lead">{lead}</p>' if lead else ""
    heading = f'<h2 id="{anchor}-h">{title}</h2>'
    return f'<section id="{anchor}" aria-labelledby="{anchor}-h">{heading}{intro}{content}</section>'


def figure(drawing: str, caption: str, *, title: str = "", css: str = "") -> str:
    """A drawing with its caption."""
    head = f"<h3>{title}</h3>" if title else ""
    return f'<figure class="{css}">{head}{drawing}<figcaption>{caption}</figcaption></figure>'


def folded(summary: str, content: str, *, opened: bool = False) -> str:
    """Something that only some readers want."""
    return f"<details{' open' if opened else ''}><summary>{summary}</summary>{content}</details>"
