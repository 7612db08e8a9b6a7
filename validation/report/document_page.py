"""The shell of every page to read: its style, tables that scroll, figures with a caption."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from html import escape

from softdyn.validation.tables import Table
from softdyn.view.page import head

STYLE = """\
:root { color-scheme: light dark; --ink: #1d2733; --quiet: #5b6876; --line: #d5dce4; --back: #fff;
  --card: #f5f7fa; --bad: #b42318; --good: #0b6b3a; --link: #0a5ca8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e9ef; --quiet: #9aa7b5; --line: #35404c;
  --back: #14191f; --card: #1c232b; --bad: #ff8f80; --good: #6fd39b; --link: #79b8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 16px; max-width: 1340px; background: var(--back); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 24px; margin: 8px 0; } h2 { font-size: 18px; margin: 32px 0 8px; }
h3 { font-size: 15px; margin: 20px 0 6px; }
a { color: var(--link); } p, li { max-width: 75ch; } .quiet { color: var(--quiet); }
.wide { overflow-x: auto; margin: 12px 0; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: 13px; }
th, td { padding: 5px 8px; text-align: right; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
th { font-weight: 600; color: var(--quiet); background: var(--card); }
td { border-top: 1px solid var(--line); } tr.first td { border-top: 2px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
td.bad { color: var(--bad); }
pre { overflow-x: auto; }
figure { margin: 12px 0; padding: 8px; background: #fff; border: 1px solid var(--line);
  border-radius: 8px; } figure img { max-width: min(100%, 920px); height: auto; display: block;
  margin: auto; }
figcaption { color: #444; font-size: 13px; }
code { background: var(--card); padding: 1px 4px; border-radius: 4px; overflow-wrap: anywhere; }
"""


def document_page(title: str, parts: Iterable[str], style: str = "") -> str:
    """A page with its title as a heading; `style` adds to that of all pages."""
    begin = f"{head(title, STYLE + style)}<body>\n<h1>{escape(title)}</h1>"
    return "\n".join([begin, *parts, "</body>", "</html>\n"])


def wide(table: Table, bad: Sequence[Collection[int]] = ()) -> str:
    """A table that scrolls in a narrow window; `bad` has the marked columns of each row."""
    return f'<div class="wide">{table.html(bad or [()] * len(table.rows))}</div>'


def picture(source: str, caption: str = "", link: str = "") -> str:
    """A figure; a click opens `link`."""
    image = f'<img src="{escape(source)}" alt="{escape(caption)}" loading="lazy">'
    image = f'<a href="{escape(link)}">{image}</a>' if link else image
    words = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{image}{words}</figure>"
