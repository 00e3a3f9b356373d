"""A self-contained page with pictures: it opens anywhere, without a network."""

from __future__ import annotations

from html import escape
from pathlib import Path

from markerloom.formats.files import write_text

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1f2933; background: #f4f6f8; margin: 0; }
main { max-width: 820px; margin: 0 auto; padding: 24px 16px 64px; }
h1 { font-size: 26px; margin: 8px 0 4px; } h2 { font-size: 19px; margin: 32px 0 8px; }
figure { margin: 12px 0; background: #fff; border: 1px solid #d5dbe1; border-radius: 6px; padding: 8px; overflow-x: auto; }
figure svg { display: block; width: 100%; height: auto; } figcaption { color: #52606d; font-size: 14px; }
table { border-collapse: collapse; background: #fff; width: 100%; font-variant-numeric: tabular-nums; }
th, td { border: 1px solid #d5dbe1; padding: 4px 10px; text-align: right; } th:first-child, td:first-child { text-align: left; }
th { background: #eef1f4; font-weight: 600; } p.note { color: #52606d; }
"""


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table of text."""
    head = "".join(f"<th>{escape(c)}</th>" for c in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def frame(page: str, title: str) -> str:
    """Another page that lies beside this one, inside it."""
    style = "width:100%;height:640px;border:1px solid #d5dbe1;border-radius:6px"
    link = f'<a href="{escape(page)}">on its own</a>'
    return f'<iframe src="{escape(page)}" title="{escape(title)}" style="{style}"></iframe><p class="note">{link}</p>'


def figure(picture: str, caption: str) -> str:
    """A picture with a caption."""
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def section(title: str, *parts: str) -> str:
    """A heading and what follows it."""
    return f"<h2>{escape(title)}</h2>{''.join(parts)}"


def note(text: str) -> str:
    """A paragraph of explanation."""
    return f"<p class='note'>{escape(text)}</p>"


def write(path: str | Path, title: str, *sections: str) -> None:
    """Write the page."""
    head = f"<meta charset='utf-8'><meta name='viewport' content='width=device-width'><title>{escape(title)}</title>"
    page = f"<!doctype html><html lang='en'><head>{head}<style>{STYLE}</style></head>"
    write_text(path, f"{page}<body><main><h1>{escape(title)}</h1>{''.join(sections)}</main></body></html>\n")
