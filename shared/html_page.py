"""Pages of HTML: no script, light or dark as their reader likes; what they are given as text never becomes markup."""

import base64
import html
from collections.abc import Iterable, Iterator, Sequence

from shared.terminal import printable

ALL_WITHIN = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""The policy of a page that holds all it shows."""
STYLE = """
:root { color-scheme: light dark; --ink: #1c1f23; --paper: #ffffff; --dim: #667079; --line: #d9dee3; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7ea; --paper: #16191c; --dim: #98a2ab; --line: #31373d; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2rem auto;
  max-width: 76rem; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.05rem; margin-top: 2.2rem; } p { margin: .2rem 0; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .87rem; }
th { text-align: left; font-weight: 600; color: var(--dim); } th, td { padding: .15rem .9rem .15rem 0;
  border-bottom: 1px solid var(--line); vertical-align: top; } .figure { text-align: right;
  font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figcaption { font-size: .87rem; color: var(--dim); } img { max-width: 100%; }
"""


def page(title: str, parts: Iterable[str], style: str = "", policy: str = ALL_WITHIN) -> Iterator[str]:
    """A page, piece by piece; `parts` are markup below its heading, and `style` is added to that of all pages."""
    yield (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escaped(title)}</title><style>{STYLE}{style}</style></head><body><h1>{escaped(title)}</h1>\n"
    )
    yield from parts
    yield "</body></html>\n"


def escaped(text: str) -> str:
    """Text as markup; characters that cannot be shown become `?`."""
    return html.escape(printable(text), quote=True)


def paragraph(text: str) -> str:
    """Text by itself."""
    return f"<p>{escaped(text)}</p>\n"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of text; columns whose heading begins with a space hold figures, and stand to the right."""
    classes = [' class="figure"' if head.startswith(" ") else "" for head in heads]

    def line(cells: Sequence[str], tag: str) -> str:
        told = (f"<{tag}{of}>{escaped(cell)}</{tag}>" for of, cell in zip(classes, cells, strict=True))
        return f"<tr>{''.join(told)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f'<div class="scroll"><table><thead>{line(heads, "th")}</thead><tbody>{body}</tbody></table></div>\n'


def figure(content: str, caption: str) -> str:
    """Markup with a caption, which is text."""
    return f"<figure>{content}<figcaption>{escaped(caption)}</figcaption></figure>"


def image(data: bytes, words: str, media_type: str = "image/jpeg") -> str:
    """A picture that the page holds, with what it shows in words."""
    uri = f"data:{media_type};base64,{base64.b64encode(data).decode()}"
    return f'<img src="{uri}" alt="{escaped(words)}">'
